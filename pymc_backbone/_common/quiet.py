"""What the libraries underneath may print."""

from __future__ import annotations

import logging
import warnings


def hush_libraries(is_quiet: bool = False) -> None:
    """Keep PyMC's own messages from the terminal, whose content the findings give; show this package's progress.

    ``is_quiet`` keeps the progress away too.
    """
    logging.getLogger("pymc").setLevel(logging.CRITICAL)
    logging.root.addHandler(logging.NullHandler())  # else PyMC, imported later, sets up its own
    # PyMC averages exp(log acceptance ratio), which overflows where a proposal is far better than the start.
    warnings.filterwarnings("ignore", message="overflow encountered in exp", category=RuntimeWarning)
    # Correlations of a hierarchical model let PyTensor look for a BLAS; its matrices have a few rows.
    warnings.filterwarnings("ignore", message="PyTensor could not link to a BLAS", category=UserWarning)
    progress = logging.getLogger("pymc_backbone")
    if not progress.handlers:
        progress.addHandler(logging.StreamHandler())
    progress.setLevel(logging.WARNING if is_quiet else logging.INFO)


__all__ = ["hush_libraries"]
