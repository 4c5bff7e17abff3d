"""What the named part leaves as forces: plain records of the curves, their bands and what law they may be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..._common.checks import FloatArray
from ...oscillator import Oscillator

NONE, NOTHING = "none", "nothing"
"""Families: a curve that is none of those, and no curve."""


@dataclass(frozen=True, eq=False)
class Band:
    """A curve with a band that holds all of it with a probability of 95 %.

    Attributes
    ----------
    at : (n,) array
        Displacement [m or rad] or speed.
    force, low, high : (n,) arrays
        [N or N m].
    standard_error : (n,) array
        Of the force at each point.
    """

    at: FloatArray
    force: FloatArray
    low: FloatArray
    high: FloatArray
    standard_error: FloatArray


@dataclass(frozen=True, eq=False)
class Bands:
    """The conservative and the damping force: whole, odd part, even part.

    The conservative force is what goes beyond the linear spring of the mean specimen, the damping force all of it.
    The odd and the even part begin at zero.
    """

    conservative: Band
    conservative_odd: Band
    conservative_even: Band
    damping: Band
    damping_odd: Band
    damping_even: Band


@dataclass(frozen=True)
class Proposal:
    """A family that a curve may be of.

    Attributes
    ----------
    curve : str
        ``conservative`` or ``damping``.
    family : str
        ``power law``, ``power law on one side``, ``power law, even``, ``kink``, ``kink on one side``,
        ``pole on one side``, ``saturation``, ``minimum of damping``, ``largest at a speed``, ``none``, or ``nothing``
        where there is no curve.
    probability : float
        Against the others.
    number : str
        What ``value`` is: ``exponent``, or ``displacement`` [m or rad] or ``speed`` [m/s or rad/s]; empty without one.
    value, low, high : float
        The number with its 95 % interval; NaN without one.
    size : float
        Force of the law at the end of the range [N or N m].
    """

    curve: str
    family: str
    probability: float
    number: str
    value: float
    low: float
    high: float
    size: float


@dataclass(frozen=True, eq=False)
class ForceCurves:
    """What is left of the gap as a force of displacement and a force of speed.

    Attributes
    ----------
    is_possible : bool
        Whether forces of displacement and speed can be it; where not, the curves are the nearest there are.
    sentence : str
        What the curves say, or why they cannot be it.
    beside : tuple of str
        Effects of the model beside which the curves stand, linear stiffness and viscous damping left out.
    bands : Bands
        The forces with their bands, over what was visited.
    has_even : bool
        Whether the records say anything of even parts; else these are zero, and their bands empty.
    proposals : tuple of Proposal
        What law each curve may be, most probable first.
    share_left : float
        Root of the share that the curves leave of the chi-square beyond noise that the model leaves without them.
    p_value : float
        Of what they leave being noise.
    held_out_before, held_out_after : float
        Reduced chi-square of specimens left out in turn, without and with the curves; NaN where there is one specimen.
    oscillator : Oscillator
        The model with the curves.
    parameters : mapping of str to (float, float)
        Value and standard error of every parameter of the mean specimen; of what is held the error is zero.
    """

    is_possible: bool
    sentence: str
    beside: tuple[str, ...]
    bands: Bands
    has_even: bool
    proposals: tuple[Proposal, ...]
    share_left: float
    p_value: float
    held_out_before: float
    held_out_after: float
    oscillator: Oscillator
    parameters: Mapping[str, tuple[float, float]]
