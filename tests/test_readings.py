"""What readings hold beside the motion, a bent sensor and another mode's line: found, taken away, and not invented."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import butter, sosfilt
from scipy.stats import chi2

import pymc_backbone as pb
from pymc_backbone.discrepancy.disturbances import edges as edges_module
from pymc_backbone.discrepancy.disturbances.disturbance import Disturbance, Disturbed, line_modes, sentences
from pymc_backbone.discrepancy.disturbances.edges import Edges, begun_otherwise, edges
from pymc_backbone.discrepancy.disturbances.left_beside import LeftBeside, _moves, left_beside
from pymc_backbone.discrepancy.disturbances.mode_lines import (
    hum_of,
    is_hum,
    left_over,
    lines_on_harmonics,
    whatever_is_left,
)
from pymc_backbone.discrepancy.disturbances.readings import _is_one_line, _is_one_sensor, disturbed, early_line
from pymc_backbone.discrepancy.sets.promising import is_promising
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.discrepancy.weighing import evidence
from pymc_backbone.measurement.reading.record import Record
from pymc_backbone.simulation.decay import simulate_waveform

from .discrepancy_cases import (
    AMPLITUDE,
    DAMPING,
    FREQUENCY,
    MASS,
    OMEGA,
    RATIO,
    RELEASE_TIME,
    STIFFNESS,
    TIME,
    batch_of,
    decaying_sinusoid,
    make_records,
    noisy,
)

LINE = 2.2 * FREQUENCY
CONTACTS = ("freeplay", "quadratic_stiffness")
CANDIDATES = ("cubic_stiffness", "quadratic_stiffness", "quadratic_damping", "displacement_dependent_damping")


def measured(rng, *, odd=0.0, even=0.0, line=0.0, effects=("cubic_stiffness",), specimens=3):
    """Records of specimens as a sensor gives them whose reading bends, another mode in the motion that it sees."""
    records = make_records(rng, effects, specimens=specimens, decibels=200.0)
    found = []
    for record in records:
        share = record.values / AMPLITUDE
        bent = record.values * (1.0 + even * share + odd * share**2)
        found.append(noisy(rng, record.specimen, TIME, bent + decaying_sinusoid(line * AMPLITUDE, LINE), 60.0))
    return found


def searched(records, candidates=CANDIDATES):
    search = Search(batch_of(records), pb.Oscillator(MASS), candidates, 2, lambda _stage, _share: None)
    search.run()
    return search


def test_a_bent_reading_gives_the_motion_back():
    swing = 0.01 * np.exp(-0.3 * TIME) * np.cos(2.0 * np.pi * FREQUENCY * TIME)
    motion, time = np.concatenate([swing, -swing]), np.arange(2 * TIME.size) * (TIME[1] - TIME[0])
    item = Disturbance(time[0], time[-1], 0.0, 0.01, odd=-0.05)
    reading = motion * (1.0 - 0.05 * (motion / 0.01) ** 2)
    np.testing.assert_allclose(item.motion(time, reading + 0.004), motion + 0.004, atol=1e-14)


def test_the_zero_of_a_bent_reading_is_off_by_no_more_than_its_mean():
    motion = 0.01 * np.cos(2.0 * np.pi * FREQUENCY * np.linspace(0.0, 2.0, 4000, endpoint=False))
    reading = motion * (1.0 + 0.02 * motion / 0.01)
    found = Disturbance(0.0, 2.0, 0.0, 0.01, even=0.02).motion(np.linspace(0.0, 2.0, 4000, endpoint=False), reading)
    # the mean reading is half of the curve at the largest motion; what that leaves is of second order
    assert np.abs(reading - motion).max() == pytest.approx(2e-4)
    assert np.abs(found - motion).max() < 5e-6


def test_the_line_begins_where_it_is_said_to_and_decays(rng):
    item = Disturbance(1.0, 3.0, 0.5, 1.0, frequency=2.0, decay=0.7, cosine=0.3, sine=-0.1)
    time = np.linspace(0.0, 3.0, 601)
    modes = line_modes(time, item)
    assert not modes[time < 0.5].any()
    after = time[time >= 0.5] - 1.0
    expected = np.exp(-0.7 * after) * np.cos(4.0 * np.pi * after)
    np.testing.assert_allclose(modes[time >= 0.5, 0], expected, atol=1e-12)
    readings = 0.2 + modes @ np.array([0.3, -0.1])
    left = item.motion(time, readings)
    assert np.ptp(left) < 1e-12
    assert item.line == pytest.approx(np.hypot(0.3, 0.1))


def test_lines_are_told_each_by_its_frequency_and_the_mains_as_what_they_are():
    line = Disturbance(0.0, 3.0, 0.0, 1.0, decay=2.0, cosine=0.01)
    found = [
        Disturbed({f"s{k}": replace(line, frequency=frequency) for k, frequency in enumerate(places)}, ())
        for places in ((31.0, 31.4, 30.8), (50.02, 49.95, 50.0), (151.0, 148.0, 150.0))
    ]
    (said,) = sentences(found[:1])
    assert "hold a line" in said and ", at 30.8 to 31.4 Hz, 1.00% of the motion, as another mode leaves; it was" in said
    (said,) = sentences(found)
    assert "hold lines" in said and "they were taken away" in said
    assert "at 49.95 to 50.02 Hz, 1.00% of the motion, as the mains or another mode leaves" in said
    assert "at 148 to 151 Hz, 1.00% of the motion, as another mode leaves" in said
    lasting = Disturbed({"s0": replace(line, frequency=60.0, decay=0.0)}, ())
    assert "the mains or what runs nearby" in sentences([lasting])[0]


def test_a_mean_over_a_step_holds_less_of_a_line():
    item = Disturbance(0.0, 4.0, 0.0, 1.0, frequency=3.0, decay=0.0)
    fine = np.arange(40000) * 1e-4
    step = 0.05
    means = line_modes(fine, item).reshape(-1, 500, 2).mean(axis=1)
    middle = fine.reshape(-1, 500).mean(axis=1)
    np.testing.assert_allclose(line_modes(middle, item, step), means, atol=1e-6)


def test_a_bent_sensor_is_found_beside_a_spring_and_straightened(rng):
    search = searched(measured(rng, odd=0.03))
    found = disturbed(search)
    assert isinstance(found, Disturbed)
    assert found.beside == ("cubic_stiffness",)
    for r, item in enumerate(found.by_specimen.values()):
        release = 1.0 - 0.125 * r
        assert item.odd == pytest.approx(0.03 * release**2, rel=0.25)
        assert abs(item.even) < 3e-3
        assert item.frequency == 0.0
    assert len(sentences([found])) == 1
    assert "sensor" in sentences([found])[0]
    straight = found.undisturbed(measured(np.random.default_rng(5), odd=0.03))
    exact = make_records(np.random.default_rng(5), ("cubic_stiffness",), specimens=3, decibels=200.0)
    for record, true in zip(straight, exact, strict=True):
        after = record.time > RELEASE_TIME
        left = (record.values - true.values)[after]
        assert np.abs(left - left.mean()).max() < 0.3 * 0.03 * AMPLITUDE


@pytest.mark.parametrize("drag", ["quadratic_damping", "asymmetric_drag"])
def test_an_even_sensor_is_told_from_a_drag_that_differs_between_the_sides(rng, drag):
    """With a drag of its own on each side a set leaves noise, too: the sensor's one curve has to be worth less."""
    records = measured(rng, even=0.004 * (drag == "quadratic_damping"), effects=(drag,))
    search = Search(batch_of(records), pb.Oscillator(MASS), CANDIDATES, 2, variants=("asymmetric_drag",))
    search.run()
    for names in (("asymmetric_drag",), ("asymmetric_drag", "quadratic_stiffness")):
        search.fit_set(names)
    assert "asymmetric_drag" in search.best() and search.explains(search.fits[search.best()])
    found = disturbed(search)
    assert (found is None) == (drag == "asymmetric_drag")
    if found is not None:
        assert found.beside == ("quadratic_damping",) and found.is_bent
        for r, item in enumerate(found.by_specimen.values()):
            assert item.even == pytest.approx(0.004 * (1.0 - 0.125 * r), rel=0.25)


@pytest.mark.parametrize("line", [0.03, 0.2])
def test_a_line_of_another_mode_is_found_beside_a_spring(rng, line):
    found = disturbed(searched(measured(rng, line=line)))
    assert isinstance(found, Disturbed)
    assert found.beside == ("cubic_stiffness",)
    for r, item in enumerate(found.by_specimen.values()):
        assert item.frequency == pytest.approx(LINE, rel=3e-3)
        assert item.line * item.scale == pytest.approx(line * AMPLITUDE, rel=0.1)
        if line < 0.1:  # a larger one is part of the largest reading itself
            assert item.line == pytest.approx(line / (1.0 - 0.125 * r), rel=0.1)
        assert item.bent == 0.0
    assert "line" in sentences([found])[0]


@pytest.mark.parametrize("line", [0.03, 0.1])
def test_a_line_is_taken_from_a_search_that_has_just_begun(rng, line):
    """Beside it no set leaves noise: the search ends before larger ones are asked."""
    records = measured(rng, line=line)
    search = Search(batch_of(records), pb.Oscillator(MASS), CANDIDATES, 2, is_disturbed=early_line)
    search.run()
    assert isinstance(search.halted, Disturbed)
    assert list(search.fits) == [(), ("cubic_stiffness",)]
    for item in search.halted.by_specimen.values():
        assert item.frequency == pytest.approx(LINE, rel=3e-3)
        assert item.line * item.scale == pytest.approx(line * AMPLITUDE, rel=0.1)
    again = searched(search.halted.undisturbed(records))
    assert again.best() == ("cubic_stiffness",)
    assert again._is_explained()


def test_another_mode_may_be_most_of_an_acceleration_and_hardly_move(rng):
    """At six times the frequency, as much of an acceleration is 2 % of the motion: what was there was no spring."""
    time, order = np.arange(0.0, 5.0, 1.0 / (60.0 * FREQUENCY)), 6.6
    spring = {"viscous_damping": DAMPING, "cubic_stiffness": 0.06 * STIFFNESS / AMPLITUDE**2}
    records = []
    for r, ratio in enumerate((1.0, 1.01, 0.99)):
        own, release = spring | {"linear_stiffness": ratio**2 * STIFFNESS}, AMPLITUDE * (1.0 - 0.1 * r)
        model = pb.Oscillator(MASS, "cubic_stiffness")
        motion = pb.simulate_waveform(model, own, time, release, quantity="acceleration").values
        other = np.exp(-1.5 * time) * np.cos(2.0 * np.pi * order * ratio * FREQUENCY * time)
        values = motion + motion.max() * (other + 1e-3 * rng.standard_normal(time.size))
        records.append(Record(f"part {r}", time, values, "acceleration", "m/s^2", "made in a test", ()))
    search = Search(batch_of(records), pb.Oscillator(MASS), CANDIDATES, 1, is_disturbed=early_line)
    search.run()
    assert isinstance(search.halted, Disturbed)
    for item in search.halted.by_specimen.values():
        assert item.frequency == pytest.approx(order * FREQUENCY, rel=0.02) and item.line > 0.4
    again = searched(search.halted.undisturbed(records))
    assert again.best() == ("cubic_stiffness",) and again._is_explained()


@pytest.mark.parametrize(
    ("order", "frequency", "moves"), [(0, 30.0, 0.4), (1, 30.0, 0.1), (2, 30.0, 0.025), (2, 3.0, 0.4)]
)
def test_a_line_counts_by_what_it_moves(order, frequency, moves):
    """What is slower than the mode moves more than an acceleration shows, which is not asked."""
    batch = SimpleNamespace(waveform=[SimpleNamespace(order=order)], records=[SimpleNamespace(frequency=7.5)])
    line = Disturbance(0.0, 1.0, 0.0, 2.0, frequency=frequency, cosine=0.8)
    assert _moves(batch, [line]) == pytest.approx([moves])
    assert _moves(batch, [Disturbance(0.0, 1.0, 0.0, 2.0, even=0.1)]) == [0.0]


@pytest.mark.parametrize("candidates", [("cubic_stiffness",), ("quadratic_stiffness",)])
def test_a_mode_that_beats_with_the_motion_is_taken_away(rng, candidates):
    """In 25 cycles it lies among what a spring leaves and is no line there; the sum of two modes shows it all the same.

    Also where no set leaves noise beside it, as most records hold the same.
    """
    near = 0.9 * FREQUENCY
    records = [
        replace(record, values=record.values + decaying_sinusoid(0.1 * AMPLITUDE, near, 0.003))
        for record in make_records(rng, ("cubic_stiffness",), specimens=4, decibels=40.0)
    ]
    search = Search(batch_of(records), pb.Oscillator(MASS), candidates, 1, is_disturbed=early_line)
    search.run()
    assert isinstance(search.halted, Disturbed)
    for item in search.halted.by_specimen.values():
        assert item.frequency == pytest.approx(near, rel=0.01)
        close = 0.03 if candidates == ("cubic_stiffness",) else 0.3
        assert item.line * item.scale == pytest.approx(0.1 * AMPLITUDE, rel=close)
    again = searched(search.halted.undisturbed(records))
    assert again.best() == ("cubic_stiffness",)


def test_a_mode_at_a_harmonic_is_told_from_that_where_specimens_differ(rng):
    """By the spectrum of one record it may be either; a harmonic goes with the specimen, the other mode does not."""
    place = 1.99 * FREQUENCY
    records = [
        replace(record, values=record.values + decaying_sinusoid(0.06 * AMPLITUDE, place, 0.002))
        for record in make_records(rng, specimens=4, decibels=50.0, scatter=0.03)
    ]
    batch = batch_of(records)
    search = Search(batch, pb.Oscillator(MASS), ("bilinear_stiffness",), 1, is_disturbed=early_line)
    search.run()
    assert isinstance(search.halted, Disturbed) and search.halted.beside == ()
    for item in search.halted.by_specimen.values():
        assert item.frequency == pytest.approx(place, rel=2e-3)
        assert item.line * item.scale == pytest.approx(0.06 * AMPLITUDE, rel=0.1)
    assert lines_on_harmonics(batch.subset([0, 1]), search.fits[()]) is None  # two may agree by chance


@pytest.mark.parametrize("scatter", [0.0, 0.03])
def test_a_harmonic_that_a_law_makes_is_no_other_mode(scatter, rng):
    records = make_records(rng, ("quadratic_damping",), specimens=4, decibels=60.0, scatter=scatter)
    search = Search(batch_of(records), pb.Oscillator(MASS), ("cubic_damping",), 1)
    search.run()
    left = left_over(search.batch, search.fits[()])
    assert all(np.abs(item).max() > 5.0 * record.noise for item, record in zip(left, search.batch.records, strict=True))
    assert lines_on_harmonics(search.batch, search.fits[()]) is None


@pytest.mark.parametrize("effects", [("cubic_stiffness",), ("quadratic_damping",)])
def test_no_line_is_taken_from_a_search_where_there_is_none(rng, effects):
    search = Search(batch_of(measured(rng, effects=effects)), pb.Oscillator(MASS), ("quadratic_stiffness",), 1)
    search.run()
    assert not search._is_explained()
    assert early_line(search) is None


@pytest.mark.parametrize(
    ("orders", "shares", "decay", "is_one"),
    [
        ((2.2, 2.2, 2.21, 2.2), (0.01, 0.02, 0.012, 0.009), 1.0, True),
        ((2.2, 2.2, 2.21, 2.9), (0.01, 0.02, 0.012, 1e-4), 1.0, True),  # one of four does not show it
        ((2.2, 2.6, 2.21, 2.9), (0.01, 0.01, 0.01, 0.01), 1.0, False),  # what a set lacks
        ((2.2, 2.2, 2.2, 2.2), (0.02, 1e-4, 0.02, 1e-4), 1.0, False),
        ((2.2, 2.2, 2.2, 2.2), (0.01, 0.01, 0.01, 0.01), 20.0, False),  # gone after a cycle
    ],
)
def test_a_line_is_one_where_most_records_hold_it(orders, shares, decay, is_one):
    batch = SimpleNamespace(records=[SimpleNamespace(frequency=5.0)] * len(orders))
    items = [
        Disturbance(0.0, 4.0, 0.0, 1.0, frequency=5.0 * order, decay=decay, cosine=share)
        for order, share in zip(orders, shares, strict=True)
    ]
    assert _is_one_line(batch, items) == is_one


def test_a_line_beside_a_set_that_no_law_explains_is_taken_away_where_records_show_the_same(rng):
    """A first step: what is missing comes to light without it."""
    place = 2.47 * FREQUENCY
    records = [
        replace(record, values=record.values + decaying_sinusoid(0.02 * AMPLITUDE, place))
        for record in measured(rng, effects=("quadratic_damping",))
    ]
    search = Search(batch_of(records), pb.Oscillator(MASS), ("cubic_stiffness",), 1)
    search.run()
    assert not search._is_explained()
    found = early_line(search)
    assert isinstance(found, Disturbed)
    for item in found.by_specimen.values():
        assert item.frequency == pytest.approx(place, rel=0.01)
    alone = measured(np.random.default_rng(3), effects=("quadratic_damping",), specimens=4)
    search = Search(batch_of([records[0], *alone[1:]]), pb.Oscillator(MASS), ("cubic_stiffness",), 1)
    search.run()
    assert early_line(search) is None  # a line of one record only


def test_a_line_is_found_beside_the_model_as_it_is_although_the_noise_holds_it(rng):
    """A hum is part of what the noise is estimated from: nothing is missing, and yet it is a line."""
    records = [
        replace(record, values=record.values + 0.01 * AMPLITUDE * np.cos(2.0 * np.pi * LINE * TIME + 0.3))
        for record in measured(rng, effects=())
    ]
    search = searched(records)
    assert search.best() == ()
    assert search._is_explained()
    found = disturbed(search)
    assert isinstance(found, Disturbed)
    assert found.beside == ()
    assert all(item.lasts for item in found.by_specimen.values())
    assert "what runs nearby" in sentences([found])[0]


@pytest.mark.parametrize(("effects", "halts"), [((), True), (("cubic_stiffness",), True), ((), False)])
def test_a_line_that_the_noise_holds_ends_a_search_before_larger_sets(effects, halts, rng):
    """The model as it is explains the records then, or a spring does: both were searched once more without the line."""
    line = 0.08 * AMPLITUDE * np.cos(2.0 * np.pi * LINE * TIME + 0.3)
    records = [
        replace(record, values=record.values + halts * line) for record in measured(rng, effects=effects, specimens=4)
    ]
    search = Search(batch_of(records), pb.Oscillator(MASS), CANDIDATES, 2, is_disturbed=early_line)
    search.run()
    assert max(map(len, search.fits)) == 1 and search._is_explained()
    assert isinstance(search.halted, Disturbed) == halts
    if search.halted is not None:
        for item in search.halted.by_specimen.values():
            assert item.frequency == pytest.approx(LINE, rel=3e-3)
            assert item.line * item.scale == pytest.approx(0.08 * AMPLITUDE, rel=0.05)


def test_a_hum_that_meets_a_harmonic_of_one_record_is_taken_away_beside_another_mode():
    """Both lines leave more than noise, and in that record the hum is no line; nothing is missing.

    Of another draw of such short records (one of three) nothing is taken away.
    """
    rng = np.random.default_rng(1)
    ratios, hum = (0.92, 0.95, 1.0, 1.06), 3.0 * FREQUENCY * np.sqrt(1.0 - RATIO**2)
    records = []
    for number, ratio in enumerate(ratios):
        place, since = ratio * FREQUENCY, np.maximum(TIME - RELEASE_TIME, 0.0)
        motion = (
            AMPLITUDE
            * np.exp(-2.0 * np.pi * RATIO * place * since)
            * np.cos(2.0 * np.pi * place * np.sqrt(1.0 - RATIO**2) * since)
        )
        hums = 0.002 * AMPLITUDE * np.cos(2.0 * np.pi * hum * TIME + rng.uniform(0.0, 6.0))
        other = decaying_sinusoid(0.03 * AMPLITUDE, 2.2 * FREQUENCY)
        records.append(noisy(rng, f"specimen {number + 1}", TIME, motion + other + hums, 52.0))
    study = asked(records)
    assert study.verdict == "adequate"
    told = " ".join(note for note in study.notes if note.startswith("warning"))
    assert "another mode leaves" in told and "what runs nearby leaves" in told
    # negative control: at one order of the frequency in all, it is no hum
    places = np.array([15.0, 15.01, 14.99])
    assert is_hum(places, places / np.array([5.0, 5.2, 4.9]))
    assert not is_hum(places, np.array([3.0, 3.001, 2.999]))
    # a record that hardly shows it may have its highest bin elsewhere
    frequencies = np.array([11.9, 12.1, 11.7, 12.0, 11.8])
    lines = np.array([150.02, 149.97, 159.6, 150.0, 150.01])
    assert hum_of(lines, lines / frequencies) == pytest.approx(150.005) and not is_hum(lines, lines / frequencies)
    assert hum_of(12.5 * frequencies, np.full(5, 12.5)) == 0.0  # another mode goes with the specimen
    assert hum_of(lines[1:3], lines[1:3] / frequencies[1:3]) == 0.0


@pytest.mark.parametrize("effects", [("cubic_stiffness",), ("quadratic_damping",), ()])
def test_nothing_is_taken_away_where_the_sensor_is_straight(rng, effects):
    search = searched(measured(rng, effects=effects))
    assert disturbed(search) is None
    assert edges(search.batch, search.fits[search.best()]) is None


def test_a_record_of_which_nothing_is_known_stays_as_it_is(rng):
    records = make_records(rng, ())
    known = Disturbed({records[0].specimen: Disturbance(0.3, 4.0, 0.26, AMPLITUDE, odd=0.1)}, ())
    first, second = known.undisturbed(records)
    assert second is records[1]
    assert np.abs(first.values - records[0].values).max() > 0.01 * AMPLITUDE


def settling(rng):
    """Records of a cubic spring from a low-pass that begins at rest, at the release."""
    kept = TIME >= RELEASE_TIME
    low_pass = butter(4, 6.0 * FREQUENCY, fs=1.0 / (TIME[1] - TIME[0]), output="sos")
    records = make_records(rng, ("cubic_stiffness",), specimens=3, decibels=200.0)
    return [noisy(rng, r.specimen, TIME[kept], sosfilt(low_pass, r.values[kept]), 60.0) for r in records]


def test_first_cycles_that_are_not_free_are_left_out(rng):
    records = settling(rng)
    search = searched(records)
    found = edges(search.batch, search.fits[search.best()])
    assert isinstance(found, Edges)
    for record, cut in zip(records, found.undisturbed(records), strict=True):
        first = found.first[record.specimen]
        assert 1.5 < (first - RELEASE_TIME) * FREQUENCY < 4.0
        assert cut.starts_free
        np.testing.assert_array_equal(cut.values, record.values[record.time >= first])


def settling_both_ways(rng):
    """Records of a cubic spring from a low-pass that runs forward and back and begins at rest at either end."""
    kept = TIME >= RELEASE_TIME
    low_pass = butter(4, 6.0 * FREQUENCY, fs=1.0 / (TIME[1] - TIME[0]), output="sos")
    found = []
    for record in make_records(rng, ("cubic_stiffness",), specimens=3, decibels=200.0):
        forward = sosfilt(low_pass, record.values[kept])
        found.append(noisy(rng, record.specimen, TIME[kept], sosfilt(low_pass, forward[::-1])[::-1], 60.0))
    return found


def test_both_edges_of_records_from_a_filter_that_runs_both_ways_are_left_out():
    """The noise is estimated from records that hold the edges: a damping that is not there left noise beside them."""
    records = settling_both_ways(np.random.default_rng(3))
    search = searched(records)
    found = edges(search.batch, search.fits[search.best()])
    for record, cut in zip(records, found.undisturbed(records), strict=True):
        first, last = found.first[record.specimen], found.last[record.specimen]
        assert 1.5 < (first - RELEASE_TIME) * FREQUENCY < 4.0
        assert 1.5 < (record.time[-1] - last) * FREQUENCY < 4.0
        kept = (record.time >= first) & (record.time <= last)
        np.testing.assert_array_equal(cut.values, record.values[kept])
    study = asked(records)
    assert (study.verdict, study.missing_effects) == ("found", ("cubic_stiffness",))
    assert any("the last cycles of 3 records" in note for note in study.notes)


def test_what_is_left_of_an_edge_is_cut_where_it_is_known_to_be_none():
    """A filter that settles slowly; another record, and an edge of which nothing is known, stay as they are."""
    squares = np.repeat([*np.ones(22), 1.5, 5.0], 25)
    term = SimpleNamespace(time=np.arange(600) / 25.0, values=np.cos(np.arange(600) * 2.0 * np.pi / 25.0))
    term.compared = lambda values: values
    seen = {
        edges_module._Seen(name, term, 1.0, np.sqrt(np.roll(squares, shift))): name
        for name, shift in (("one", 0), ("other", 300))
    }
    off = {item: item.at_end() for item in seen}
    assert [item.remains for item in off.values()] == [1, 0]
    assert edges_module._cut(off, {}) == {}
    cut = edges_module._cut(off, {"one": 20.0, "other": 20.0})
    assert {seen[item]: count for item, count in cut.items()} == {"one": 1}
    assert edges_module._cut(off, {"other": 20.0}) == {}


@pytest.mark.parametrize(("cycles", "first", "last"), [(14, 1, 1), (11, 1, 0), (9, 0, 0)])
def test_eight_cycles_of_a_record_remain_whatever_its_edges_are(cycles, first, last, monkeypatch):
    """Both ends are off; where not enough would remain, the first cycles are left out alone, or none."""
    squares = np.repeat([900.0, *np.ones(cycles - 2), 900.0], 25)
    monkeypatch.setattr(evidence, "residuals_of", lambda *_: np.sqrt(squares))
    time = np.linspace(0.0, float(cycles), 25 * cycles)
    term = SimpleNamespace(time=time, values=np.cos(2.0 * np.pi * time), compared=lambda values: values)
    batch = SimpleNamespace(
        has_open_records=True, specimens=("one",), waveform=(term,), records=(SimpleNamespace(frequency=1.0),)
    )
    found = edges(batch, None)
    assert (0 if found is None else len(found.first), 0 if found is None else len(found.last)) == (first, last)
    kept = cycles if found is None else found.last.get("one", cycles) - found.first.get("one", 0.0)
    assert kept >= 8.0


def test_edges_of_records_that_had_lost_others_are_both():
    before = edges_module.Edges({"one": 0.2, "other": 0.3}, {"one": 4.0})
    after = edges_module.Edges({"one": 0.4}, {"other": 3.0}).within(before)
    assert after.first == {"one": 0.4, "other": 0.3} and after.last == {"one": 4.0, "other": 3.0}
    assert "the first cycles of 2 records (one, other) and the last cycles of 2 records" in after.sentence
    assert "last cycles" not in edges_module.Edges({"one": 0.2}).sentence


def test_a_second_blow_in_the_first_cycles_is_left_out(rng):
    """A linear structure whose motion a blow changes, in amplitude and phase: what comes after it is free."""
    kept = TIME >= RELEASE_TIME
    since = np.maximum(TIME[kept] - RELEASE_TIME - 0.4 / FREQUENCY, 0.0)
    decay, damped = RATIO * OMEGA, OMEGA * np.sqrt(1.0 - RATIO**2)
    blow = 0.2 * AMPLITUDE * np.exp(-decay * since) * np.sin(damped * since)
    records = [
        noisy(rng, record.specimen, TIME[kept], record.values[kept] + blow, 60.0)
        for record in make_records(rng, (), specimens=3, decibels=200.0, scatter=0.0)
    ]
    study = asked(records)
    assert study.verdict == "adequate"
    assert any("a second blow" in note for note in study.notes)


def dragged(rng, drag=0.12, cycles=0.55, stop=0.0, specimens=3):
    """Records of a linear structure that a hand lets go over half a cycle, or that a stop is reached by at first."""
    kept = np.asarray(TIME) >= RELEASE_TIME
    since, found = np.asarray(TIME)[kept] - RELEASE_TIME, []
    for r in range(specimens):
        omega = OMEGA * (1.0 + 0.004 * rng.standard_normal())

        def rate(time, state, omega=omega):
            x, v = state
            hand = 2.0 * drag * OMEGA * max(1.0 - time * FREQUENCY / cycles, 0.0)
            return [v, -(omega**2) * (x + stop * max(x - 0.8 * AMPLITUDE, 0.0)) - (2.0 * RATIO * OMEGA + hand) * v]

        until = (0.0, since[-1])
        motion = solve_ivp(
            rate, until, [AMPLITUDE, 0.0], t_eval=since, rtol=1e-9, atol=1e-12, max_step=0.05 / FREQUENCY
        )
        found.append(noisy(rng, f"specimen {r + 1}", np.asarray(TIME)[kept], motion.y[0], 50.0))
    return found


@pytest.mark.parametrize("drag", [0.06, 0.2])
def test_a_hand_in_the_first_cycle_is_no_slider_that_slips_there_alone(rng, drag):
    """By the samples it is one: what is loaded to the release holds another force before it first turns."""
    study = asked(dragged(rng, drag), ("jenkins", "coulomb_friction", "cubic_stiffness"))
    assert study.verdict == "adequate"
    assert any("a hand" in note for note in study.notes)
    assert any("without Jenkins, which would act in them alone" in note for note in study.notes)


def test_a_slider_that_slips_in_some_cycles_is_named(rng):
    """It acts in the first ones alone, and in each the less the smaller it is: no hand does that."""
    slider = {"slider_stiffness": 0.05 * STIFFNESS, "slip_force": 0.05 * STIFFNESS * 0.6 * AMPLITUDE}
    oscillator, kept = pb.Oscillator(MASS, "jenkins"), TIME[TIME >= RELEASE_TIME]
    records = []
    for number in range(3):
        own = {"linear_stiffness": STIFFNESS * (1.0 + 0.005 * number), "viscous_damping": 0.3 * DAMPING, **slider}
        exact = pb.simulate_waveform(oscillator, own, kept - RELEASE_TIME, AMPLITUDE).displacement
        records.append(noisy(rng, f"specimen {number + 1}", kept, exact, 55.0))
    study = asked(records, ("jenkins", "cubic_stiffness"))
    assert study.missing_effects == ("jenkins",)


def test_what_relaxes_in_the_first_cycle_is_told_and_no_clearance(rng):
    """The arms of a rubber were loaded slowly: its zero creeps for a part of a cycle, as where a gap closes once."""
    records = []
    for record in make_records(rng, (), specimens=3, decibels=50.0):
        kept = record.time >= RELEASE_TIME
        turns = (record.time[kept] - RELEASE_TIME) * FREQUENCY
        creep = 0.02 * AMPLITUDE * np.exp(-turns / 0.15)
        records.append(replace(record, time=record.time[kept], values=record.values[kept] + creep))
    search = searched(records, CONTACTS)
    best = search.best()
    assert best and begun_otherwise(search.batch, search.fits[()], search.fits[best]) is not None
    study = asked(records, CONTACTS)
    assert study.verdict == "adequate"
    (note,) = [note for note in study.notes if "no free motion" in note]
    assert "freeplay" in note and "which would act in them alone" in note


@pytest.mark.parametrize("name", ["one_sided_stiffness", "cubic_stiffness"])
def test_a_law_is_seen_in_more_than_the_first_cycle(name, rng):
    is_stop = name == "one_sided_stiffness"
    search = searched(dragged(rng, drag=0.0, stop=0.3) if is_stop else make_records(rng, (name,), specimens=3), (name,))
    assert search.best() == (name,)
    assert begun_otherwise(search.batch, search.fits[()], search.fits[(name,)]) is None


def test_a_stop_that_first_cycles_reach_is_named(rng):
    """It is in the first cycles alone as well, but acts whenever they are as large: without them nothing is left."""
    study = asked(dragged(rng, drag=0.0, stop=0.3), ("one_sided_stiffness", "jenkins"))
    assert study.missing_effects == ("one_sided_stiffness",)


def test_records_without_first_cycles_are_searched_where_sets_gain_by_that(rng):
    """A filter that settles is in the first cycles alone; a law that no candidate holds is in all of them."""
    records = settling(rng)
    search = searched(records)
    cut = batch_of(edges(search.batch, search.fits[search.best()]).undisturbed(records))
    assert is_promising(search, cut, 0.5) and is_promising(search, cut, 0.0)
    lacking = searched(make_records(rng, ("cubic_stiffness",), specimens=3), ("cubic_damping",))
    later = [
        replace(record, time=record.time[kept], values=record.values[kept], starts_free=True)
        for record in make_records(rng, ("cubic_stiffness",), specimens=3)
        for kept in [record.time > RELEASE_TIME + 2.0 / FREQUENCY]
    ]
    assert not is_promising(lacking, batch_of(later), 0.5)
    assert is_promising(lacking, batch_of(later[:2]), 0.5)  # other specimens: nothing is known of them


@pytest.mark.parametrize(
    ("cycles", "disturbed"),
    [
        ((900.0, 3.0, 1.0), 1),
        ((120.0, 119.0, 4.7), 2),
        ((300.0, 90.0, 400.0), 3),
        ((900.0, 300.0, 200.0), 0),  # it fades: a wrong law
        ((50.0, 2.0, 1.0), 0),  # hardly more than noise
    ],
)
def test_only_the_first_cycles_are_off_where_they_are_not_free(cycles, disturbed):
    fading = np.geomspace(100.0, 1.0, 10) if cycles[-1] > 100.0 and not disturbed else np.ones(10)
    squares = np.repeat([*cycles, *fading, *np.ones(20)], 25)
    alone = np.full(3, 5.0)
    assert edges_module._disturbed(np.sqrt(squares), 25.0, 3, alone=alone) == disturbed
    # of a noise that was taken for ten times as loud
    assert edges_module._disturbed(0.1 * np.sqrt(squares), 25.0, 3, alone=alone) == disturbed


def test_what_a_law_leaves_of_a_motion_that_falls_fast_is_no_hand():
    """A residual with the third power of the amplitude, as a wrong law's, beside a hand in the first cycle."""
    time = np.arange(800) / 25.0
    for decrement, is_hand in [(0.45, False), (0.45, True), (0.02, True)]:
        amplitude = np.exp(-decrement * time)
        motion = amplitude * np.cos(2.0 * np.pi * time)
        left = 60.0 * amplitude**3 * np.cos(6.0 * np.pi * time)
        left[:25] *= 30.0 if is_hand else 1.0
        left += np.sqrt(2.0) * np.cos(0.9 * np.pi * 25.0 * time)  # as loud as noise
        alone = 5.0 * edges_module._falls(motion, 25.0, 3) ** 3
        assert edges_module._disturbed(left, 25.0, 3, alone=alone) == is_hand
        if not is_hand:  # it is the fall that tells
            assert edges_module._disturbed(left, 25.0, 3, alone=np.full(3, 5.0)) > 0


@pytest.mark.parametrize(("decays", "disturbed"), [(0.006, 1), (0.05, 0)])
def test_a_hand_that_is_hardly_felt_is_seen_where_no_law_leaves_so_much_less_after_it(decays, disturbed):
    """In most of several records: thirty times the noise, and twice the noise in the next cycle."""
    fall = np.exp(2.0 * np.pi * decays)
    squares = np.repeat([30.0, 2.0, *np.ones(30)], 25)
    found = edges_module._disturbed(np.sqrt(squares), 25.0, 3, 10.0, alone=np.full(3, 5.0 * fall**10))
    assert found == disturbed
    assert edges_module._disturbed(np.sqrt(squares), 25.0, 3, alone=np.full(3, 5.0)) == 0
    time = np.arange(800) / 25.0
    motion = np.exp(-2.0 * np.pi * decays * time) * np.cos(2.0 * np.pi * time)
    assert edges_module._decrement(motion, 32.0) == pytest.approx(2.0 * np.pi * decays, rel=0.02)


def test_a_spring_behind_a_filter_that_settles_is_named_and_the_cut_is_said(rng):
    study = asked(settling(rng))
    assert study.candidates[0].effects == ("cubic_stiffness",)
    assert study.candidates[0].probability > 0.5
    assert any("no free motion" in note for note in study.notes)


def asked(records, candidates=CANDIDATES):
    return pb.find_missing_effect(
        pb.Oscillator(MASS), records, candidates=candidates, quick=True, held_out=0, random_seed=1
    )


def test_a_bent_sensor_alone_is_asked_where_a_rare_law_or_two_leave_noise():
    """A damper that differs between the directions and a spring of two sides make up for an even curve together."""
    names = ("bilinear_damping", "quadratic_stiffness")
    search = Search(
        batch_of(measured(np.random.default_rng(1), even=0.005, effects=())), pb.Oscillator(MASS), names[1:], 2,
        variants=names[:1],
    )  # fmt: skip
    for some in ((), *((name,) for name in names), names):
        search.fit_set(some)
    assert search.best() == names and evidence.leaves_noise(search.batch, search.fits[names])
    found = disturbed(search)
    assert found.beside == () and found.is_bent
    curves = [item.even * AMPLITUDE / item.scale for item in found.by_specimen.values()]
    assert curves == pytest.approx([0.005] * len(curves), rel=0.15)
    # negative control: what bends the motion is the damper
    rng, damper, records = np.random.default_rng(2), pb.Oscillator(MASS, names[:1]), []
    values = dict(zip(damper.parameter_names, (STIFFNESS, DAMPING, 0.5 * DAMPING), strict=True))
    for release in (AMPLITUDE, 0.8 * AMPLITUDE):
        exact = simulate_waveform(damper, values, TIME - RELEASE_TIME, release).displacement
        records.append(noisy(rng, f"from {release}", TIME, np.where(TIME < RELEASE_TIME, release, exact), 60.0))
    search = Search(batch_of(records), pb.Oscillator(MASS), names[1:], 2, variants=names[:1])
    for some in ((), *((name,) for name in names)):
        search.fit_set(some)
    assert search.best() == names[:1] and evidence.leaves_noise(search.batch, search.fits[names[:1]])
    assert disturbed(search) is None


@pytest.mark.parametrize(("odd", "decibels"), [(0.0, 32.0), (0.08, 32.0)])
def test_noise_is_no_bend_and_lowers_none(odd, decibels):
    """Noise goes along with its own cube: held against that, a straight sensor had seemed bent by 8 % here."""
    rng, found = np.random.default_rng(12), []
    for record in make_records(rng, specimens=4, decibels=200.0):
        share = record.values / AMPLITUDE
        found.append(noisy(rng, record.specimen, TIME, record.values * (1.0 + odd * share**2), decibels))
    search = Search(batch_of(found), pb.Oscillator(MASS), CANDIDATES, 1)
    straight = search.fit_set(())
    beside = left_beside(search.batch, straight, np.inf, has_line=False, is_bent=True)
    curves = np.array([(item.even, item.odd * (AMPLITUDE / item.scale) ** 2) for item in beside.items])
    error = 10.0 ** (-decibels / 20.0)  # of a coefficient, and more than that with all else that is fitted beside it
    np.testing.assert_allclose(curves.mean(axis=0), (0.0, odd), atol=0.5 * error)
    if not odd:
        assert straight.cost - 2.0 * chi2.isf(1e-3, 8) < beside.cost < straight.cost


def test_sensors_that_bend_differently_are_no_reason_for_a_plainer_law():
    """A cubic spring behind odd curves moves as an inertia that changes; by the curves, no one sensor read both."""
    names = ("cubic_stiffness", "nonlinear_inertia")
    rng, inertia, records = np.random.default_rng(3), pb.Oscillator(MASS, names[1:]), []
    values = dict(zip(inertia.parameter_names, (STIFFNESS, DAMPING, -0.05 * MASS / AMPLITUDE**2), strict=True))
    for release, even in ((AMPLITUDE, 0.002), (0.7 * AMPLITUDE, -0.002), (0.8 * AMPLITUDE, 0.0)):
        motion = simulate_waveform(inertia, values, TIME - RELEASE_TIME, release).displacement
        exact = np.where(TIME < RELEASE_TIME, release, motion)
        records.append(noisy(rng, f"from {release}", TIME, exact * (1.0 + even * exact / release), 55.0))
    search = Search(batch_of(records), pb.Oscillator(MASS), names[:1], 2, variants=names[1:])
    for some in ((), *((name,) for name in names)):
        search.fit_set(some)
    assert search.best() == names[1:] and evidence.leaves_noise(search.batch, search.fits[names[1:]])
    bent = left_beside(search.batch, search.fits[names[:1]], np.inf, has_line=False, is_bent=True)
    assert bent.is_noise and bent.cost < search.fits[names[1:]].cost - 24.0  # more than its coefficients must be worth
    assert disturbed(search) is None


@pytest.mark.parametrize(
    ("curves", "is_one"),
    [
        ([(0.01, 0.002), (0.0105, 0.0015)], True),  # of the reading's range
        ([(0.01, 0.02), (0.005, 0.005)], True),  # of the motion, half as large in the second record
        ([(0.0, 0.02), (0.001, 0.019)], True),
        ([(0.01, 0.004), (0.005, 0.004)], False),
        ([(0.001, 0.02), (0.0005, 0.02), (-0.001, 0.008)], False),
        ([(0.01, 0.0), (-0.01, 0.0)], False),
    ],
)
def test_one_sensor_has_one_curve(curves, is_one):
    items = [
        Disturbance(0.0, 1.0, 0.0, scale, even=even, odd=odd)
        for scale, (even, odd) in zip((1.0, 0.5, 0.7), curves, strict=False)
    ]
    assert _is_one_sensor(LeftBeside(0.0, items, True)) is is_one


def test_of_a_spring_behind_a_bent_sensor_the_mechanism_is_named():
    # the inertia may change with the displacement as well; and the noise, which hides a line at first, takes two passes
    study = asked(measured(np.random.default_rng(1), odd=0.03, line=0.01))
    assert study.verdict == "found"
    assert study.named_level == "mechanism"
    assert [item.mechanism for item in study.mechanisms if item.is_certain] == ["spring"]
    assert study.candidates[0].effects == ("cubic_stiffness",)
    assert study.force_curves is None
    said = [note for note in study.notes if note.startswith("warning")]
    line, bent = said  # the line is taken away early, the sensor straightened in what is left
    assert "a line that is no harmonic of the mode, at" in line
    assert "not in proportion" in bent
    # of the largest motion that is left, from the release on, when the other mode begins
    largest = float(re.search(r"to ([\d.]+)% off a straight line", bent)[1])
    assert largest == pytest.approx(3.0, rel=0.03)


@pytest.mark.parametrize(("even", "first"), [(0.004, "Look at the sensor's calibration"), (0.06, "Sensors are seldom")])
def test_what_bends_readings_by_much_is_seldom_a_sensor(even, first):
    items = {f"s{r}": Disturbance(0.0, 1.0, 0.0, 1.0, even=even * (1.0 + 0.1 * r)) for r in range(3)}
    (said,) = sentences([Disturbed(items, ())])
    assert first in said and "inertia changes with the displacement" in said


def test_of_a_damper_behind_a_bent_sensor_the_law_is_named():
    study = asked(measured(np.random.default_rng(1), odd=0.05, effects=("quadratic_damping",)))
    assert study.missing_effects == ("quadratic_damping",)
    assert any("not in proportion" in note for note in study.notes)


@pytest.mark.parametrize("effects", [(), ("cubic_stiffness",)])
def test_of_a_line_that_was_taken_away_a_little_wrong_the_records_say_nothing(effects, rng):
    """What is left of it is far above the noise, and no law's; nothing is hidden of a spring that is there."""
    other, decay = decaying_sinusoid(0.1 * AMPLITUDE, 0.89 * FREQUENCY), RATIO * 0.89 * OMEGA
    records = [
        replace(record, values=record.values + other)
        for record in make_records(rng, effects, specimens=3, decibels=55.0, share=0.05)
    ]
    taken = {}
    for record in records:
        line = Disturbance(RELEASE_TIME, float(TIME[-1]), RELEASE_TIME, AMPLITUDE)
        line = replace(line, frequency=0.89 * FREQUENCY, decay=1.03 * decay, cosine=0.099 * AMPLITUDE)
        taken[record.specimen] = replace(line, sine=0.1 * RATIO * AMPLITUDE)
    lines = Disturbed(taken, ())
    without = lines.undisturbed(records)
    fall, left = [], []
    for batch in (batch_of(without), whatever_is_left(batch_of(without), lines)):
        search = Search(batch, pb.Oscillator(MASS), ("cubic_stiffness",), 1, lambda _stage, _share: None)
        base, spring = search.fit_set(()), search.fit_set(("cubic_stiffness",))
        fall.append(base.cost - spring.cost)
        left.append(spring.cost / search.count)
    assert left[0] > 1.5  # what is off by so little is far above the noise
    assert left[1] == pytest.approx(1.0, abs=0.1)
    assert (fall[1] > 100.0) if effects else (fall[1] < 12.0)
