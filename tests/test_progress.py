"""A long run is never silent, on a terminal or not, and says a time left only where it can know one."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np
import pytest

from pymc_backbone._common.progress import LINE_EVERY, TICK, Pace, Progress
from pymc_backbone.cli.progress import ProgressBar
from pymc_backbone.inference import sampling as sampling_module
from pymc_backbone.inference.options import Modelling, Sampling
from pymc_backbone.workflows.demo import demo_folder
from pymc_backbone.workflows.update import update

LIMIT, FIRST = 10.0, 2.0


class Clock:
    """Seconds that pass when the test says so; the thread's ticks are made by hand, at its pace."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def pass_by(self, seconds: float, tick: Callable[[], None]) -> None:
        for _ in range(round(seconds / TICK)):
            self.now += TICK
            tick()


class Stream(io.StringIO):
    """A stream that notes when something was written to it."""

    def __init__(self, clock: Clock, *, is_terminal: bool) -> None:
        super().__init__()
        self.clock, self.is_terminal, self.times = clock, is_terminal, [0.0]

    def isatty(self) -> bool:
        return self.is_terminal

    def write(self, text: str) -> int:
        self.times.append(self.clock.now)
        return super().write(text)


def a_run(progress: Progress, clock: Clock) -> None:
    """Let stages pass as `update` has them: long ones that say nothing, and one that is told of draw by draw."""
    clock.pass_by(7.0, progress.tick)  # imports
    progress("reading the records", float("nan"))
    clock.pass_by(65.0, progress.tick)
    progress("compiling the sampler", float("nan"))
    clock.pass_by(33.0, progress.tick)
    for draw in range(4000):
        progress("sampling", (draw + 1) / 4000)
        clock.pass_by(TICK if draw % 20 == 0 else 0.0, progress.tick)
    progress("sampling with nutpie", float("nan"))
    clock.pass_by(166.0, progress.tick)


@pytest.mark.parametrize("is_terminal", [False, True])
def test_no_gap_of_ten_seconds(is_terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    stream = Stream(clock, is_terminal=is_terminal)
    monkeypatch.setattr("pymc_backbone._common.progress.time.monotonic", clock)
    a_run(ProgressBar(stream, delay=1.5), clock)
    assert stream.times[1] <= FIRST
    assert np.max(np.diff([*stream.times, clock.now])) < LIMIT
    if not is_terminal:
        assert len(stream.getvalue().splitlines()) < 1.3 * clock.now / LINE_EVERY + 5  # and it does not chatter


def test_without_the_thread_there_are_gaps(monkeypatch: pytest.MonkeyPatch) -> None:
    # negative control: with nobody looking after the time, silence is as long as the stage
    clock = Clock()
    stream = Stream(clock, is_terminal=False)
    monkeypatch.setattr("pymc_backbone._common.progress.time.monotonic", clock)
    bar = ProgressBar(stream)
    monkeypatch.setattr(bar, "tick", lambda: None)
    a_run(bar, clock)
    assert np.max(np.diff([*stream.times, clock.now])) > 60.0


def test_a_block_looks_after_the_time_by_itself() -> None:
    stream = io.StringIO()
    bar = ProgressBar(stream)
    with bar:
        thread = bar._thread
        assert thread is not None and thread.is_alive() and thread.daemon
    assert not thread.is_alive()
    with ProgressBar(stream, is_shown=False) as silent:
        assert silent._thread is None


def test_what_is_printed_does_not_mix_with_the_bar() -> None:
    stream = Stream(Clock(), is_terminal=True)
    bar = ProgressBar(stream)
    bar("sampling", 0.5)
    bar.below(stream.write)("the result\n")
    assert stream.getvalue().endswith("\r\x1b[Kthe result\n")


# ---- time left -------------------------------------------------------------------------------------


def lefts(rate: Callable[[float], float], until: float) -> list[tuple[float, float | None]]:
    """Return what a pace says of a stage whose share at each time is known."""
    pace, said = Pace(0.0), []
    for now in np.arange(0.1, until, 0.1):
        pace.add(float(now), rate(float(now)))
        said.append((float(now), pace.left(float(now))))
    return said


def test_a_steady_stage_is_estimated() -> None:
    for now, left in lefts(lambda t: t / 60.0, 59.0):
        assert (left is None) == (now < 2.0 or now / 60.0 <= 0.05)
        if left is not None:
            assert left == pytest.approx(60.0 - now, rel=0.05, abs=0.2)


def test_nothing_is_said_of_a_stage_that_was_slow_at_first() -> None:
    # as NUTS is while it tunes: 2 % in 20 s, the rest in 22 s; a straight line said hours
    said = lefts(lambda t: 0.001 * t if t < 20.0 else 0.02 + 0.98 * (t - 20.0) / 22.0, 42.0)
    assert all(left is None or left < 3.0 * (42.0 - now) for now, left in said)
    assert any(left is not None for now, left in said if now > 32.0)


def test_nothing_is_said_of_a_stage_that_stands_still() -> None:
    said = lefts(lambda t: min(t / 60.0, 0.5), 300.0)
    assert all(left is None for now, left in said if now > 65.0)


# ---- what runs tell of -------------------------------------------------------------------------------


@pytest.mark.parametrize("step", ["metropolis", "nutpie"])
def test_update_tells_of_every_stage(step: str) -> None:
    stages: list[str] = []
    shares: list[float] = []

    def note(stage: str, fraction: float) -> None:
        if not stages or stages[-1] != stage:
            stages.append(stage)
        if stage == "sampling":
            shares.append(fraction)

    chosen = Sampling(draws=60, tune=60, chains=2, step=step, random_seed=1)
    update(demo_folder(), Modelling(1.0, ["cubic_stiffness"]), sampling=chosen, progress=note, say=lambda _: None)
    last = "sampling" if step == "metropolis" else "sampling with nutpie"
    assert stages == [
        "reading the records", "extracting cycles", "building the model", "looking for starts",
        "compiling the sampler", last, "comparing the posterior with the measurement", "drawing the figures",
    ]  # fmt: skip
    if step == "metropolis":
        assert len(shares) == 240 and shares[-1] == 1.0 and np.all(np.diff(shares) > 0.0)


def test_draws_of_an_earlier_run_take_no_time() -> None:
    told: list[tuple[str, float]] = []
    report = sampling_module._Reporter(100, 50, lambda stage, share: told.append((stage, share)))
    for _ in range(75):
        report(trace=None, draw=None)
    assert len(told) == 25 and told[-1] == ("sampling", 0.5)
