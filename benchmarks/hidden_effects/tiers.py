"""What a batch is about: which effects act, which of them the model under test holds, how good the data are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from contamination import CONTAMINATIONS
from strengths import LIBRARY_NAMES, log_uniform
from systems import NEW, OUTSIDE

TIERS: dict[str, float] = {
    "nothing_missing": 0.12,
    "one_effect": 0.25,
    "close_pairs": 0.12,
    "few_data": 0.08,
    "noisy_and_coarse": 0.08,
    "two_effects": 0.08,
    "three_effects": 0.04,
    "base_and_hidden": 0.08,
    "base_absent": 0.05,
    "outside_library": 0.06,
    "drift": 0.02,
    "second_mode": 0.02,
    "displacement": 0.0,
    "velocity": 0.0,
    "acceleration": 0.0,
    "band_passed": 0.0,
    "band_passed_acceleration": 0.0,
    "contaminated": 0.0,
}
"""Kinds of batches and their shares; those without a share hide one effect after the other, all in the same motions."""

TIMED = "timed"
"""What the others hide, in records of one size: five of a hundred cycles of eighty samples; made by name only."""

QUANTITY_TIERS: dict[str, tuple[str, bool]] = {
    "displacement": ("displacement", False),
    "velocity": ("velocity", False),
    "acceleration": ("acceleration", False),
    "band_passed": ("displacement", True),
    "band_passed_acceleration": ("acceleration", True),
}
"""What is measured, and whether a second mode has to be filtered away."""

QUANTITY_EFFECTS = (
    "cubic_stiffness",
    "quintic_stiffness",
    "quadratic_stiffness",
    "freeplay",
    "bilinear_stiffness",
    "coulomb_friction",
    "quadratic_damping",
    "cubic_damping",
    "displacement_dependent_damping",
    "jenkins",
    "iwan",
    "bouc_wen",
    None,
)

CURVES = "force_curves"
"""One effect outside of the library after the other, in five specimens at 50 dB; made by name only."""

NEW_EFFECTS = "new_effects"
"""One effect of `systems.NEW` after the other, in five specimens at 50 dB; made by name only."""

HARD_TIERS: tuple[str, ...] = (
    CURVES,
    NEW_EFFECTS,
    "strong",
    "strong_pairs",
    "strong_triples",
    "wide_scatter",
    "one_specimen",
    "twenty_specimens",
    "long",
    "tenfold_releases",
)
"""Kinds of batches at the edge of what is measured; made by name only."""

CLOSE_SPRINGS = ("cubic_stiffness", "quintic_stiffness", "freeplay")
CLOSE_FRICTION = ("coulomb_friction", "jenkins")
CLOSE_DAMPERS = ("quadratic_damping", "cubic_damping", "displacement_dependent_damping")


@dataclass
class Plan:
    """What is drawn before any number of the oscillator is.

    Attributes
    ----------
    base : tuple of str
        Effects that the model under test holds.
    present : tuple of str
        Effects that act, in the package's names; the hidden ones are those that are not in ``base``.
    outside : str or None
        Law of `systems.OUTSIDE` that acts.
    visible : bool
        Whether strengths are drawn from the range that most records show.
    quantity : str
        What is measured.
    fewest_cycles : float
        Of the record; 6 or 10 in any case.
    is_banded : bool
        Whether a second mode at 2.6 to 3.4 times the frequency has to be filtered away with the band in the truth.
    narrow : bool
        Whether sliders slip after a few per cent of the amplitude.
    strong : bool
        Whether springs rival the linear one, dampers add up to 15 %, and hysteresis slips from 0.5 % of the amplitude.
    effect_scatter : float or None
        Relative standard deviation of the effects between specimens; drawn where not given.
    contaminations : tuple of str
        What else is in the records, of `contamination.CONTAMINATIONS`.
    damping_ratio, cycles, samples_per_cycle, noise_db, bits, specimens, release_factor : tuple
        Ranges; the middle four are as good as the data are.
    """

    base: tuple[str, ...] = ()
    present: tuple[str, ...] = ()
    outside: str | None = None
    visible: bool = False
    narrow: bool = False
    strong: bool = False
    effect_scatter: float | None = None
    drift: str | None = None
    second_mode: bool = False
    contaminations: tuple[str, ...] = ()
    quantity: str = "displacement"
    is_banded: bool = False
    fewest_cycles: float = 0.0
    damping_ratio: tuple[float, float] = (0.001, 0.03)
    cycles: tuple[int, int] = (20, 120)
    samples_per_cycle: tuple[float, float] = (8.0, 200.0)
    noise_db: tuple[float, float] = (25.0, 60.0)
    bits: tuple[int, int] = (10, 24)
    specimens: tuple[int, ...] = (1, 2, 3, 3, 3, 4, 4, 4, 5, 5, 5, 6, 6, 6, 8, 12)
    release_factor: tuple[float, float] = (1.0, 3.0)

    @property
    def hidden(self) -> tuple[str, ...]:
        """Effects that act and that the model under test does not hold."""
        return tuple(name for name in self.present if name not in self.base)


def draw_tier(rng: np.random.Generator) -> str:
    """Draw a kind of batch by its share."""
    return str(rng.choice(list(TIERS), p=np.array(list(TIERS.values())) / sum(TIERS.values())))


def _pick(rng: np.random.Generator, names: tuple[str, ...], size: int) -> tuple[str, ...]:
    return tuple(str(name) for name in rng.choice(names, size=size, replace=False))


def draw_plan(tier: str, rng: np.random.Generator, index: int = 0) -> Plan:
    """Draw what a batch of a tier is about.

    Parameters
    ----------
    tier : str
        A key of `TIERS`, one of `HARD_TIERS`, or `TIMED`.
    rng : numpy.random.Generator
    index : int
        Number of the batch; in the tiers of `QUANTITY_TIERS` the effects take turns.

    Returns
    -------
    Plan
    """
    plan = Plan()
    if tier == TIMED:
        return _plan_timed(draw_plan(draw_tier(rng), rng, index))
    if tier == "nothing_missing":
        if rng.random() < 0.4:
            plan.base = plan.present = _pick(rng, LIBRARY_NAMES, 1)
            plan.visible = True
    elif tier == "one_effect":
        plan.present = _pick(rng, LIBRARY_NAMES, 1)
    elif tier == "close_pairs":
        _plan_close_pair(plan, rng)
    elif tier == "few_data":
        plan.present = _pick(rng, LIBRARY_NAMES, 1) if rng.random() < 0.85 else ()
        plan.specimens, plan.cycles = (1, 2), (20, 40)
    elif tier == "noisy_and_coarse":
        plan.present = _pick(rng, LIBRARY_NAMES, 1) if rng.random() < 0.85 else ()
        plan.noise_db, plan.bits, plan.samples_per_cycle = (25.0, 35.0), (10, 12), (8.0, 16.0)
    elif tier in ("two_effects", "three_effects"):
        plan.present = _pick(rng, LIBRARY_NAMES, 2 if tier == "two_effects" else 3)
        plan.visible = True
    elif tier == "base_and_hidden":
        plan.present = _pick(rng, LIBRARY_NAMES, 2)
        plan.base = plan.present[:1]
    elif tier == "base_absent":
        plan.base = _pick(rng, LIBRARY_NAMES, 1)
    elif tier == "outside_library":
        plan.outside = _pick(rng, tuple(OUTSIDE), 1)[0]
        plan.visible = True
    elif tier == "drift":
        plan.drift = "stiffness" if rng.random() < 0.5 else "damping"
        plan.release_factor = (1.5, 3.0)
        plan.specimens = (3, 4, 5, 6, 8)
    elif tier == "second_mode":
        plan.second_mode = True
        if rng.random() < 0.5:
            plan.present, plan.visible = _pick(rng, LIBRARY_NAMES, 1), True
    elif tier in QUANTITY_TIERS:
        plan.quantity, plan.is_banded = QUANTITY_TIERS[tier]
        effect = QUANTITY_EFFECTS[index % len(QUANTITY_EFFECTS)]
        plan.present = (effect,) if effect else ()
        plan.visible = True
        plan.specimens, plan.cycles, plan.samples_per_cycle = (5,), (40, 80), (20.0, 60.0)
        plan.fewest_cycles = 25.0  # a band-pass takes some ten of them
        plan.noise_db, plan.bits = (50.0, 50.0), (24, 24)
    elif tier == "contaminated":
        plan.present, plan.visible = _pick(rng, LIBRARY_NAMES, 1), True
        plan.contaminations = _pick(rng, CONTAMINATIONS, int(rng.integers(1, 3)))
        if "outside" in plan.contaminations:
            plan.outside = _pick(rng, tuple(OUTSIDE), 1)[0]
        plan.specimens, plan.cycles, plan.samples_per_cycle = (2, 3, 3, 4, 5), (30, 80), (16.0, 50.0)
        plan.noise_db, plan.bits, plan.fewest_cycles = (45.0, 60.0), (14, 24), 12.0
    elif tier in (CURVES, NEW_EFFECTS):
        plan.visible = True
        if tier == CURVES:
            plan.outside = tuple(OUTSIDE)[index % len(OUTSIDE)]
        else:
            plan.present = (tuple(NEW)[index % len(NEW)],)
        plan.specimens, plan.cycles, plan.samples_per_cycle = (5,), (30, 80), (20.0, 60.0)
        plan.noise_db, plan.bits, plan.fewest_cycles = (50.0, 50.0), (24, 24), 15.0
    elif tier in HARD_TIERS:
        _plan_hard(plan, tier, rng)
    else:
        raise KeyError(f"tier must be one of {', '.join((*TIERS, *HARD_TIERS, TIMED))}, got {tier!r}.")
    return plan


def _plan_timed(plan: Plan) -> Plan:
    """Give the records of a plan the size that is timed; damping lets them last so long."""
    plan.specimens, plan.cycles, plan.samples_per_cycle = (5,), (100, 100), (80.0, 80.0)
    plan.fewest_cycles, plan.damping_ratio, plan.noise_db = 90.0, (0.0005, 0.004), (45.0, 60.0)
    return plan


def _plan_hard(plan: Plan, tier: str, rng: np.random.Generator) -> None:
    """Hide up to three effects at the edge of what is measured."""
    sizes = {"strong": 1, "strong_pairs": 2, "strong_triples": 3}
    plan.present = _pick(rng, LIBRARY_NAMES, sizes.get(tier, int(rng.choice((1, 2, 3), p=(0.4, 0.4, 0.2)))))
    plan.visible = True
    if tier in sizes:
        plan.strong = True
    elif tier == "wide_scatter":
        plan.effect_scatter = 0.3
    elif tier == "one_specimen":
        plan.specimens = (1,)
    elif tier == "twenty_specimens":
        plan.specimens = (20,)
    elif tier == "long":
        plan.cycles, plan.damping_ratio, plan.samples_per_cycle = (500, 500), (0.0003, 0.002), (8.0, 24.0)
    else:
        plan.release_factor = (10.0, 10.0)


def _plan_close_pair(plan: Plan, rng: np.random.Generator) -> None:
    """Hide an effect that another one imitates."""
    plan.visible = True
    group = int(rng.integers(3))
    if group == 0:
        # A short, lightly damped record stays in a narrow range of amplitudes.
        plan.present = _pick(rng, CLOSE_SPRINGS, 1)
        plan.damping_ratio, plan.cycles, plan.release_factor = (0.001, 0.003), (20, 40), (1.0, 1.2)
    elif group == 1:
        plan.present, plan.narrow = _pick(rng, CLOSE_FRICTION, 1), True
    else:
        plan.present = _pick(rng, CLOSE_DAMPERS, 1)


def draw_amplitude(plan: Plan, rng: np.random.Generator) -> float:
    """Draw the largest release amplitude [m]; of a pendulum an angle [rad] at which its sine matters."""
    if "pendulum_stiffness" in (*plan.present, *plan.base):
        return log_uniform(rng, 0.12, 1.2)
    return log_uniform(rng, 1e-6, 0.2)
