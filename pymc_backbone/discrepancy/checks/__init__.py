"""What else explains the gap, and whether what was named holds."""
