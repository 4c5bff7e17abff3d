"""Forward selection of effects with pruning, on inner products of columns; shapes are chosen record by record."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .columns import NOT_NEGATIVE, Columns
from .signals import Array

MAXIMUM_EFFECTS = 3
"""Largest set of missing effects that is named."""
WIDTH = 4
"""Sets kept from each size to be extended to the next."""
N_SHAPES = {"freeplay": 1, "jenkins": 1, "iwan": 2, "bouc_wen": 3}
"""Shape parameters, which pay as coefficients do."""


@dataclass(frozen=True, eq=False)
class Table:
    """Inner products of the columns of one record, the linear ones taken out of all others.

    Attributes
    ----------
    gram : (c + 1, c + 1) array
        Of all columns, scaled to unit length, and of the target, which comes last.
    places : mapping of str to list of int
        Columns of each effect, one per shape parameter.
    rows : float
        Number of independent rows.
    linear : int
        Number of columns taken out.
    """

    gram: Array
    places: Mapping[str, list[int]]
    rows: float
    linear: int

    def residual(self, columns: list[int], bound: list[bool]) -> float:
        """Return the sum of squares left by a fit to ``columns``; infinite if a bounded coefficient is negative."""
        target = self.gram.shape[0] - 1
        moment = self.gram[columns, target]
        try:
            coefficients = np.linalg.solve(self.gram[np.ix_(columns, columns)] + 1e-11 * np.eye(len(columns)), moment)
        except np.linalg.LinAlgError:
            return np.inf
        if any(limited and value < 0.0 for limited, value in zip(bound, coefficients, strict=True)):
            return np.inf
        return float(self.gram[target, target] - moment @ coefficients)

    def smallest_residual(self, effects: Sequence[str]) -> float:
        """Return the smallest sum of squares over the shapes of the effects, chosen in turn and then once more."""
        bound = [name in NOT_NEGATIVE for name in effects]
        columns = [self.places[name][len(self.places[name]) // 2] for name in effects]
        shaped = [i for i, name in enumerate(effects) if len(self.places[name]) > 1]
        best = self.residual(columns, bound) if columns else float(self.gram[-1, -1])
        for _ in range(3 if len(shaped) > 1 else 1):
            for i in shaped:
                for place in self.places[effects[i]]:
                    trial = [*columns[:i], place, *columns[i + 1 :]]
                    value = self.residual(trial, bound)
                    if value < best:
                        best, columns = value, trial
        return best


def make_table(linear: Sequence[Array], columns: Columns, target: Array, rows: float) -> Table:
    """Make the inner products of one record from its columns, all of one length."""
    places: dict[str, list[int]] = {}
    stack: list[Array] = []
    for name, values in columns.items():
        places[name] = list(range(len(stack), len(stack) + len(values)))
        stack += list(values)
    matrix = np.column_stack([*linear, *stack, target])
    left = np.linalg.qr(matrix, mode="r")[len(linear) :, len(linear) :]
    length = np.sqrt(np.sum(left**2, axis=0))
    # what the linear columns all but explain says nothing of its own
    nothing = length < 1e-9 * np.maximum(np.sqrt(np.sum(matrix[:, len(linear) :] ** 2, axis=0)), 1e-300)
    left = np.where(nothing, 0.0, left / np.where(nothing, 1.0, length))
    left[:, -1] *= length[-1]
    return Table(left.T @ left, places, rows, len(linear))


def search(
    tables: Sequence[Table],
    base: Sequence[str],
    criterion: Callable[[Table, float, int], float],
    enough: Callable[[Sequence[float], Sequence[float]], bool],
) -> list[str]:
    """Find the set of missing effects by forward search with pruning.

    Parameters
    ----------
    tables : sequence of Table
        One per record.
    base : sequence of str
        Effects that the model holds.
    criterion : callable
        From a table, a sum of squares and a number of parameters to what is minimised, summed over the records.
    enough : callable
        From the sums of squares of the records without and with one effect to whether it does enough to be named.

    Returns
    -------
    list of str
        The effects named, sorted.
    """
    always = [name for name in dict.fromkeys(base) if name in tables[0].places]
    offered = [name for name in tables[0].places if name not in always]
    known: dict[frozenset[str], tuple[float, list[float]]] = {}

    def score(effects: frozenset[str]) -> tuple[float, list[float]]:
        if effects not in known:
            names = [*always, *sorted(effects)]
            left = [table.smallest_residual(names) for table in tables]
            size = len(names) + sum(N_SHAPES.get(name, 0) for name in names)
            pairs = zip(tables, left, strict=True)
            known[effects] = sum(criterion(table, value, size + table.linear) for table, value in pairs), left
        return known[effects]

    def is_pruned(effects: frozenset[str]) -> bool:
        return all(enough(score(effects - {name})[1], score(effects)[1]) for name in effects)

    kept = [frozenset[str]()]
    best = kept[0]
    for _ in range(MAXIMUM_EFFECTS):
        trials = {effects | {name} for effects in kept for name in offered if name not in effects}
        kept = sorted(trials, key=lambda effects: (score(effects)[0], sorted(effects)))[:WIDTH]
        better = [effects for effects in kept if score(effects)[0] < score(best)[0] and is_pruned(effects)]
        if better:
            best = better[0]
    return sorted(best)
