"""The source paper's systems with their published numbers, and the studies of them."""
