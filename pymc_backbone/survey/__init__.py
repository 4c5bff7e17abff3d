"""Many structures at once: the same diagnosis for each, in many processes, and one summary over all."""
