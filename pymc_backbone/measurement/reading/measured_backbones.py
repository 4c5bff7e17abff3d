"""Directly measured backbones as a Dataset at common levels.

Stepped sine under response control, control-based continuation and phase-locked loops give amplitude and frequency
without a free decay.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from ..._common.checks import OBSERVABLES, FloatArray, InputError, check_levels
from ..._common.text import natural_key, printable, shorten
from .columns import find_specimens
from .formats.netcdf import open_netcdf
from .measured_curves import MeasuredCurve, ordered, with_errors
from .tables import Column, Table, list_tables, read_table
from .units import OF_POWER, Unit, parse_envelope_unit, require_unit

DEFAULT_LEVELS = 8
NETCDF = ".nc"
_DIMS = ("specimen", "observable", "level")
_ERROR_SUFFIXES = ("_error", "_standard_error", "_se", "_sd", "_std")


def read_backbones(path: str | os.PathLike[str], *, levels: ArrayLike | None = None) -> xr.Dataset:
    r"""Read backbone tables and interpolate every specimen to common amplitude levels.

    Parameters
    ----------
    path : str or path
        A folder of ``.csv`` files (one specimen each), one such file, or one file with a further
        column ``specimen``; or a ``.nc`` file as this package writes it, which is taken as it is, with its
        covariance. Columns ``amplitude`` (m or rad, or another unit in brackets), ``frequency``
        [Hz], optionally ``damping`` (logarithmic decrement per cycle) or ``damping_ratio``, and
        ``offset`` (mid-line over amplitude); standard errors in ``frequency_error``, ``damping_error``,
        ``offset_error`` (``_standard_error``, ``_se``, ``_sd`` and ``_std`` are understood too).
    levels : array_like, optional
        Amplitude levels [m or rad], increasing; by default up to 8, evenly spaced in log amplitude over the range
        all specimens share.

    Returns
    -------
    xarray.Dataset
        ``value`` and ``standard_error`` over ``(specimen, observable, level)``, NaN where a specimen
        does not reach a level, ``covariance`` over ``(specimen, observable, level, level_other)``;
        attributes ``amplitude_unit`` and ``notes``.

    Raises
    ------
    InputError
        When a table cannot be used (file, line and column are named), units differ between
        specimens, or the specimens share no range of amplitudes.

    See Also
    --------
    write_backbones : writes them.
    backbones_at_levels : makes them from records.

    Notes
    -----
    Values are interpolated monotonically (PCHIP) in log amplitude. Errors are propagated through the weights of
    linear interpolation in log amplitude, which are positive and do not depend on the values: two
    levels between the same two points have correlated errors, and ``covariance`` says so. Where a
    table states no errors they are estimated, when there are at least 6 points, from the scatter
    about a quadratic in log amplitude, and are NaN otherwise.

    A damping ratio :math:`\zeta` becomes :math:`\delta = 2\pi\zeta/\sqrt{1-\zeta^2}`.
    """
    if Path(path).suffix.lower() == NETCDF:
        return _read_netcdf(Path(path), None if levels is None else check_levels(levels))
    curves: dict[str, MeasuredCurve] = {}
    for file in list_tables(path):
        for curve in _curves_of(read_table(file)):
            if curve.specimen in curves:
                curve.fail(
                    f"specimen {shorten(curve.specimen)!r} is also in {curves[curve.specimen].source}; rename it."
                )
            curves[curve.specimen] = curve
    ordered = [with_errors(curves[name]) for name in sorted(curves, key=natural_key)]
    units = sorted({curve.unit for curve in ordered})
    if len(units) > 1:
        other = next(curve for curve in ordered if curve.unit != ordered[0].unit)
        other.fail(f"amplitude is in {other.unit} but in {ordered[0].unit} in {ordered[0].source}; use one unit.")
    chosen = _default_levels(ordered) if levels is None else _inside(check_levels(levels), ordered)
    return _dataset(ordered, chosen, units[0])


def _read_netcdf(path: Path, levels: FloatArray | None) -> xr.Dataset:
    """Return backbones at levels as they were written, or those at some of their levels."""
    with open_netcdf(path) as file:
        data = file.load()
    dims = {"value": _DIMS, "standard_error": _DIMS, "covariance": (*_DIMS, "level_other")}
    wrong = [name for name, wanted in dims.items() if name not in data or data[name].dims != wanted]
    wrong += [name for name in dims if name in data and data[name].dtype.kind not in "fi"]
    wrong += [name for name in _DIMS if name not in data.coords or data[name].size == 0]
    if wrong or any(name not in OBSERVABLES for name in map(str, data["observable"].values)):
        raise InputError(
            f"{path} does not hold backbones as `pymc-backbone` writes them ({', '.join(wrong) or 'observable'} "
            "missing or of another shape); read the .csv file beside it."
        )
    try:
        check_levels(data["level"].values)
    except InputError as error:
        raise InputError(f"{path}: {error} Write the file again.") from None
    notes = data.attrs.get("notes", [])
    data.attrs["notes"] = [str(note) for note in np.atleast_1d(notes) if str(note)]
    if levels is None:
        return data
    held = np.asarray(data["level"], dtype=float)
    index = np.abs(held[None] - levels[:, None]).argmin(axis=1)
    if not np.allclose(held[index], levels, rtol=1e-9, atol=0.0):
        raise InputError(f"{path} holds values at fixed levels; drop the levels, or read the .csv file beside it.")
    return data.isel(level=index, level_other=index)


def _curves_of(table: Table) -> list[MeasuredCurve]:
    """Return the curves of one table, in SI units, sorted by amplitude."""
    amplitude_column = _find(table, "amplitude")
    frequency_column = _find(table, "frequency")
    has_damping = any(_find(table, name) is not None for name in ("damping", "damping_ratio"))
    if amplitude_column is None or (frequency_column is None and not has_damping):
        missing = "amplitude" if amplitude_column is None else "frequency"
        table.fail(
            f"expected columns 'amplitude' and 'frequency', found {table.found}; name {missing!r} in the header.",
            table.header_line,
        )
    notes: list[str] = list(table.notes)
    where = f"{table.name}, column {shorten(amplitude_column.header)!r}"
    of_envelope = parse_envelope_unit(amplitude_column.unit or "m")
    if of_envelope is not None and of_envelope.law == "amplitude" and of_envelope.si in ("V", "1", OF_POWER):
        unit = Unit(of_envelope.written, of_envelope.factor, of_envelope.si)
    else:
        unit = require_unit(amplitude_column.unit or "m", "displacement", where)
    if amplitude_column.unit is None:
        notes.append("the header states no unit of amplitude: m was assumed")
    amplitude = table.numbers(amplitude_column) * unit.factor
    bad = np.flatnonzero(~(amplitude > 0.0))
    if bad.size:
        table.fail("amplitude must be positive; remove the line.", table.lines[bad[0]], amplitude_column)
    values, errors = {}, {}
    if frequency_column is not None:
        values["frequency"], errors["frequency"] = _observable(table, "frequency", "frequency", "Hz")
    else:
        notes.append("the table has no column of frequencies: damping alone was read")
    if _find(table, "damping") is not None:
        values["damping"], errors["damping"] = _observable(table, "damping", "ratio", "1")
        if _find(table, "damping_ratio") is not None:
            notes.append("column damping was used, damping_ratio was not")
    elif _find(table, "damping_ratio") is not None:
        values["damping"], errors["damping"] = _decrement(table)
        notes.append("damping ratio was converted to the logarithmic decrement")
    if _find(table, "offset") is not None:
        values["offset"], errors["offset"] = _observable(table, "offset", "ratio", "1")
    low = np.flatnonzero(~(values.get("frequency", np.ones(1)) > 0.0))
    if low.size and frequency_column is not None:
        table.fail("frequency must be positive; remove the line.", table.lines[low[0]], frequency_column)
    curves = []
    for specimen, rows in find_specimens(table).items():
        source = table.name if len(set(rows)) == len(table.lines) else f"{table.name} (specimen {printable(specimen)})"
        curve = MeasuredCurve(
            specimen,
            source,
            unit.si,
            amplitude[rows],
            {name: value[rows] for name, value in values.items()},
            {name: error[rows] for name, error in errors.items()},
            tuple(f"{source}: {note}" for note in notes),
        )
        curves.append(ordered(curve))
    return curves


def _find(table: Table, name: str) -> Column | None:
    """Return the column of that name (spaces and hyphens count as underscores), or None."""
    aliases = {name, "zeta"} if name == "damping_ratio" else {name}
    if name == "damping":
        aliases |= {"logarithmic_decrement", "decrement"}
    found = [c for c in table.columns if c.name.lower().replace(" ", "_").replace("-", "_") in aliases]
    if len(found) > 1:
        table.fail(f"expected one column {name!r}, found {len(found)}; remove one.", table.header_line)
    return found[0] if found else None


def _error_column(table: Table, name: str) -> Column | None:
    """Return the column of standard errors of an observable under any of its spellings, or None."""
    found = [column for suffix in _ERROR_SUFFIXES if (column := _find(table, name + suffix)) is not None]
    if len(found) > 1:
        names = ", ".join(repr(shorten(column.header)) for column in found)
        table.fail(f"expected one column of standard errors of {name}, found {names}; remove one.", table.header_line)
    return found[0] if found else None


def _observable(table: Table, name: str, dimension: str, si: str) -> tuple[FloatArray, FloatArray]:
    """Return an observable and its standard errors (NaN when not given) in SI units."""
    column = _find(table, name)
    assert column is not None
    factor = require_unit(column.unit or si, dimension, f"{table.name}, column {shorten(column.header)!r}").factor
    values = table.numbers(column) * factor
    error_column = _error_column(table, name)
    if error_column is None:
        return values, np.full(values.size, np.nan)
    where = f"{table.name}, column {shorten(error_column.header)!r}"
    error_factor = require_unit(error_column.unit, dimension, where).factor if error_column.unit else factor
    errors = table.numbers(error_column) * error_factor
    bad = np.flatnonzero(errors < 0.0)
    if bad.size:
        table.fail("a standard error must not be negative; correct it.", table.lines[bad[0]], error_column)
    return values, errors


def _decrement(table: Table) -> tuple[FloatArray, FloatArray]:
    """Return the logarithmic decrement and its standard errors from the column of damping ratios."""
    column = _find(table, "damping_ratio")
    assert column is not None
    ratio, error = _observable(table, column.name.lower().replace(" ", "_").replace("-", "_"), "ratio", "1")
    if np.isnan(error).all() and _error_column(table, "damping") is not None:
        table.fail(
            "errors of damping without a column 'damping'; rename them to 'damping_ratio_error'.", table.header_line
        )
    bad = np.flatnonzero(np.abs(ratio) >= 1.0)
    if bad.size:
        table.fail("the damping ratio must be below 1; give it as a fraction or in [%].", table.lines[bad[0]], column)
    root = np.sqrt(1.0 - ratio**2)
    return 2.0 * np.pi * ratio / root, 2.0 * np.pi * error / root**3


def _inside(levels: FloatArray, curves: Sequence[MeasuredCurve]) -> FloatArray:
    """Return the levels, of which some specimen reaches one; those that none reaches are left empty."""
    low = min(float(curve.amplitude[0]) for curve in curves)
    high = max(float(curve.amplitude[-1]) for curve in curves)
    if not ((levels >= low * (1.0 - 1e-9)) & (levels <= high * (1.0 + 1e-9))).any():
        unit = curves[0].unit
        raise InputError(
            f"`levels` must lie inside the measured amplitudes, {low:.4g} to {high:.4g} {unit}, got {levels[0]:.4g} to "
            f"{levels[-1]:.4g} {unit}."
        )
    return levels


def _default_levels(curves: Sequence[MeasuredCurve]) -> FloatArray:
    """Return levels evenly spaced in log amplitude over the range all specimens share."""
    lowest = max(curves, key=lambda curve: curve.amplitude[0])
    highest = min(curves, key=lambda curve: curve.amplitude[-1])
    low, high = float(lowest.amplitude[0]), float(highest.amplitude[-1])
    if not low < high:
        raise InputError(
            f"the specimens share no range of amplitudes: {lowest.source} begins at {low:.4g} {lowest.unit}, "
            f"{highest.source} ends at {high:.4g} {highest.unit}; give `levels`, or leave one out."
        )
    levels = np.geomspace(low, high, min(DEFAULT_LEVELS, min(curve.amplitude.size for curve in curves)))
    levels[0], levels[-1] = low, high
    return levels


def _dataset(curves: Sequence[MeasuredCurve], levels: FloatArray, unit: str) -> xr.Dataset:
    """Return the curves interpolated to the levels, in the shape used for measured and simulated backbones alike."""
    observables = [name for name in OBSERVABLES if any(name in curve.values for curve in curves)]
    shape = (len(curves), len(observables), levels.size)
    value, covariance = np.full(shape, np.nan), np.full((*shape, levels.size), np.nan)
    notes = [note for curve in curves for note in curve.notes]
    for i, curve in enumerate(curves):
        inside = (levels >= curve.amplitude[0] * (1.0 - 1e-9)) & (levels <= curve.amplitude[-1] * (1.0 + 1e-9))
        missing = int(np.count_nonzero(~inside))
        if missing:
            notes.append(f"{curve.source}: {missing} of {levels.size} levels lie outside its amplitudes (NaN)")
        if not inside.any():
            continue
        x = np.log(curve.amplitude)
        at = np.clip(np.log(levels[inside]), x[0], x[-1])
        weights = np.stack([np.interp(at, x, unit_row) for unit_row in np.eye(x.size)], axis=1)
        picked = np.ix_(inside, inside)
        for j, name in enumerate(observables):
            if name not in curve.values:
                continue
            value[i, j, inside] = PchipInterpolator(x, curve.values[name])(at)
            covariance[i, j][picked] = (weights * curve.errors[name] ** 2) @ weights.T
    error = np.sqrt(np.diagonal(covariance, axis1=2, axis2=3))
    dims = ("specimen", "observable", "level")
    return xr.Dataset(
        {"value": (dims, value), "standard_error": (dims, error), "covariance": ((*dims, "level_other"), covariance)},
        coords={
            "specimen": [curve.specimen for curve in curves],
            "observable": observables,
            "level": levels,
            "level_other": levels,
        },
        attrs={"amplitude_unit": unit, "notes": notes},
    )
