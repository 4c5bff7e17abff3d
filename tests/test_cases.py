"""The source paper's systems: published columns as bounds, populations, and the choices that make them agree."""

from __future__ import annotations

import numpy as np
import pytest

from pymc_backbone import InputError
from pymc_backbone.paper.cases import CASES, get_case, uniform_bounds
from pymc_backbone.simulation.backbones import simulate_population


def test_uniform_bounds_have_the_mean_and_the_standard_deviation():
    low, high = uniform_bounds(6500.0, 288.68)
    assert (low + high) / 2.0 == pytest.approx(6500.0)
    assert (high - low) / np.sqrt(12.0) == pytest.approx(288.68)
    assert (low, high) == pytest.approx((6000.0, 7000.0), abs=0.02)  # what the paper must have drawn from


@pytest.mark.parametrize("name", CASES)
def test_populations_have_the_true_columns(name, rng):
    case = CASES[name]
    drawn = case.draw(20000, rng)
    for j, parameter in enumerate(case.data.parameter_names):
        if parameter in case.fixed:
            assert np.ptp(drawn[:, j]) == 0.0 and drawn[0, j] == case.fixed[parameter]
        else:
            mean, sd = case.true[parameter]
            assert drawn[:, j].mean() == pytest.approx(mean, abs=0.03 * sd + 1e-12 * abs(mean))
            assert drawn[:, j].std() == pytest.approx(sd, rel=0.02, abs=1e-12 * abs(mean))


@pytest.mark.parametrize("name", CASES)
def test_every_parameter_of_the_model_is_inferred_or_fixed(name):
    case = CASES[name]
    assert set(case.prior) | set(case.model_fixed) == set(case.model.parameter_names)
    assert not set(case.prior) & set(case.model_fixed)
    assert set(case.published) == (set() if case.name == "single" else set(case.prior))
    minimum = {parameter.name: parameter.minimum for parameter in case.model.parameters}
    assert all(low >= minimum[key] for key, (low, _) in case.prior_bounds.items())


@pytest.mark.parametrize("name", CASES)
def test_every_specimen_reaches_every_level(name, rng):
    case = CASES[name]
    found = simulate_population(case.data, case.draw(50, rng), case.levels, observables=("frequency", "damping"))
    assert np.isfinite(found["value"].values).all()


def test_stiffness_of_the_hysteretic_cases_is_that_of_table_5(rng):
    case = CASES["5"]
    drawn = dict(zip(case.data.parameter_names, case.draw(40000, rng).T, strict=True))
    hysteretic = (1.0 - drawn["bouc_wen_alpha"]) * drawn["bouc_wen_stiffness"] * drawn["bouc_wen_amplitude"]
    total = drawn["linear_stiffness"] + hysteretic
    assert total.mean() == pytest.approx(156.5, abs=0.5)
    assert total.std() == pytest.approx(18.17, rel=0.05)


def test_unknown_case_is_refused():
    with pytest.raises(InputError, match="'6'"):
        get_case("6")
