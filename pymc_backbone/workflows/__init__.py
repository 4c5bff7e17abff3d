"""From files to an output folder in one call."""
