"""Stochastic nonlinear model updating from backbone curves, inside PyMC.

Names are loaded when they are first used, so that the command line answers at once.
"""

from __future__ import annotations

import importlib
import sys
import warnings
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from . import paper, plots
    from ._common.checks import InputError
    from ._common.citation import citation
    from .discrepancy.planning.plan import plan_tests
    from .discrepancy.results.design import Affordable, Contender, Design, Plan, PlannedTest
    from .discrepancy.results.study import Study
    from .discrepancy.workflow import find_missing_effect
    from .effects import LIBRARY, Effect, Parameter, Signature, get_effect
    from .inference.data import set_backbones
    from .inference.diagnostics import findings, summarise
    from .inference.fit_verdict import GoodnessOfFit
    from .inference.goodness import goodness_of_fit
    from .inference.hierarchical import build_hierarchical_model, unidentified_parameters
    from .inference.model import build_model
    from .inference.predictions import add_log_likelihood, add_predictions
    from .inference.sampling import sample
    from .inference.terms import backbone_deterministic, backbone_likelihood
    from .likelihood.data_consistent import fit_data_consistent
    from .likelihood.density import Density
    from .likelihood.density_fit import fit_density
    from .likelihood.op import BackboneLogLikelihood, BackboneOp
    from .measurement.conditioning.condition import ConditionedRecord, condition
    from .measurement.cycle_data import Cycles
    from .measurement.cycles import extract_cycles
    from .measurement.envelope import envelope_cycles
    from .measurement.levels import backbones_at_levels
    from .measurement.reading.measured_backbones import read_backbones
    from .measurement.reading.record import Record
    from .measurement.reading.records import read_records
    from .measurement.reading.writing import write_records
    from .oscillator import Oscillator
    from .reporting.backbone_files import write_backbones
    from .reporting.study_files import write_study
    from .simulation.backbones import simulate_population
    from .simulation.decay import simulate_backbone, simulate_decay, simulate_waveform
    from .simulation.forced_response import ForcedOscillator, FrequencyResponse, frequency_response
    from .simulation.harmonic_balance import PeriodicMotion, periodic_motion
    from .simulation.response_fit import ResponseFit, fit_frequency_response
    from .simulation.results import BackboneResult, DecayResult, Status, WaveformResult
    from .survey.structure import Structure
    from .survey.survey import Survey
    from .survey.workflow import diagnose_many
    from .workflows.demo import demo_folder, demo_parameters

try:
    __version__ = version("pymc-backbone")
except PackageNotFoundError:  # run from a source tree that was not installed
    __version__ = "0.0.0"

_WHERE = {
    "_common.checks": ("InputError",),
    "_common.citation": ("citation",),
    "measurement.levels": ("backbones_at_levels",),
    "simulation.backbones": ("simulate_population",),
    "measurement.conditioning.condition": ("ConditionedRecord", "condition"),
    "measurement.cycle_data": ("Cycles",),
    "measurement.cycles": ("extract_cycles",),
    "measurement.envelope": ("envelope_cycles",),
    "likelihood.data_consistent": ("fit_data_consistent",),
    "simulation.results": ("BackboneResult", "DecayResult", "Status", "WaveformResult"),
    "simulation.decay": ("simulate_backbone", "simulate_decay", "simulate_waveform"),
    "simulation.forced_response": ("ForcedOscillator", "FrequencyResponse", "frequency_response"),
    "simulation.harmonic_balance": ("PeriodicMotion", "periodic_motion"),
    "simulation.response_fit": ("ResponseFit", "fit_frequency_response"),
    "workflows.demo": ("demo_folder", "demo_parameters"),
    "likelihood.density": ("Density",),
    "likelihood.density_fit": ("fit_density",),
    "reporting.study_files": ("write_study",),
    "inference.data": ("set_backbones",),
    "inference.diagnostics": ("findings", "summarise"),
    "inference.fit_verdict": ("GoodnessOfFit",),
    "inference.goodness": ("goodness_of_fit",),
    "discrepancy.results.design": ("Affordable", "Contender", "Design", "Plan", "PlannedTest"),
    "discrepancy.planning.plan": ("plan_tests",),
    "discrepancy.results.study": ("Study",),
    "discrepancy.workflow": ("find_missing_effect",),
    "effects": ("LIBRARY", "Effect", "Parameter", "Signature", "get_effect"),
    "inference.hierarchical": ("build_hierarchical_model", "unidentified_parameters"),
    "measurement.reading.measured_backbones": ("read_backbones",),
    "inference.terms": ("backbone_likelihood", "backbone_deterministic"),
    "inference.model": ("build_model",),
    "likelihood.op": ("BackboneLogLikelihood", "BackboneOp"),
    "oscillator": ("Oscillator",),
    "measurement.reading.record": ("Record",),
    "measurement.reading.records": ("read_records",),
    "measurement.reading.writing": ("write_records",),
    "reporting.backbone_files": ("write_backbones",),
    "inference.predictions": ("add_log_likelihood", "add_predictions"),
    "inference.sampling": ("sample",),
    "survey.structure": ("Structure",),
    "survey.survey": ("Survey",),
    "survey.workflow": ("diagnose_many",),
}
# Modules that are public themselves: each passes on what its own `__all__` lists.
_NAMESPACES = ("paper", "plots")
_MODULE_OF = {name: module for module, names in _WHERE.items() for name in names}
# Old names, which stay for one minor release.
_RENAMED = {
    "SimulatedBackbone": "BackboneOp",
    "simulated_backbone": "backbone_deterministic",
    "simulated_backbones": "simulate_population",
}

__all__ = [
    "LIBRARY",
    "Affordable",
    "BackboneLogLikelihood",
    "BackboneOp",
    "BackboneResult",
    "ConditionedRecord",
    "Contender",
    "Cycles",
    "DecayResult",
    "Density",
    "Design",
    "Effect",
    "ForcedOscillator",
    "FrequencyResponse",
    "GoodnessOfFit",
    "InputError",
    "Oscillator",
    "Parameter",
    "PeriodicMotion",
    "Plan",
    "PlannedTest",
    "Record",
    "ResponseFit",
    "Signature",
    "Status",
    "Structure",
    "Study",
    "Survey",
    "WaveformResult",
    "add_log_likelihood",
    "add_predictions",
    "backbone_deterministic",
    "backbone_likelihood",
    "backbones_at_levels",
    "build_hierarchical_model",
    "build_model",
    "citation",
    "condition",
    "demo_folder",
    "demo_parameters",
    "diagnose_many",
    "envelope_cycles",
    "extract_cycles",
    "find_missing_effect",
    "findings",
    "fit_data_consistent",
    "fit_density",
    "fit_frequency_response",
    "frequency_response",
    "get_effect",
    "goodness_of_fit",
    "paper",
    "periodic_motion",
    "plan_tests",
    "plots",
    "read_backbones",
    "read_records",
    "sample",
    "set_backbones",
    "simulate_backbone",
    "simulate_decay",
    "simulate_population",
    "simulate_waveform",
    "summarise",
    "unidentified_parameters",
    "write_backbones",
    "write_records",
    "write_study",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module when it is first used."""
    if name in _NAMESPACES:
        globals()[name] = module = importlib.import_module(f".{name}", __name__)
        return module
    if name in _RENAMED:
        new = _RENAMED[name]
        warnings.warn(f"pymc_backbone.{name} is now called {new}; use that.", FutureWarning, stacklevel=2)
        return getattr(sys.modules[__name__], new)
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f".{_MODULE_OF[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names."""
    return sorted({*globals(), *__all__})
