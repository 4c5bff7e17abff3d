"""The search: which sets are fitted to the samples, in what order, and when it ends."""
