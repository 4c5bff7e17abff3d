"""Stochastic nonlinear model updating from backbone curves, inside PyMC."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from ._checks import InputError
from .backbone import backbones_at_levels, simulated_backbones
from .conditioning import ConditionedRecord, condition
from .cycles import Cycles, extract_cycles
from .decay import BackboneResult, DecayResult, Status, WaveformResult, simulate_backbone, simulate_decay, simulate_waveform
from .density import Density, fit_density
from .effects import LIBRARY, Effect, Parameter, get_effect
from .measured_backbones import read_backbones
from .model import backbone_likelihood, build_model, simulated_backbone
from .op import BackboneLogLikelihood, SimulatedBackbone
from .oscillator import Oscillator
from .records import Record, read_records, write_records
from .sampling import sample

try:
    __version__ = version("pymc-backbone")
except PackageNotFoundError:  # run from a source tree that was not installed
    __version__ = "0.0.0"

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
    "SimulatedBackbone",
    "Status",
    "WaveformResult",
    "backbone_likelihood",
    "backbones_at_levels",
    "build_model",
    "condition",
    "extract_cycles",
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
    "write_records",
]
