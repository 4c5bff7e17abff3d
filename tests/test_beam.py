"""The beam of the source paper: modes, reduction to one mode, and what its published numbers imply."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import brentq

from pymc_backbone._common.checks import InputError
from pymc_backbone.paper.beam import PAPER_BEAM, CantileverBeam, PointMass, half_sine, natural_modes, reduce_to_one_mode
from pymc_backbone.simulation.decay import simulate_backbone

BEAM = PAPER_BEAM.beam
STIFFNESS, SOFTENING = np.array(PAPER_BEAM.stiffness), np.array(PAPER_BEAM.softening)


def finite_elements(beam: CantileverBeam, elements: int, count: int = 3) -> np.ndarray:
    """Frequencies [Hz] of a cubic Hermite beam with consistent masses; point masses must lie on nodes."""
    h = beam.length / elements
    stiffness = np.array([[12, 6 * h, -12, 6 * h], [0, 4 * h * h, -6 * h, 2 * h * h], [0, 0, 12, -6 * h], [0] * 4])
    stiffness[3, 3] = 4 * h * h
    mass = np.array([[156, 22 * h, 54, -13 * h], [0, 4 * h * h, 13 * h, -3 * h * h], [0, 0, 156, -22 * h], [0] * 4])
    mass[3, 3] = 4 * h * h
    k, m = np.zeros((2 * elements + 2,) * 2), np.zeros((2 * elements + 2,) * 2)
    for i in range(elements):
        here = slice(2 * i, 2 * i + 4)
        k[here, here] += beam.bending_stiffness / h**3 * (stiffness + np.triu(stiffness, 1).T)
        m[here, here] += beam.mass_per_length * h / 420.0 * (mass + np.triu(mass, 1).T)
    for point in beam.point_masses:
        node = round(point.position / h)
        assert abs(node * h - point.position) < 1e-9
        m[2 * node, 2 * node] += point.mass
    return np.sqrt(eigh(k[2:, 2:], m[2:, 2:], eigvals_only=True)[:count]) / (2 * np.pi)


def test_modes_without_masses_are_the_textbook_ones():
    roots = [brentq(lambda b: np.cos(b) * np.cosh(b) + 1.0, low, low + 1.0) for low in (1.4, 4.2, 7.4, 10.5, 13.6)]
    expected = np.array(roots) ** 2 * np.sqrt(BEAM.bending_stiffness / BEAM.mass_per_length) / BEAM.length**2
    frequencies, shapes = natural_modes(BEAM, 5)
    np.testing.assert_allclose(frequencies, expected / (2 * np.pi), rtol=1e-11)
    x = np.linspace(0.0, BEAM.length, 7)
    for root, shape in zip(roots, shapes, strict=True):
        y, ratio = root * x / BEAM.length, (np.cosh(root) + np.cos(root)) / (np.sinh(root) + np.sin(root))
        textbook = np.cosh(y) - np.cos(y) - ratio * (np.sinh(y) - np.sin(y))
        np.testing.assert_allclose(shape(x), textbook / textbook[-1], atol=1e-8)


@pytest.mark.parametrize("tip_share", [0.01, 0.3, 5.0, 1000.0])
def test_modes_with_a_tip_mass_solve_the_textbook_equation(tip_share):
    """1 + cos b cosh b + mu b (cos b sinh b - sin b cosh b) = 0 with mu the tip mass over the beam's."""
    beam = BEAM.with_masses(PointMass(tip_share * BEAM.mass_per_length * BEAM.length, BEAM.length))
    for shape in natural_modes(beam, 4)[1]:
        b = shape.wavenumber * BEAM.length
        terms = np.array([1.0, np.cos(b) * np.cosh(b), tip_share * b * np.cos(b) * np.sinh(b)])
        terms = np.append(terms, -tip_share * b * np.sin(b) * np.cosh(b))
        assert abs(terms.sum()) < 1e-9 * np.abs(terms).max()


MASSES = {
    "none": (),
    "tip": (PointMass(0.007, 0.312),),
    "middle": (PointMass(0.02, 0.156),),
    "three": (PointMass(0.01, 0.078), PointMass(0.03, 0.234), PointMass(0.004, 0.312)),
    "twice at one place": (PointMass(0.01, 0.156), PointMass(0.01, 0.156)),
    "heavy": (PointMass(2.0, 0.156),),
}


@pytest.mark.parametrize("masses", MASSES.values(), ids=MASSES)
def test_modes_with_masses_anywhere_agree_with_finite_elements(masses):
    """Finite elements come from above, with an error that falls with the fourth power of their size."""
    beam = BEAM.with_masses(*masses)
    exact = natural_modes(beam)[0]
    errors = np.array([finite_elements(beam, n) / exact - 1.0 for n in (8, 16, 32)])
    # Rounding of the eigenvalue solver is 1e-7 where the frequencies lie far apart.
    assert np.all(errors > -1e-7) and np.all(errors[2] < 2e-5)
    np.testing.assert_allclose(np.log2(errors[0, 1:] / errors[1, 1:]), 4.0, atol=0.2)
    np.testing.assert_allclose(np.log2(errors[1, 1:] / errors[2, 1:]), 4.0, atol=0.2)


def test_modes_are_orthogonal_and_rayleigh_gives_their_frequencies():
    beam = BEAM.with_masses(PointMass(0.004, 0.1), PointMass(0.007, 0.312))
    frequencies, shapes = natural_modes(beam, 4)
    x, w = np.polynomial.legendre.leggauss(40)
    pieces = [(0.5 * (b - a) * x + 0.5 * (a + b), 0.5 * (b - a) * w) for a, b in ((0.0, 0.1), (0.1, 0.312))]
    nodes, weights = np.concatenate([p[0] for p in pieces]), np.concatenate([p[1] for p in pieces])
    nodes = np.concatenate([nodes, [0.1, 0.312]])
    weights = np.concatenate([BEAM.mass_per_length * weights, [0.004, 0.007]])
    values = np.array([shape(nodes) for shape in shapes])
    gram = values * weights @ values.T
    np.testing.assert_allclose(gram, np.diag(np.diag(gram)), atol=1e-10 * gram[0, 0])
    for frequency, shape in zip(frequencies, shapes, strict=True):
        reduced = reduce_to_one_mode(beam, shape)
        assert reduced.frequency == pytest.approx(frequency, rel=1e-8)
    np.testing.assert_allclose([reduce_to_one_mode(beam, s).mass for s in shapes], np.diag(gram), rtol=1e-8)


def test_derivatives_of_shapes_are_derivatives():
    shape = natural_modes(BEAM.with_masses(PointMass(0.01, 0.1)), 2)[1][1]
    x, step = np.array([0.02, 0.07, 0.15, 0.29]), 1e-4
    for order in range(3):
        slope = (shape(x + step, order) - shape(x - step, order)) / (2 * step)
        np.testing.assert_allclose(slope, shape(x, order + 1), rtol=2e-5, atol=1e-3)
    sine = half_sine(BEAM)
    np.testing.assert_allclose((sine(x + step) - sine(x - step)) / (2 * step), sine(x, derivative=1), rtol=1e-5)


def test_reduction_has_the_closed_forms_of_both_shapes():
    length, line = BEAM.length, BEAM.mass_per_length
    beam = BEAM.with_masses(PointMass(0.005, length / 4), PointMass(0.007, length))
    sine = reduce_to_one_mode(beam, half_sine(beam))
    assert sine.mass == pytest.approx(line * length / 2 + 0.005 * 0.5, rel=1e-12)
    assert sine.damping == pytest.approx(BEAM.damping_per_length * length / 2, rel=1e-12)
    assert sine.stiffness == pytest.approx(BEAM.bending_stiffness * (np.pi / length) ** 4 * length / 2, rel=1e-12)
    assert sine.base_participation == pytest.approx(2 * line * length / np.pi + 0.005 * np.sqrt(0.5), rel=1e-10)
    assert abs(sine.magnetic_stiffness(10.0, 1e9)[0]) < 1e-20
    # Clamped-free modes, with 1 at the tip: integral of the square is L/4, of the shape 2 r / (b L) times L/2.
    b = 1.875104068711961
    ratio = (np.cosh(b) + np.cos(b)) / (np.sinh(b) + np.sin(b))
    mode = reduce_to_one_mode(BEAM, natural_modes(BEAM, 1)[1][0])
    assert mode.mass == pytest.approx(line * length / 4, rel=1e-10)
    assert mode.stiffness == pytest.approx(BEAM.bending_stiffness * b**4 / length**3 / 4, rel=1e-10)
    assert mode.base_participation == pytest.approx(line * length * ratio / b, rel=1e-9)
    assert mode.magnetic_stiffness(10.0, 1e9) == pytest.approx((10.0, 1e9), rel=1e-12)


def test_a_heavy_tip_mass_makes_the_static_spring():
    heavy = BEAM.with_masses(PointMass(100.0, BEAM.length))
    reduced = reduce_to_one_mode(heavy, natural_modes(heavy, 1)[1][0])
    assert reduced.stiffness == pytest.approx(BEAM.tip_stiffness, rel=1e-6)
    assert reduced.mass == pytest.approx(100.0, rel=1e-3)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: BEAM.with_masses(PointMass(0.01, 312.0)), "must lie on the beam"),
        (lambda: PointMass(0.0, 0.1), "`mass` must be positive"),
        (lambda: natural_modes(BEAM, 0), "`count`"),
        (lambda: CantileverBeam(0.3, 0.03, -1.0, 2e11, 8000.0, 0.4), "`thickness`"),
    ],
)
def test_what_cannot_be_used_is_refused(call, words):
    with pytest.raises(InputError, match=words):
        call()


# What docs/beam.md says of the published numbers.


def test_published_mass_and_damping_contradict_each_other_for_every_shape():
    """m >= (mass per length) * integral of s^2 and c = c_a * integral of s^2, whatever s is."""
    least = BEAM.mass_per_length / BEAM.damping_per_length
    assert PAPER_BEAM.mass / PAPER_BEAM.damping < 0.93 * least
    sine = reduce_to_one_mode(BEAM, half_sine(BEAM))
    assert sine.damping == pytest.approx(PAPER_BEAM.damping, abs=5e-6)
    assert sine.mass == pytest.approx(0.04139, abs=5e-6) and sine.mass > PAPER_BEAM.mass
    assert sine.stiffness == pytest.approx(1096.6, abs=0.1) and sine.stiffness > 11.0 * STIFFNESS.max()
    assert sine.frequency == pytest.approx(25.91, abs=0.01)


def test_published_frequencies_are_those_of_one_magnet():
    expected = {0: (9.23, 57.84, 161.94), 1: (8.53, 53.95, 152.17), 2: (7.96, 51.46, 146.97)}
    for magnets, frequencies in expected.items():
        np.testing.assert_allclose(natural_modes(PAPER_BEAM.beam_with_magnets(magnets))[0], frequencies, atol=0.006)
    one = PAPER_BEAM.beam_with_magnets(1)
    # Three elements and one magnet give the published finite-element values, third mode included, to 0.04 %.
    np.testing.assert_allclose(finite_elements(one, 3), PAPER_BEAM.finite_element_frequencies, rtol=4e-4)
    # The analytical ones are near the first-order effect of one magnet on the bare modes (tip value squared is 4).
    first_order = natural_modes(BEAM)[0] / np.sqrt(1 + 4 * PAPER_BEAM.magnet_mass / BEAM.mass_per_length / BEAM.length)
    np.testing.assert_allclose(first_order, PAPER_BEAM.analytical_frequencies, rtol=4.5e-3)


def test_published_uniform_bounds_cannot_come_from_the_published_samples():
    stiffest = np.sqrt(STIFFNESS.max() / PAPER_BEAM.mass) / (2 * np.pi)
    softest = np.sqrt(STIFFNESS.min() / PAPER_BEAM.mass) / (2 * np.pi)
    assert (softest, stiffest) == pytest.approx((6.4402, 8.0328), abs=1e-4)
    bounds = np.array(list(PAPER_BEAM.measured_bounds.values()))
    assert np.all(np.diff(bounds, axis=0) > 0.0) and np.all(bounds[:, 1] > stiffest)
    levels = np.array([1e-6, 4e-6, 8e-6])
    curves = np.array([simulate_backbone(PAPER_BEAM.oscillator, p, levels).values[0] for p in PAPER_BEAM.population])
    assert np.all(np.diff(curves, axis=1) < 0.0) and np.all(curves < stiffest)


def test_tables_of_the_documentation_are_computed():
    text = (Path(__file__).parents[1] / "docs" / "beam.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|$", text, flags=re.MULTILINE)
    assert len(rows) == 4
    for magnets, *frequencies in rows:
        computed = natural_modes(PAPER_BEAM.beam_with_magnets(int(magnets)))[0]
        np.testing.assert_allclose(computed, np.array(frequencies, dtype=float), atol=0.005001)
    pattern = r"^\| (\w+) \| ([\d.]+) to ([\d.]+) \| at (\d) micrometres: ([\d.]+) to ([\d.]+) \|$"
    rows = re.findall(pattern, text, flags=re.MULTILINE)
    assert [row[0] for row in rows] == ["low", "mid", "high"]
    for name, low, high, level, *ends in rows:
        assert (float(low), float(high)) == PAPER_BEAM.measured_bounds[name]
        levels = [float(level) * 1e-6]
        f = [simulate_backbone(PAPER_BEAM.oscillator, p, levels).values[0, 0] for p in PAPER_BEAM.population]
        np.testing.assert_allclose([min(f), max(f)], np.array(ends, dtype=float), atol=5.001e-4)
    np.testing.assert_allclose(natural_modes(PAPER_BEAM.beam_with_magnets(1, 0.005))[0][:2], [8.43, 50.99], atol=0.006)
    mode = reduce_to_one_mode(PAPER_BEAM.beam_with_magnets(2), natural_modes(PAPER_BEAM.beam_with_magnets(2))[1][0])
    assert (mode.mass, mode.stiffness, mode.damping) == pytest.approx((0.0274, 68.6, 0.0349), rel=2e-3)
    softest = simulate_backbone(PAPER_BEAM.oscillator, PAPER_BEAM.population[4], [4.6e-6]).values[0, 0]
    assert softest == pytest.approx(PAPER_BEAM.measured_bounds["low"][0], abs=5e-4)
    stiffest = simulate_backbone(PAPER_BEAM.oscillator, PAPER_BEAM.population[8], [1e-7, 9.5e-6]).values[0]
    assert 1 - stiffest[1] / stiffest[0] == pytest.approx(1.7e-5, abs=0.2e-5)


def test_magnetic_lengths_are_a_thousandth_of_the_air_gap():
    frequency = natural_modes(PAPER_BEAM.beam_with_magnets(2), 1)[0][0]
    magnetic = PAPER_BEAM.mass * (2 * np.pi * frequency) ** 2 - STIFFNESS
    lengths = np.sqrt(magnetic[:8] / SOFTENING[:8])
    assert lengths.min() == pytest.approx(26e-6, abs=0.6e-6) and lengths.max() == pytest.approx(38e-6, abs=0.6e-6)
    assert abs(magnetic[8]) < 2.0
    assert PAPER_BEAM.escape_amplitudes.max() == pytest.approx(1.4e-3, rel=1e-2)


def test_published_posterior_is_the_uniform_over_the_samples():
    for name, values in (("stiffness", STIFFNESS), ("softening", SOFTENING)):
        low, high = values.min(), values.max()
        mean, sd, lower, upper = PAPER_BEAM.posterior[name]
        width = high - low
        assert mean == pytest.approx((low + high) / 2, rel=0.015)
        assert (lower, upper) == pytest.approx((low + 0.025 * width, high - 0.025 * width), rel=0.02)
        # The printed 143.7 GN/m^3 is 14.37 with the point moved: nothing between two bounds can vary by more than half.
        assert (sd if name == "stiffness" else sd / 10) == pytest.approx(width / np.sqrt(12), rel=0.015)
    assert np.corrcoef(STIFFNESS, SOFTENING)[0, 1] == pytest.approx(-0.956, abs=1e-3)


def test_population_is_the_reduced_model():
    assert PAPER_BEAM.oscillator.mass == PAPER_BEAM.mass
    assert PAPER_BEAM.oscillator.parameter_names == ("linear_stiffness", "viscous_damping", "cubic_stiffness")
    np.testing.assert_array_equal(PAPER_BEAM.population[:, 0], STIFFNESS)
    np.testing.assert_array_equal(PAPER_BEAM.population[:, 2], -SOFTENING)
    assert PAPER_BEAM.escape_amplitudes.min() == pytest.approx(35.7e-6, rel=1e-3)
