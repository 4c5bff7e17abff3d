"""What records and backbones leave of a set of effects, and its least squares over all specimens at once."""
