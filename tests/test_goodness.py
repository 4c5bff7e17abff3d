"""The check of the fit: right models pass as often as the p-value says, wrong ones do not, and the words say why."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex
from scipy import stats

import pymc_backbone as pb
from pymc_backbone._common.backbone_dataset import backbone_dataset
from pymc_backbone.inference.fit_verdict import ExcludedBy, FitEntry, GoodnessOfFit, SpecimenFit
from pymc_backbone.inference.refit import refit
from pymc_backbone.measurement.extraction import measure_batch
from pymc_backbone.reporting.portable import plain
from pymc_backbone.simulation.response import make_response

MASS = 1.0
OMEGA = 2.0 * np.pi * 10.0
STIFFNESS, DAMPING, CUBIC, FRICTION = MASS * OMEGA**2, 1.2, 4e6, 0.15
LEVELS = np.array([0.001, 0.002, 0.003, 0.005, 0.007, 0.01])
RELATIVE = {"frequency": 2e-4, "damping": 0.01}
LINEAR = pb.Oscillator(MASS, ())
DUFFING = pb.Oscillator(MASS, ["cubic_stiffness"])
BOUNDS = {"linear_stiffness": (2000.0, 8000.0), "viscous_damping": (0.0, 5.0), "cubic_stiffness": (0.0, 2e7)}


def measured(
    rng: np.random.Generator | None, *, n: int = 3, cubic: float = 0.0, friction: float = 0.0, scatter: float = 0.02
) -> xr.Dataset:
    """Level values of specimens; errors are independent and Gaussian."""
    model = pb.Oscillator(MASS, ["coulomb_friction", "cubic_stiffness"])
    true = {
        "linear_stiffness": STIFFNESS,
        "viscous_damping": DAMPING,
        "friction_force": friction,
        "cubic_stiffness": cubic,
    }
    values = []
    for s in range(n):
        apart = 1.0 + scatter * np.cos(2.4 * s)
        theta = np.array([true[name] * apart for name in model.parameter_names])
        values.append(pb.simulate_backbone(model, theta, LEVELS).values[:2])
    value = np.array(values)
    error = value * np.array([RELATIVE["frequency"], RELATIVE["damping"]])[:, None]
    if rng is not None:
        value = value + error * rng.standard_normal(value.shape)
    names = [f"S{s + 1}" for s in range(n)]
    covariance = error[..., None] ** 2 * np.eye(LEVELS.size)
    return backbone_dataset(names, ("frequency", "damping"), LEVELS, value, covariance, "m", [])


def drawn(model: pb.Oscillator, data: xr.Dataset, kind: str, rng: np.random.Generator, **at: float) -> xr.DataTree:
    """A posterior that is about right: 40 draws within a per mille or so of the middle, wherever the best fit is."""
    n = data.sizes["specimen"]
    middle = {"linear_stiffness": STIFFNESS, "viscous_damping": DAMPING, "cubic_stiffness": CUBIC, **at}
    size, dims = ((1, 40, n), ("chain", "draw", "specimen")) if kind == "specimen" else ((1, 40), ("chain", "draw"))
    draws = {name: (dims, middle[name] * (1.0 + 1e-3 * rng.standard_normal(size))) for name in model.parameter_names}
    return xr.DataTree.from_dict({"posterior": xr.Dataset(draws)})


def check(model, data, kind, rng, bounds=BOUNDS, **at):
    posterior = drawn(model, data, kind, rng, **at)
    return pb.goodness_of_fit(model, data, posterior, bounds, likelihood=kind, random_seed=1)


def test_p_value_of_the_right_model_is_uniform(rng):
    """Sixty batches; a Kolmogorov-Smirnov test at 0.1 %: the seed is fixed, so this never fails by chance."""
    fits = [check(DUFFING, measured(rng, n=2, cubic=CUBIC), "specimen", rng) for _ in range(60)]
    assert stats.kstest([fit.p_value for fit in fits], "uniform").pvalue > 1e-3
    # 2 specimens x (12 values - 3 parameters)
    assert {fit.degrees_of_freedom for fit in fits} == {18}
    assert np.mean([fit.reduced_chi_square for fit in fits]) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 18 / 60))


def test_p_value_without_correction_for_what_was_fitted_would_not_be_uniform(rng):
    """Negative control of the test above: as many degrees of freedom as values make the p-values too large."""
    fits = [check(DUFFING, measured(rng, n=2, cubic=CUBIC), "specimen", rng) for _ in range(60)]
    uncorrected = [stats.chi2.sf(sum(one.chi_square for one in fit.specimens), 24) for fit in fits]
    assert stats.kstest(uncorrected, "uniform").pvalue < 1e-3


def test_values_read_off_smooth_curves_count_as_what_they_tell(rng):
    """Whole records of a linear oscillator: 20 level values and two parameters, but no 18 independent ones.

    With as many degrees of freedom as values every p-value of what is right lies near one: the negative control.
    """
    time = np.arange(0.0, 30 * 2.0 * np.pi / OMEGA, 2.0 * np.pi / OMEGA / 25)
    ratio = DAMPING / (2.0 * MASS * OMEGA)
    exact = 0.01 * np.exp(-ratio * OMEGA * time) * np.cos(OMEGA * np.sqrt(1.0 - ratio**2) * time)
    records = [pb.Record(f"s{i}", time, exact + 3e-5 * rng.standard_normal(time.size)) for i in range(24)]
    backbones = measure_batch(records).backbones
    fit = check(LINEAR, backbones, "specimen", rng)
    p_values = np.array([one.p_value for one in fit.specimens])
    # The noise is known to some 20 %: reduced chi-squares of 0.75 to 1, whose mean over 24 specimens of 8 degrees each
    # is known to 0.1 by counting.
    assert 0.6 < fit.reduced_chi_square < 1.25 and 5.0 < fit.degrees_of_freedom / 24 < 12.0
    assert 0.1 < np.mean(p_values < 0.5) < 0.75 and p_values.min() > 1e-3
    counted = check(LINEAR, backbones.drop_vars("noise_covariance"), "specimen", rng)
    assert counted.degrees_of_freedom == 18 * 24 and counted.reduced_chi_square < 0.4
    assert min(one.p_value for one in counted.specimens) > 0.5


@pytest.mark.parametrize("kind", ["specimen", "pooled", "population"])
def test_missing_friction_is_said_first_and_with_numbers(kind, rng):
    data = measured(rng, n=9 if kind == "population" else 3, friction=FRICTION, scatter=0.001)
    fit = check(LINEAR, data, kind, rng)
    assert not fit.passes and fit.p_value < 1e-6 and fit.reduced_chi_square > 100.0
    assert fit.worst.observable == "damping" and fit.worst.level == LEVELS[0]
    # What is printed is what was measured, and what a linear model gives: 2 pi c / (2 m w_d), to its own precision.
    assert fit.worst.predicted == pytest.approx(np.pi * DAMPING / (MASS * OMEGA), rel=2e-3)
    held = data["value"].sel(observable="damping", level=LEVELS[0])
    expected = held.mean() if kind == "population" else held.sel(specimen=fit.worst.specimen)
    assert fit.worst.measured == pytest.approx(float(expected))
    first = pb.findings(drawn(LINEAR, data, kind, rng), fit=fit)[0]
    assert first.startswith("The model does not fit: damping at 0.001 m")
    assert "`find_missing_effect`" in first and f"{fit.worst.predicted:.3g}"[:4] in first
    assert "run `pymc-backbone diagnose`" in fit.sentences("run `pymc-backbone diagnose`")[0]


@pytest.mark.parametrize("kind", ["specimen", "population"])
def test_right_model_of_scattered_specimens_passes(kind, rng):
    data = measured(rng, n=9 if kind == "population" else 3, cubic=CUBIC, scatter=0.02)
    posterior = drawn(DUFFING, data, kind, rng)
    if kind == "population":  # as wide as the batch
        for name in DUFFING.parameter_names:
            posterior["posterior"][name] = posterior["posterior"][name] * (1 + 0.015 * rng.standard_normal((1, 40)))
    fit = pb.goodness_of_fit(DUFFING, data, posterior, BOUNDS, likelihood=kind)
    assert fit.passes and fit.sentences() == [] and "fits the measurement" in fit.sentence()


def test_pooling_specimens_that_differ_is_named_and_is_no_misfit(rng):
    fit = check(DUFFING, measured(rng, cubic=CUBIC, scatter=0.02), "pooled", rng)
    assert fit.describes_specimens and not fit.passes and fit.pooling_p_value < 1e-6
    (sentence,) = fit.sentences()
    assert sentence.startswith("The specimens differ by more than measurement error")


def test_pooling_specimens_that_are_alike_passes_as_often_as_it_should(rng):
    fits = [check(DUFFING, measured(rng, cubic=CUBIC, scatter=0.0), "pooled", rng) for _ in range(40)]
    assert stats.kstest([fit.pooling_p_value for fit in fits], "uniform").pvalue > 1e-3


def test_prior_that_excludes_the_data_is_named_as_such(rng):
    bounds = {**BOUNDS, "linear_stiffness": (0.5, 2.0)}
    data = measured(rng)
    fit = check(LINEAR, data, "specimen", rng, bounds, linear_stiffness=1.5, viscous_damping=0.01)
    (one,) = [item for item in fit.excluded if item.parameter == "linear_stiffness"]
    assert (one.side, one.bound) == ("upper", 2.0) and one.asked == pytest.approx(STIFFNESS, rel=0.05)
    first = fit.sentences()[0]
    assert first.startswith("The prior of ") and "excludes the data" in first
    assert not any("does not fit" in sentence for sentence in fit.sentences())


def test_prior_is_not_blamed_for_a_model_that_lacks_something(rng):
    bounds = {**BOUNDS, "viscous_damping": (0.0, DAMPING)}
    fit = check(LINEAR, measured(rng, friction=FRICTION), "specimen", rng, bounds)
    assert fit.excluded == () and "does not fit" in fit.sentences()[0]


def test_parameter_at_its_physical_limit_does_not_count_as_fitted(rng):
    """Friction that is not there ends at zero half of the time; the p-value stays uniform."""
    model = pb.Oscillator(MASS, ["coulomb_friction"])
    bounds = {**BOUNDS, "friction_force": (0.0, 0.5)}
    fits = [check(model, measured(rng, n=1), "pooled", rng, bounds, friction_force=1e-3) for _ in range(60)]
    assert {fit.degrees_of_freedom for fit in fits} == {9, 10}
    assert stats.kstest([fit.p_value for fit in fits], "uniform").pvalue > 1e-3


def test_one_bad_specimen_among_good_ones_is_named(rng):
    data = measured(rng, n=6, cubic=CUBIC)
    data["value"][4, 1, 0] *= 1.5
    fit = check(DUFFING, data, "specimen", rng)
    assert [one.specimen for one in fit.bad_specimens] == ["S5"]
    assert any("parameters of its own: S5" in sentence for sentence in fit.sentences())


def test_a_population_that_comes_out_too_narrow_is_said(rng):
    """One posterior is as wide as the batch, one a tenth of that, as products of many levels make it; both fit."""
    data = measured(rng, n=12, cubic=CUBIC, scatter=0.02)
    fits = []
    for wide in (1.0, 0.1):
        posterior = drawn(DUFFING, data, "population", rng)
        for name in DUFFING.parameter_names:
            factor = 1.0 + wide * 0.015 * rng.standard_normal((1, 40))
            posterior["posterior"][name] = posterior["posterior"][name] * factor
        fits.append(pb.goodness_of_fit(DUFFING, data, posterior, BOUNDS, likelihood="population"))
    wide, narrow = fits
    assert wide.narrow == () and wide.sentences() == []
    assert narrow.narrow and narrow.describes_specimens
    worst = narrow.narrow[0]
    held = data["value"].sel(observable=worst.observable, level=worst.level)
    error = data["standard_error"].sel(observable=worst.observable, level=worst.level)
    assert worst.measured**2 == pytest.approx(float(held.var(ddof=1) - (error**2).mean()))
    assert worst.simulated < 0.5 * worst.measured
    assert any("narrower than it was measured" in sentence for sentence in narrow.sentences())
    assert narrow.as_dict()["narrow"][0]["level"] == worst.level
    # chance: of three specimens a variance five times as large proves nothing, of twelve it does
    posterior = drawn(DUFFING, data, "population", rng)
    for name in DUFFING.parameter_names:
        factor = 1.0 + 0.4 * 0.015 * rng.standard_normal((1, 40))
        posterior["posterior"][name] = posterior["posterior"][name] * factor
    few = data.isel(specimen=slice(0, 3))
    assert pb.goodness_of_fit(DUFFING, few, posterior, BOUNDS, likelihood="population").narrow == ()
    assert pb.goodness_of_fit(DUFFING, data, posterior, BOUNDS, likelihood="population").narrow != ()


def test_population_without_standard_errors_is_judged_by_signs(rng):
    def without(data: xr.Dataset) -> xr.Dataset:
        return data.assign(standard_error=0.0 * data["standard_error"], covariance=0.0 * data["covariance"])

    right = check(DUFFING, without(measured(rng, n=10, cubic=CUBIC)), "population", rng)
    wrong = check(LINEAR, without(measured(rng, n=10, friction=FRICTION)), "population", rng)
    exact = check(DUFFING, without(measured(None, n=10, cubic=CUBIC)), "population", rng)
    # 2^10 patterns of signs, so p cannot go far below 1 / 512
    assert right.p_value > 0.01 > wrong.p_value and exact.p_value == 1.0
    assert np.isnan(right.reduced_chi_square)


def test_as_many_parameters_as_values_is_said_not_praised(rng):
    data = measured(rng, n=1).isel(level=[0], level_other=[0])
    fit = check(LINEAR, data, "pooled", rng)
    assert not fit.passes and np.isnan(fit.p_value) and fit.degrees_of_freedom == 0
    assert fit.sentences() == [
        "Whether the model fits cannot be checked: there are no more level values than parameters; use more levels, or "
        "fix parameters."
    ]


def test_function_as_a_model_is_checked_too(rng):
    def linear(p, levels):
        frequency = np.sqrt(p["linear_stiffness"] / MASS) / (2.0 * np.pi)
        return np.vstack([np.full(levels.size, frequency), np.full(levels.size, p["viscous_damping"] / 20.0)])

    data = measured(rng, n=1)
    posterior = drawn(LINEAR, data, "pooled", rng)
    fit = pb.goodness_of_fit(linear, data, posterior, {name: BOUNDS[name] for name in LINEAR.parameter_names})
    assert fit.degrees_of_freedom == 10 and fit.describes_specimens


def test_missing_parameter_is_asked_for(rng):
    data = measured(rng)
    with pytest.raises(pb.InputError, match="'cubic_stiffness' is in neither"):
        pb.goodness_of_fit(DUFFING, data, drawn(LINEAR, data, "pooled", rng))


def test_refit_finds_the_weighted_least_squares_of_a_line():
    """Against NumPy: a response that is linear in its parameters."""
    levels = np.array([1.0, 2.0, 3.0, 4.0])

    def line(p, x):
        return (p["a"] + p["b"] * x)[None]

    response = make_response(line, levels, ("frequency",), parameter_names=("a", "b"))
    values, weights = np.array([1.0, 2.2, 2.9, 4.3]), np.array([1.0, 2.0, 0.5, 1.0])
    limits = np.array([-50.0, -50.0]), np.array([50.0, 50.0])
    found = refit(response, values, np.diag(weights), np.array([5.0, -3.0]), *limits)
    b, a = np.polyfit(levels, values, 1, w=weights)
    assert found.point == pytest.approx([a, b], abs=1e-3) and found.fitted == 2
    held = refit(response, values, np.diag(weights), np.array([5.0, -3.0]), limits[0], np.array([50.0, 0.5]))
    assert held.at_high[1] and held.fitted == 1 and held.point[1] == 0.5


def test_words_and_numbers_survive_json():
    entry = FitEntry("S1", "damping", 0.001, 0.362, 0.002, 0.036, 0.035, 0.037, 0.0, 150.0)
    one = SpecimenFit("S1", 900.0, 9, 100.0, 0.0)
    fit = GoodnessOfFit("specimen", 0.0, 100.0, 9, (one,), (entry,), excluded=(ExcludedBy("k", "upper", 1.0, 9.0),))
    held = json.loads(json.dumps(plain(fit.as_dict())))
    assert held["worst"]["measured"] == 0.362 and held["prior_excludes"][0]["parameter"] == "k"
    assert fit.describe(entry) == (
        "damping at 0.001 m is ten times what the model gives, 0.362 measured, 0.0360 simulated"
    )


@pytest.mark.parametrize(
    ("measured_value", "predicted", "words"),
    [
        (0.2, 0.1, "is twice what"),
        (14.3, 13.39, "is 6.80 % above what the model gives, 14.30 Hz measured, 13.39 Hz simulated"),
        (0.196, 12.0, "is 1/61 of what"),
        (12.34, 12.35, "is 0.08 % below what the model gives, 12.3400 Hz measured, 12.3500 Hz simulated"),
    ],
)
def test_difference_is_said_as_an_engineer_would(measured_value, predicted, words):
    entry = FitEntry("S1", "frequency", 0.001, measured_value, 0.01, predicted, predicted, predicted, 0.0, 9.0)
    fit = GoodnessOfFit("specimen", 0.0, 9.0, 9, (), (entry,))
    assert words in fit.describe(entry)


def test_figure_of_a_batch_says_that_each_specimen_has_a_colour(rng):
    data = measured(rng, friction=FRICTION)
    figure = pb.plots.plot_fit(data, check(LINEAR, data, "pooled", rng))
    assert figure.legends[0].get_texts()[0].get_text() == "measured, 95 % error; a colour each"
    drawn = [line for line in figure.axes[0].lines if line.get_marker() == "o" and len(line.get_xdata())]
    colours = {to_hex(line.get_color()) for line in drawn}
    assert len(colours) == data.sizes["specimen"]


def test_figure_of_the_fit_shows_what_was_measured_and_the_median(rng):
    data = measured(rng, friction=FRICTION)
    fit = check(LINEAR, data, "specimen", rng)
    figure = pb.plots.plot_fit(data, fit, most=2)
    assert "2 of 3 specimens" in figure.get_suptitle() and "does not fit" in figure.get_suptitle()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "posterior predictive, median", "posterior predictive, 95 %", "measured, 95 % error"
    ]  # fmt: skip
    first_damping, last_damping = figure.axes[1], figure.axes[-1]
    median = next(line for line in first_damping.lines if line.get_color() == "#D55E00").get_ydata()
    assert median == pytest.approx(np.median(fit.draws[0][:, 1], axis=0))
    points = [line.get_ydata() for line in first_damping.lines if line.get_marker() == "o"]
    assert any(np.allclose(y, data["value"][0, 1]) for y in points if len(y) == LEVELS.size)
    # all three specimens in the differences, and the largest one inside the axis
    z = [entry.z for entry in fit.entries if entry.observable == "damping"]
    drawn_z = np.concatenate([line.get_ydata() for line in last_damping.lines if line.get_marker() == "o"])
    assert sorted(drawn_z) == pytest.approx(sorted(z)) and last_damping.get_ylim()[1] >= max(z)
