"""A run of the sampler on disk, that a later one continues draw for draw."""
