"""What force curves say, in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._common.text import of_size, per_cent
from ..results.curve_records import NONE, NOTHING, Proposal

_SURE = 0.7
SHOWN = 0.05  # probability from which another family is told
WORDS = {
    "power law": "a power law{exponent}",
    "power law on one side": "a power law on one side{exponent}",
    "power law, even": "a power law that is the same on both sides{exponent}",
    "kink": "a straight line from a kink on either side{place}",
    "kink on one side": "a straight line from a kink on one side{place}",
    "pole on one side": "the pull or push of something on one side{place}, with the square of the distance to it",
    "saturation": "a force that saturates, over a {number}{of}",
    "minimum of damping": "damping that is least at a speed, over a {number}{of}",
    "largest at a speed": "a force that is largest{place}, as that of eddy currents",
    NONE: "none of the families",
    NOTHING: "not seen",
}
_ONE_SIDE = (
    " What is alike on both sides is drawn: the band keeps the second harmonic and the offset out, "
    "by which an even part of a force would be measured."
)
_BESIDE = 0.5  # of the gap, from which it is not told what forces explain the rest
WHY = {
    "drift": (
        "a drift with time explains more of the rest than any such force (a kink, as of another stop, is not smooth)"
    ),
    "hysteresis": "a force that remembers the way explains more of the rest",
    "": "that is more than noise",
}


@dataclass(frozen=True)
class Judgement:
    """Whether forces of displacement and speed can be what is missing.

    Attributes
    ----------
    is_possible : bool
        Whether they can.
    share_left : float
        What they leave of the gap.
    p_value : float
        Of that being noise.
    why : str
        A key of `WHY`: what speaks against it.
    """

    is_possible: bool
    share_left: float
    p_value: float
    why: str


def sentence(
    judged: Judgement, told: Sequence[Proposal], unit: str, beside: Sequence[str] = (), has_even: bool = True
) -> str:
    """Return what the curves say: whether they can be it, what each looks like, and which law it may be.

    ``beside`` names the effects beside which they stand: then it is what these leave that is told. Without ``has_even``
    the records do not hold what differs between the two sides.
    """
    if not judged.is_possible:
        gap = "that rest" if beside else "the gap"
        # a fit that is lost leaves more than it began with
        left = f"{per_cent(judged.share_left)} of {gap}" if judged.share_left < 1.0 else f"all of {gap}"
        still = "leave" if judged.why else "still leave"
        left = f"the best of them {still} {left} (p = {judged.p_value:.1g})"
        what = "what the named effects leave" if beside else "what is missing"
        # where nothing else explains more, it may be a force that no smooth curve follows, as a second stop
        force = "smooth force of displacement and speed"
        could = f"A {force} is not" if judged.why else f"No {force} was found that is"
        said = f"{could} {what}: {left}, and {WHY[judged.why]}."
        return said + ("" if has_even else _ONE_SIDE)
    if judged.share_left > _BESIDE:
        gap = f"{per_cent(min(judged.share_left, 1.0))} of the gap"
        return (
            f"{gap} is no force of displacement and speed: it lies beside the motion, or differs from cycle to cycle."
        )
    parts = []
    for curve, what, place in (
        ("conservative", "the conservative force beyond the linear spring", unit),
        ("damping", "the damping force beyond the viscous damper", f"{unit}/s"),
    ):
        parts.append(f"{what} is {described([item for item in told if item.curve == curve], place)}")
    leave = "to the noise" if judged.share_left < 0.02 or not np.isfinite(judged.share_left) else ""
    leave = leave or f"but for {per_cent(judged.share_left)} of the gap"
    also = " A drift with time explains them as well: releases from other amplitudes tell the two apart."
    said = f"Forces of displacement and speed explain the records {leave}: {'; '.join(parts)}."
    return said + (also if judged.why == "drift" else "") + ("" if has_even else _ONE_SIDE)


def described(told: Sequence[Proposal], unit: str) -> str:
    """Return the families of one curve in words."""
    best = told[0]
    words = family_in_words(best, unit)
    chance = f"{100.0 * best.probability:.0f} %"
    if best.family == NOTHING:
        return f"{words} ({chance})"
    others = [f"{family_in_words(item, unit)} {100.0 * item.probability:.0f} %" for item in told[1:]
              if item.probability >= SHOWN]  # fmt: skip
    doubt = "" if best.probability >= _SURE else "perhaps "
    return f"{doubt}{words} ({chance}{'; ' + ', '.join(others) if others else ''})"


def family_in_words(item: Proposal, unit: str) -> str:
    """Return a family with its number and the interval of that."""
    value = f"{item.value:.3g} ({item.low:.3g} to {item.high:.3g})"
    (middle, low, high), name = of_size((item.value, item.low, item.high), unit)
    place = f"{middle} ({low} to {high}) {name}"
    return WORDS[item.family].format(
        exponent=f" with exponent {value}", place=f" at {place}", number=item.number, of=f" of {place}"
    )
