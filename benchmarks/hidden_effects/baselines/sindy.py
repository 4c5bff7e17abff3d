"""PySINDy: FROLS and STLSQ on scaled variables, their size chosen by one-standard-error cross-validation.

The library holds every memoryless effect. All columns are low-passed with the kernel of the acceleration, which is the
weak form of the equation of motion with overlapping test functions. The linear effects and those that the model holds
already are fitted in every record and taken out of all columns first, so that sparsity is asked of the missing
effects alone. Each record enters through the triangular factor of its columns: the least-squares problems are the same.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from pysindy import FROLS, STLSQ

from pymc_backbone import Record

from .columns import common_amplitude, memoryless_columns
from .signals import Array, Signal, signals_of

MAXIMUM_TERMS = 6
THRESHOLDS = tuple(np.geomspace(0.02, 0.9, 16))
"""Thresholds of STLSQ on columns and target of unit length."""
RIDGE = 1e-4
"""Ridge penalty of STLSQ on columns of unit length."""
BLOCKS = 5
"""Folds when there are fewer than three records: blocks of time of every record."""
STANDARD_ERRORS = 1.0

Path = list[frozenset[int]]
"""Supports offered to cross-validation."""


def name_effects_frols(records: Sequence[Record], mass: float, base: Sequence[str]) -> list[str] | None:
    """Name the missing effects with PySINDy's FROLS; see `stepwise.name_effects` for the interface."""
    return _name_effects(records, base, _frols_path)


def name_effects_stlsq(records: Sequence[Record], mass: float, base: Sequence[str]) -> list[str] | None:
    """Name the missing effects with PySINDy's STLSQ; see `stepwise.name_effects` for the interface."""
    return _name_effects(records, base, _stlsq_path)


def _frols_path(columns: Array, target: Array) -> Path:
    """Return the empty support and those of FROLS with 1, 2, ... terms."""
    most = min(MAXIMUM_TERMS, columns.shape[1] - 1)
    optimiser = FROLS(max_iter=most, alpha=1e-12, normalize_columns=True, unbias=False)
    optimiser.fit(columns, target)
    # entry i of the history has the first i terms
    supports = [frozenset(np.flatnonzero(np.ravel(row)).tolist()) for row in optimiser.history_[1 : most + 1]]
    return [frozenset(), *supports]


def _stlsq_path(columns: Array, target: Array) -> Path:
    """Return the supports of STLSQ with falling thresholds."""
    scaled = target / max(float(np.linalg.norm(target)), 1e-300)
    path: Path = [frozenset()]
    for threshold in THRESHOLDS[::-1]:
        optimiser = STLSQ(threshold=threshold, alpha=RIDGE, normalize_columns=True, unbias=False)
        optimiser.fit(columns, scaled)
        path.append(frozenset(np.flatnonzero(np.ravel(optimiser.coef_)).tolist()))
    return path


def _name_effects(
    records: Sequence[Record], base: Sequence[str], path_of: Callable[[Array, Array], Path]
) -> list[str] | None:
    effects, folds = _folds(tuple(records), tuple(base))
    if not folds:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        errors = []
        for i, (columns, target) in enumerate(folds):
            rest = [fold for j, fold in enumerate(folds) if j != i]
            training = np.vstack([fold[0] for fold in rest]), np.concatenate([fold[1] for fold in rest])
            errors.append([_held_out(training, (columns, target), support) for support in path_of(*training)])
        everything = np.vstack([fold[0] for fold in folds]), np.concatenate([fold[1] for fold in folds])
        path = path_of(*everything)
    length = min(len(path), *(len(row) for row in errors))
    table = np.array([row[:length] for row in errors])
    excess = table - table[:, [int(np.argmin(table.mean(axis=0)))]]
    allowed = STANDARD_ERRORS * excess.std(axis=0, ddof=1) / np.sqrt(len(folds))
    chosen = int(np.flatnonzero(excess.mean(axis=0) <= allowed)[0])
    return sorted({effects[i] for i in path[chosen]})


def _held_out(training: tuple[Array, Array], fold: tuple[Array, Array], support: frozenset[int]) -> float:
    """Return the squared error on a fold, as a share of the fold's own variance, of a fit to the others."""
    columns = sorted(support)
    coefficients = np.linalg.lstsq(training[0][:, columns], training[1], rcond=None)[0] if columns else np.zeros(0)
    residual = fold[1] - fold[0][:, columns] @ coefficients
    return float(residual @ residual / max(float(fold[1] @ fold[1]), 1e-300))


@lru_cache(maxsize=2)
def _folds(records: tuple[Record, ...], base: tuple[str, ...]) -> tuple[list[str], list[tuple[Array, Array]]]:
    """Return the effect of each column, and columns and target of each fold."""
    signals = signals_of(records)
    if not signals:
        return [], []
    amplitude = common_amplitude(signals)
    folds = []
    effects: list[str] = []
    for signal in signals:
        always, effects, matrix = _matrix(signal, amplitude, base)
        blocks = [matrix] if len(signals) > 2 else np.array_split(matrix, BLOCKS)
        folds += [_reduced(block, always) for block in blocks]
    return effects, folds


def _matrix(signal: Signal, amplitude: float, base: tuple[str, ...]) -> tuple[int, list[str], Array]:
    """Return how many columns are always there, the effects of the others, and all columns with the target last."""
    columns = memoryless_columns(signal, amplitude)
    always = ["linear_stiffness", "viscous_damping", *(name for name in base if name in columns)]
    first = [np.ones_like(signal.displacement)] + [column for name in dict.fromkeys(always) for column in columns[name]]
    offered = [(name, column) for name, values in columns.items() if name not in always for column in values]
    stack = [signal.low_pass(column) for column in [*first, *(column for _, column in offered)]]
    stack.append(-signal.acceleration() / (amplitude * signal.angular_frequency**2))
    return len(first), [name for name, _ in offered], np.column_stack(stack)


def _reduced(matrix: Array, always: int) -> tuple[Array, Array]:
    """Take the first columns out of the others; return what is left as a triangle of columns and its target."""
    triangle = np.linalg.qr(matrix, mode="r")[always:, always:]
    return triangle[:, :-1], triangle[:, -1]
