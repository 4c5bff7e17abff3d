"""What goes on moving a structure after its release, told from what a wrong law leaves and from noise."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from pymc_backbone.discrepancy.checks import ambient
from pymc_backbone.discrepancy.checks.ambient import ambient_check
from pymc_backbone.discrepancy.deciding.minded import mind_what_moves_on
from pymc_backbone.discrepancy.results.verdict import Verdict
from pymc_backbone.discrepancy.wording.verdict_words import sentence

from .test_discrepancy_verdict import decision_of, mechanism_of

FREQUENCY, RATE, RATIO = 2.0, 200.0, 0.01
TIME = np.arange(0.0, 40.0, 1.0 / RATE)
DECAY = np.exp(-2.0 * np.pi * RATIO * FREQUENCY * TIME) * np.cos(2.0 * np.pi * FREQUENCY * TIME)


def wind(rng: np.random.Generator, size: float) -> np.ndarray:
    """The response of the mode to white noise, as large at the end as at the begin."""
    omega, step = 2.0 * np.pi * FREQUENCY, 1.0 / RATE
    radius = np.exp(-RATIO * omega * step)
    long = lfilter([1.0], [1.0, -2.0 * radius * np.cos(omega * step), radius**2], rng.normal(size=3 * TIME.size))
    moved = long[-TIME.size :]
    return size * moved / moved.std()


def check_of(rests: list[np.ndarray], rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, band=None, model=DECAY,
             **options):  # fmt: skip
    terms = [SimpleNamespace(time=TIME, values=model + rest, size=TIME.size) for rest in rests]
    monkeypatch.setattr(ambient, "residuals_as_measured", lambda term, best, r: rests[r])
    batch = SimpleNamespace(
        waveform=terms, records=[SimpleNamespace(frequency=FREQUENCY, band=band)] * len(terms), has_records=True,
        specimens=[f"heel drop {r}" for r in range(len(terms))],
    )  # fmt: skip
    return ambient_check(batch, SimpleNamespace(), **options)


def test_wind_is_told_from_what_a_law_leaves(rng, monkeypatch):
    noise = [1e-4 * rng.normal(size=TIME.size) for _ in range(3)]
    blown = check_of([wind(rng, 0.01) + item for item in noise], rng, monkeypatch)
    assert not blown.passed and "goes on moving the structure" in blown.message
    share = float(blown.message.split(", ")[1].split(" %")[0])
    assert 0.7 < share < 4.0  # per cent of the largest motion, whose mean over the first part is half of that
    # another mode, outside of a band, is there in the beginning
    other = 0.5 * np.exp(-1.0 * TIME) * np.cos(2.0 * np.pi * 1.5 * FREQUENCY * TIME)
    banded = [wind(rng, 0.01) + other + item for item in noise]
    assert not check_of(banded, rng, monkeypatch, band=(1.6, 2.4)).passed and check_of(banded, rng, monkeypatch).passed
    # a wrong law leaves what goes with the motion, a sensor what is white; and two of three is not most
    assert check_of([0.05 * DECAY + item for item in noise], rng, monkeypatch).passed
    assert check_of([100.0 * item for item in noise], rng, monkeypatch).passed
    # nor does a law whose frequency is off, which is out of step until the end
    wrong = np.minimum(TIME / 30.0, 1.0) ** 3 * DECAY
    assert check_of([wrong + item for item in noise], rng, monkeypatch).passed
    assert check_of([wind(rng, 0.01) + noise[0], *noise[1:]], rng, monkeypatch).passed
    # nor one that decays too slowly, and moves on where the structure rests in the noise
    slow, fast = (np.exp(-2.0 * np.pi * RATIO * FREQUENCY * TIME) ** (share - 1.0) * DECAY for share in (0.3, 3.0))
    assert check_of([fast + 10.0 * item - slow for item in noise], rng, monkeypatch, model=slow).passed
    assert check_of([wind(rng, 0.01) + item for item in noise], rng, monkeypatch, is_explained=True).passed


def test_weak_wind_is_told_by_records_that_have_nothing_in_common(rng, monkeypatch):
    """By itself the end of each looks like a decay; a law leaves alike of specimens that are alike."""
    noise = [1e-4 * rng.normal(size=TIME.size) for _ in range(6)]
    blown = [wind(rng, 0.003) + item for item in noise]
    assert not check_of(blown, rng, monkeypatch).passed
    assert check_of(blown[:3], rng, monkeypatch).passed  # three may be apart by chance
    alike = [0.003 * (1.0 + 0.2 * rng.normal()) * np.cos(2.0 * np.pi * FREQUENCY * TIME + 0.4) for _ in range(6)]
    assert check_of([rest + item for rest, item in zip(alike, noise, strict=True)], rng, monkeypatch).passed
    falls = [0.01 * np.exp(2j * np.pi * rng.random()) for _ in range(6)]  # apart, and yet it goes with the motion
    left = [(item * np.exp(2j * np.pi * FREQUENCY * TIME)).real * np.exp(-0.12 * TIME) for item in falls]
    assert check_of([rest + item for rest, item in zip(left, noise, strict=True)], rng, monkeypatch).passed


def test_what_wind_leaves_is_no_missing_effect_and_what_is_certain_stays():
    certain = (mechanism_of("hysteresis", 0.99, 0.9, iwan=0.99),)
    doubtful = (mechanism_of("clearance", 0.4, 0.7, freeplay=0.4),)
    for verdict, mechanisms, is_changed in [
        (Verdict.UNEXPLAINED, doubtful, True), (Verdict.UNEXPLAINED, certain, False), (Verdict.FOUND, doubtful, False)
    ]:  # fmt: skip
        decision = decision_of(verdict=verdict, best=("freeplay",), mechanisms=mechanisms)
        minded = mind_what_moves_on(decision)
        assert minded.is_moved_on == is_changed and (minded is decision) != is_changed
        if is_changed:
            assert minded.verdict is Verdict.UNEXPLAINED and minded.best == () and not minded.mechanisms
            assert "moved on after its release" in sentence(minded)
