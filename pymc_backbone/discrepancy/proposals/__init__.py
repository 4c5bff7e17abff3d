"""Sets of effects by their backbones alone: all are looked at before any is fitted to samples."""
