"""Matrices scaled to a diagonal of ones: solved where their entries differ by orders of magnitude."""

from __future__ import annotations

import numpy as np
import pytest

from pymc_backbone._common.unit_diagonal import unit_diagonal

SCALES = np.array([1e-9, 1.0, 1e8])
CORRELATION = np.array([[1.0, 0.5, 0.0], [0.5, 1.0, 0.25], [0.0, 0.25, 1.0]])
DETERMINANT = 1.0 - 0.25 - 0.0625  # of that
MATRIX = CORRELATION * np.outer(SCALES, SCALES)


def test_rows_and_columns_are_multiplied_and_come_back():
    scaled = unit_diagonal(MATRIX)
    assert scaled.matrix == pytest.approx(CORRELATION, rel=1e-15)
    assert scaled.scale == pytest.approx(1.0 / SCALES, rel=1e-15)
    inverse = scaled.scaled(np.linalg.inv(scaled.matrix))
    assert (inverse @ MATRIX) / np.outer(1.0 / SCALES, SCALES) == pytest.approx(np.eye(3), abs=1e-14)


def test_solutions_are_as_exact_as_those_of_the_correlation():
    solution = np.array([2e9, -3.0, 5e-8])
    right = SCALES * (CORRELATION @ (SCALES * solution))
    assert unit_diagonal(MATRIX).solve(right) == pytest.approx(solution, rel=1e-13)
    assert unit_diagonal(MATRIX).least_squares(right, 1e-12) == pytest.approx(solution, rel=1e-13)
    # negative control: as it is, what is small is below what such a solution keeps
    assert abs(np.linalg.lstsq(MATRIX, right, rcond=1e-12)[0][0] / solution[0] - 1.0) > 0.5


def test_the_logarithm_of_the_determinant_is_that_of_the_original():
    expected = np.log(DETERMINANT) + 2.0 * np.log(SCALES).sum()
    assert unit_diagonal(MATRIX).log_determinant() == pytest.approx(expected, rel=1e-14)


def test_what_is_in_no_equation_is_solved_with_a_ridge_or_stays_nothing():
    matrix = np.array([[4.0, 0.0], [0.0, 0.0]])
    with pytest.raises(np.linalg.LinAlgError):
        unit_diagonal(matrix).solve(np.array([8.0, 0.0]))
    assert unit_diagonal(matrix).least_squares(np.array([8.0, 0.0]), 1e-12) == pytest.approx([2.0, 0.0])
    assert unit_diagonal(matrix, 0.25).solve(np.array([8.0, 0.0])) == pytest.approx([1.6, 0.0])
