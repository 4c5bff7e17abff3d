"""What a diagnosis hands on, as frozen records."""
