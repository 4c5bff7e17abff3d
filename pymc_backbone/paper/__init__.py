"""The systems of the source paper (arXiv:2410.11902) with its published numbers, and its beam: ``pb.paper``.

Names are loaded when they are first used, because modules of this folder need no PyMC and others do.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .beam import PAPER_BEAM, BeamExperiment
    from .beam_modes import ModeShape
    from .case_plots import plot_likelihood
    from .case_study import CaseResult, run_case
    from .cases import CASES, Case, get_case
    from .galerkin import CantileverBeam, OneMode, PointMass, half_sine, natural_modes, reduce_to_one_mode

_WHERE = {
    "beam": ("PAPER_BEAM", "BeamExperiment"),
    "beam_modes": ("ModeShape",),
    "case_plots": ("plot_likelihood",),
    "case_study": ("CaseResult", "run_case"),
    "cases": ("CASES", "Case", "get_case"),
    "galerkin": ("CantileverBeam", "OneMode", "PointMass", "half_sine", "natural_modes", "reduce_to_one_mode"),
}
_MODULE_OF = {name: module for module, names in _WHERE.items() for name in names}

__all__ = [
    "CASES",
    "PAPER_BEAM",
    "BeamExperiment",
    "CantileverBeam",
    "Case",
    "CaseResult",
    "ModeShape",
    "OneMode",
    "PointMass",
    "get_case",
    "half_sine",
    "natural_modes",
    "plot_likelihood",
    "reduce_to_one_mode",
    "run_case",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module when it is first used."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f".{_MODULE_OF[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names."""
    return sorted({*globals(), *__all__})
