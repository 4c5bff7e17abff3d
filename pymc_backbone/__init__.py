"""Stochastic nonlinear model updating from backbone curves, inside PyMC.

Names are loaded when they are first used, so that the command line answers at once.
"""

from __future__ import annotations

import importlib
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._checks import InputError
    from .backbone import backbones_at_levels, simulated_backbones
    from .conditioning import ConditionedRecord, condition
    from .cycles import Cycles, extract_cycles
    from .data_consistent import fit_data_consistent
    from .decay import (
        BackboneResult,
        DecayResult,
        Status,
        WaveformResult,
        simulate_backbone,
        simulate_decay,
        simulate_waveform,
    )
    from .demo import demo_folder
    from .density import Density
    from .density_fit import fit_density
    from .diagnosis_files import write_study
    from .diagnostics import findings, summarise
    from .discrepancy.study import Study
    from .discrepancy.workflow import find_missing_effect
    from .effects import LIBRARY, Effect, Parameter, Signature, get_effect
    from .hierarchical import build_hierarchical_model, unidentified_parameters
    from .measured_backbones import read_backbones
    from .model import backbone_likelihood, build_model, simulated_backbone
    from .op import BackboneLogLikelihood, SimulatedBackbone
    from .oscillator import Oscillator
    from .records import Record, read_records, write_records
    from .results import write_backbones
    from .sampling import sample
    from .survey.structure import Structure
    from .survey.survey import Survey
    from .survey.workflow import diagnose_many

try:
    __version__ = version("pymc-backbone")
except PackageNotFoundError:  # run from a source tree that was not installed
    __version__ = "0.0.0"

_WHERE = {
    "_checks": ("InputError",),
    "backbone": ("backbones_at_levels", "simulated_backbones"),
    "conditioning": ("ConditionedRecord", "condition"),
    "cycles": ("Cycles", "extract_cycles"),
    "data_consistent": ("fit_data_consistent",),
    "decay": (
        "BackboneResult",
        "DecayResult",
        "Status",
        "WaveformResult",
        "simulate_backbone",
        "simulate_decay",
        "simulate_waveform",
    ),
    "demo": ("demo_folder",),
    "density": ("Density",),
    "density_fit": ("fit_density",),
    "diagnosis_files": ("write_study",),
    "diagnostics": ("findings", "summarise"),
    "discrepancy.study": ("Study",),
    "discrepancy.workflow": ("find_missing_effect",),
    "effects": ("LIBRARY", "Effect", "Parameter", "Signature", "get_effect"),
    "hierarchical": ("build_hierarchical_model", "unidentified_parameters"),
    "measured_backbones": ("read_backbones",),
    "model": ("backbone_likelihood", "build_model", "simulated_backbone"),
    "op": ("BackboneLogLikelihood", "SimulatedBackbone"),
    "oscillator": ("Oscillator",),
    "records": ("Record", "read_records", "write_records"),
    "results": ("write_backbones",),
    "sampling": ("sample",),
    "survey.structure": ("Structure",),
    "survey.survey": ("Survey",),
    "survey.workflow": ("diagnose_many",),
}
_MODULE_OF = {name: module for module, names in _WHERE.items() for name in names}

__all__ = [
    "LIBRARY",
    "BackboneLogLikelihood",
    "BackboneResult",
    "ConditionedRecord",
    "Cycles",
    "DecayResult",
    "Density",
    "Effect",
    "InputError",
    "Oscillator",
    "Parameter",
    "Record",
    "Signature",
    "SimulatedBackbone",
    "Status",
    "Structure",
    "Study",
    "Survey",
    "WaveformResult",
    "backbone_likelihood",
    "backbones_at_levels",
    "build_hierarchical_model",
    "build_model",
    "condition",
    "demo_folder",
    "diagnose_many",
    "extract_cycles",
    "find_missing_effect",
    "findings",
    "fit_data_consistent",
    "fit_density",
    "get_effect",
    "read_backbones",
    "read_records",
    "sample",
    "simulate_backbone",
    "simulate_decay",
    "simulate_waveform",
    "simulated_backbone",
    "simulated_backbones",
    "summarise",
    "unidentified_parameters",
    "write_backbones",
    "write_records",
    "write_study",
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
