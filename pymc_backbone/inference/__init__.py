"""PyMC models of the likelihoods, their starts, steps, sampling and diagnostics."""
