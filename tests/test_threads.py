"""Jobs on all cores: in order, each core shared out once, and the same digits whatever their number."""

from __future__ import annotations

import threading
import time
from functools import partial

import numpy as np
import pytest

from pymc_backbone._common import threads
from pymc_backbone._common.threads import in_threads
from pymc_backbone.discrepancy.propose import propose
from pymc_backbone.oscillator import Oscillator

from .test_discrepancy_scatter import MASS, backbones, factors_of, fitted


def slowly(number: int) -> tuple[int, int]:
    time.sleep(0.02 * (3 - number % 3))
    return number, threading.get_ident()


def cores(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setattr(threads, "_cores", lambda: count)


@pytest.mark.parametrize("count", [1, 3])
def test_results_come_in_the_order_of_the_jobs(monkeypatch, count):
    cores(monkeypatch, count)
    found = in_threads([partial(slowly, k) for k in range(7)])
    assert [number for number, _ in found] == list(range(7))
    assert (len({thread for _, thread in found}) > 1) == (count > 1)


def test_jobs_of_a_job_stay_in_its_thread(monkeypatch):
    cores(monkeypatch, 2)

    def outer() -> set[int]:
        return {thread for _, thread in in_threads([partial(slowly, k) for k in range(3)])}

    assert all(len(used) == 1 for used in in_threads([outer, outer, outer, outer]))


def test_what_fails_in_a_job_is_raised(monkeypatch):
    cores(monkeypatch, 2)
    with pytest.raises(ZeroDivisionError):
        in_threads([lambda: 1.0, lambda: 1 / 0, lambda: 2.0])


def test_one_core_where_linear_algebra_was_told_so(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert threads._cores() == 1
    monkeypatch.setenv("OMP_NUM_THREADS", "")
    assert threads._cores() >= 1


def test_a_fit_and_proposals_have_the_same_digits_on_one_core_and_on_many(monkeypatch):
    batch = backbones(factors_of(0.05, 4))
    seen = []
    for count in (1, 4):
        cores(monkeypatch, count)
        found = fitted(batch)
        proposed = propose(batch, Oscillator(MASS), ("cubic_stiffness", "quintic_stiffness", "quadratic_damping"), 2)
        seen.append(
            (found.state.eta.tobytes(), found.state.own.tobytes(), found.chi_square.tobytes(),
             [(item.names, item.chi_square, item.eta.tobytes(), item.own.tobytes()) for item in proposed])
        )  # fmt: skip
    assert seen[0] == seen[1]
    assert np.frombuffer(seen[0][0])[0] != 0.0
