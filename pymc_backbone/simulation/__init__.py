"""Free decays and forced response of an oscillator, compiled; knows nothing of measurement."""
