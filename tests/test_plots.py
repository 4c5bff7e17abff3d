"""Figures: what is drawn, in which unit, and that nothing stays open."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np
import pytest
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text

from pymc_backbone import plots
from pymc_backbone._common.checks import InputError
from pymc_backbone.likelihood.density_fit import fit_density
from pymc_backbone.reporting import style as _figures
from pymc_backbone.reporting.pictures import DPI, png
from pymc_backbone.reporting.posterior_plots import MOST_PARAMETERS

LEVELS = np.linspace(0.002, 0.018, 9)
UNITS = {"linear_stiffness": "N/m", "viscous_damping": "N s/m", "cubic_stiffness": "N/m^3"}
BOUNDS = {"linear_stiffness": (6000.0, 8000.0), "viscous_damping": (0.0, 4.0), "cubic_stiffness": (0.0, 2e7)}
MEANS = {"linear_stiffness": (7000.0, 140.0), "viscous_damping": (1.7, 0.1), "cubic_stiffness": (6e6, 3.6e5)}


@dataclass(frozen=True)
class FakeRecord:
    specimen: str
    time: np.ndarray
    values: np.ndarray
    quantity: str = "displacement"
    unit: str = "m"


def make_backbones(rng: np.random.Generator, specimens: int, noise: float = 1.0, unit: str = "m") -> xr.Dataset:
    k = rng.normal(7000.0, 140.0, (specimens, 1))
    c = rng.normal(1.7, 0.1, (specimens, 1))
    frequency = np.sqrt(k + 0.75 * 6e6 * LEVELS**2) / (2 * np.pi)
    damping = c / (2 * frequency)
    value = np.stack([frequency, damping], axis=1)
    error = noise * np.broadcast_to(np.array([0.005, 0.001])[:, None], value.shape)
    value = value + error * rng.standard_normal(value.shape)
    dims = ("specimen", "observable", "level")
    coordinates = {
        "specimen": [f"s{i}" for i in range(specimens)],
        "observable": ["frequency", "damping"],
        "level": LEVELS,
    }
    dataset = xr.Dataset({"value": (dims, value), "standard_error": (dims, error)}, coords=coordinates)
    return dataset.assign_attrs(amplitude_unit=unit)


@pytest.fixture
def measured(rng: np.random.Generator) -> xr.Dataset:
    return make_backbones(rng, 12)


@pytest.fixture
def posterior(rng: np.random.Generator) -> xr.DataTree:
    draws = {name: (("chain", "draw"), rng.normal(mean, sd, (4, 250))) for name, (mean, sd) in MEANS.items()}
    return xr.DataTree.from_dict({"posterior": xr.Dataset(draws, coords={"chain": range(4), "draw": range(250)})})


def visible(figure: Figure) -> list:
    return [axis for axis in figure.axes if axis.get_visible()]


def drawn_without_overlap(figure: Figure) -> bool:
    """Whether every piece of text stands on the figure and on no other text."""
    FigureCanvasAgg(figure).draw()
    boxes, hidden = {}, undrawn(figure)
    for text in figure.findobj(Text):
        box = text.get_window_extent()
        # Tick labels outside the limits exist but are not drawn.
        if text.get_visible() and text.get_text().strip() and box.width > 0.0 and id(text) not in hidden:
            boxes[f"{text.get_text()} {id(text)}"] = box
    assert boxes
    for name, box in boxes.items():
        assert figure.bbox.padded(1.0).containsx(box.x0) and figure.bbox.padded(1.0).containsx(box.x1), name
        assert figure.bbox.padded(1.0).containsy(box.y0) and figure.bbox.padded(1.0).containsy(box.y1), name
        for other, its_box in boxes.items():
            assert name == other or not box.padded(-1.0).overlaps(its_box.padded(-1.0)), f"{name} runs into {other}"
    return True


def undrawn(figure: Figure) -> set[int]:
    found: set[int] = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            drawn = {id(tick) for tick in axis._update_ticks()} if axes.get_visible() and axes.axison else set()
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
                if id(tick) not in drawn:
                    found |= {id(tick.label1), id(tick.label2)}
    return found


def test_a_picture_is_that_of_savefig_and_leaves_the_figure_as_it_was(measured):
    figure, again = plots.plot_backbones(measured), plots.plot_backbones(measured)
    canvas, dpi, engine = figure.canvas, figure.dpi, figure.get_layout_engine()
    drawn, buffer = png(figure), BytesIO()
    assert (figure.canvas, figure.dpi, figure.get_layout_engine()) == (canvas, dpi, engine)
    again.savefig(buffer, format="png", dpi=DPI)
    buffer.seek(0)
    picture, expected = imread(BytesIO(drawn)), imread(buffer)
    assert picture.shape == expected.shape and picture.std() > 0.01
    np.testing.assert_array_equal(picture, expected)


@pytest.mark.parametrize(("count", "panels"), [(1, 1), (5, 5), (40, 24)])
def test_records_have_a_panel_each_up_to_a_limit(rng, count, panels):
    records = [FakeRecord(f"s{i}", np.arange(50) / 50.0, 0.02 * rng.standard_normal(50)) for i in range(count)]
    figure = plots.plot_records(records)
    assert len(visible(figure)) == panels
    assert figure.get_supylabel() == "Displacement [mm]"
    assert ("24 of 40 records" in figure.get_suptitle()) == (count == 40)
    assert np.max(np.abs(visible(figure)[0].lines[0].get_ydata())) == pytest.approx(
        1e3 * np.max(np.abs(records[0].values))
    )


def test_records_need_one():
    with pytest.raises(InputError, match="at least one record"):
        plots.plot_records([])


def test_backbones_have_a_panel_for_each_observable_and_a_line_for_each_specimen(measured):
    figure = plots.plot_backbones(measured)
    labels = [axis.get_ylabel() for axis in figure.axes]
    assert labels == ["Frequency [Hz]", "Logarithmic decrement per cycle [-]"]
    assert all(axis.get_xlabel() == "Amplitude [mm]" for axis in figure.axes)
    assert all(len(axis.containers) == 12 for axis in figure.axes)
    assert drawn_without_overlap(figure)


def test_angles_are_not_called_millimetres(rng):
    figure = plots.plot_backbones(make_backbones(rng, 3, unit="rad"))
    assert figure.axes[0].get_xlabel() == "Amplitude [rad]"
    assert figure.axes[0].containers[0].lines[0].get_xdata() == pytest.approx(LEVELS)


def test_backbones_with_gaps(measured):
    measured["value"][3, :, -2:] = np.nan
    measured["standard_error"][3, :, -2:] = np.nan
    for figure in (plots.plot_backbones(measured), plots.plot_densities(measured, fit_density(measured))):
        assert drawn_without_overlap(figure)


def test_predictive_band_is_the_central_95_percent(measured, rng):
    simulated = make_backbones(rng, 400, noise=0.0)
    figure = plots.plot_predictive(measured, simulated)
    band = figure.axes[0].collections[0].get_paths()[0].vertices[:, 1]
    drawn = simulated["value"].sel(observable="frequency").values
    assert band.max() == pytest.approx(np.percentile(drawn, 97.5, axis=0).max())
    assert band.min() == pytest.approx(np.percentile(drawn, 2.5, axis=0).min())
    ticks = [text.get_text() for text in figure.axes[2].get_xticklabels()]
    assert ticks == ["2", "10", "18"]  # lowest, middle and highest level, in millimetres
    assert drawn_without_overlap(figure)


def test_predictive_needs_the_same_levels(measured):
    with pytest.raises(InputError, match="at the levels of"):
        plots.plot_predictive(measured, measured.assign_coords(level=LEVELS * 1.01))


def test_densities_draw_the_fitted_marginals(measured, rng):
    density = fit_density(measured, marginal="normal")
    figure = plots.plot_densities(measured, density, simulated=make_backbones(rng, 300, noise=0.0))
    assert len(visible(figure)) == 2 * 6
    axis = figure.axes[0]
    (curve,) = [line for line in axis.lines if line.get_label() == "fitted density"]
    value = measured["value"].sel(observable="frequency").values[:, 0]
    top = np.max(curve.get_ydata())
    assert top == pytest.approx(1 / (np.sqrt(2 * np.pi) * value.std(ddof=1)), rel=0.01)  # grid of 400 points
    assert axis.get_title() == "at 2 mm"
    assert drawn_without_overlap(figure)


def test_prior_and_posterior_in_readable_units(posterior):
    figure = plots.plot_prior_posterior(
        posterior, BOUNDS, units=UNITS, true_values={"cubic_stiffness": np.full(3, 6e6)}
    )
    assert [axis.get_xlabel() for axis in figure.axes[::2]] == [
        "Linear stiffness [N/m]",
        "Viscous damping [N s/m]",
        "Cubic stiffness [$10^{6}$ N/m$^{3}$]",
    ]
    axis = figure.axes[4]
    prior = next(line for line in axis.lines if line.get_label() == "prior")
    assert prior.get_xdata().max() == pytest.approx(20.0)
    curve = next(line for line in axis.lines if line.get_label() == "posterior")
    assert np.trapezoid(curve.get_ydata(), curve.get_xdata()) == pytest.approx(1.0, abs=0.01)
    assert drawn_without_overlap(figure)


def test_posterior_does_not_fall_off_at_a_hard_bound(rng):
    draws = np.abs(rng.normal(0.0, 1.0, 20_000))
    x, density = _figures.smooth(draws, 0.0, 10.0)
    assert x[0] > 0.0
    assert density[0] == pytest.approx(2 / np.sqrt(2 * np.pi), rel=0.06)  # half-normal at zero


@pytest.mark.parametrize("name", ["plot_trace", "plot_rank", "plot_pair"])
def test_arviz_figures_are_labelled_and_closed(posterior, name):
    from matplotlib import pyplot

    figure = getattr(plots, name)(posterior, list(UNITS), units=UNITS)
    assert pyplot.get_fignums() == []
    texts = {text.get_text() for text in figure.findobj(lambda artist: hasattr(artist, "get_text"))}
    assert any("Cubic stiffness [$10^{6}$ N/m$^{3}$]" in text for text in texts)
    assert drawn_without_overlap(figure)


def test_ranks_show_chains_that_do_not_mix(rng, posterior):
    """Four chains, each on a place of its own: thinned to independent draws, next to nothing would be left to rank."""
    apart = posterior["posterior"].to_dataset() + 1e-3 * xr.DataArray(np.arange(4.0), dims="chain")
    stuck = apart.isel(draw=[0]).drop_vars("draw").squeeze() + 1e-9 * xr.DataArray(
        rng.normal(size=(4, 250)), dims=("chain", "draw")
    )
    reach = {}
    for label, tree in (("stuck", xr.DataTree.from_dict({"posterior": stuck})), ("good", posterior)):
        figure = plots.plot_rank(tree, list(UNITS), units=UNITS)
        reach[label] = max(np.ptp(line.get_ydata()) for axis in figure.axes for line in axis.lines)
        title = figure.get_suptitle()
        assert ("too few to tell" in title) == (label == "stuck") == ("p below" not in title)
    assert reach["stuck"] > 5.0 * reach["good"]


def test_many_specimens_are_not_all_drawn(rng):
    draws = xr.Dataset({"k": (("chain", "draw", "specimen"), rng.normal(size=(2, 100, 40)))})
    figure = plots.plot_trace(xr.DataTree.from_dict({"posterior": draws}))
    assert len(figure.axes) == 2 * MOST_PARAMETERS


@pytest.mark.parametrize(
    ("largest", "unit", "expected"),
    [(0.02, "m", (1e3, "m")), (2.0, "m", (1.0, "")), (3e-6, "m", (1e6, "μ")), (0.02, "rad", (1.0, ""))],
)
def test_prefix_of_the_amplitude(largest, unit, expected):
    assert _figures.engineering(largest, unit) == expected


def test_every_specimen_has_a_density_of_its_own(rng):
    centres = np.array([6000.0, 6400.0, 6800.0])
    draws = rng.normal(centres, 10.0, size=(2, 500, 3))
    posterior = xr.DataTree.from_dict({"posterior": xr.Dataset({"k": (("chain", "draw", "specimen"), draws)})})
    figure = plots.plot_prior_posterior(posterior, {"k": (5000.0, 8000.0)})
    curves = [line for line in figure.axes[0].lines if len(line.get_xdata()) > 4]
    assert len(curves) == 3
    for curve, centre in zip(curves, centres, strict=True):
        x, density = curve.get_xdata(), curve.get_ydata()
        mean = np.trapezoid(x * density, x)
        assert mean == pytest.approx(centre, abs=3.0)
        assert np.sqrt(np.trapezoid((x - mean) ** 2 * density, x)) == pytest.approx(10.0, rel=0.15)
    texts = [text.get_text() for text in figure.axes[0].get_legend().get_texts()] if figure.axes[0].get_legend() else [
        text.get_text() for legend in figure.legends for text in legend.get_texts()]  # fmt: skip
    assert texts == ["posterior of each specimen", "prior", "95 % HDI of each specimen"]


@pytest.mark.parametrize("name", ["plot_trace", "plot_rank"])
def test_specimens_that_are_not_drawn_are_said(name, rng):
    draws = rng.normal(size=(2, 200, 6))
    variables = {label: (("chain", "draw", "specimen"), draws) for label in ("a", "b", "c", "d")}
    coords = {"chain": [0, 1], "draw": np.arange(200), "specimen": [f"s{i}" for i in range(6)]}
    posterior = xr.DataTree.from_dict({"posterior": xr.Dataset(variables, coords=coords)})
    assert "the first 3 of 6 specimens" in getattr(plots, name)(posterior).get_suptitle()
    assert "first" not in getattr(plots, name)(posterior, ["a"]).get_suptitle()


def test_intervals_of_specimens_do_not_lie_on_each_other(rng):
    draws = rng.normal(7000.0, 10.0, (2, 200, 5))
    tree = xr.DataTree.from_dict(
        {"posterior": xr.Dataset({"linear_stiffness": (("chain", "draw", "specimen"), draws)})}
    )
    figure = plots.plot_prior_posterior(tree, {"linear_stiffness": BOUNDS["linear_stiffness"]}, units=UNITS)
    for axis in figure.axes:
        rows = [line.get_ydata()[0] for line in axis.lines if line.get_linewidth() == 1.8]
        assert len(rows) == 5 and len(set(rows)) == 5 and max(rows) < 0.0
        assert axis.get_ylim()[0] < min(rows)


def test_figures_of_the_posterior_show_large_values_whole(rng):
    draws = {"linear_stiffness": (("chain", "draw"), rng.normal(6840.2, 0.2, (2, 100)))}
    draws["viscous_damping"] = (("chain", "draw"), rng.normal(2.50026, 2e-5, (2, 100)))
    posterior = xr.DataTree.from_dict({"posterior": xr.Dataset(draws)})
    for figure in (
        plots.plot_trace(posterior, units=UNITS),
        plots.plot_pair(posterior, units=UNITS),
        plots.plot_prior_posterior(posterior, {name: BOUNDS[name] for name in draws}, units=UNITS),
    ):
        FigureCanvasAgg(figure).draw()
        offsets = [side.get_offset_text().get_text() for axis in figure.axes for side in (axis.xaxis, axis.yaxis)]
        assert set(offsets) == {""}


def test_a_long_record_keeps_its_envelope_and_its_spike(rng):
    time = np.arange(300_001) / 5e4
    values = 0.004 * np.exp(-time) * np.cos(2.0 * np.pi * 80.0 * time)
    values[123_456] = 0.0061
    line = plots.plot_records([FakeRecord("long", time, values)]).axes[0].lines[0]
    x, y = line.get_xdata(), line.get_ydata()
    assert len(x) < 30_000 and np.all(np.diff(x) >= 0.0)
    assert y.max() == pytest.approx(6.1) and x[np.argmax(y)] == time[123_456] and y.min() == 1e3 * values.min()
    short = FakeRecord("short", time[:500], values[:500])
    assert len(plots.plot_records([short]).axes[0].lines[0].get_xdata()) == 500
