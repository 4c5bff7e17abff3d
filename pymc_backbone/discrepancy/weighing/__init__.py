"""The evidence for a set, corrected by importance sampling or a bridge where a mode does not tell it."""
