"""Student-t errors: SciPy's density, gradients by differences, and a line with samples that are far off."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import zoo
from zoo.core.arviz_lines import dataset
from zoo.core.data import Data
from zoo.core.errors.groups import GroupNoise
from zoo.core.errors.student import GroupStudent
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.inference.sampling import has_gradient
from zoo.core.model import bayesian_model
from zoo.core.parameters import Normal, Parameter

TIMES = np.linspace(0.0, 1.0, 12)
VALUES = {"noise_p": 0.7, "nu_p": 3.5, "nu_q": 12.0}


def law(gap: bool = False) -> GroupStudent:
    values = np.random.default_rng(2).standard_normal((3, 12))
    if gap:
        values[1, 4] = np.nan
    data = Data(TIMES, values, labels=["a", "b", "c"], units=["V", "A", "V"], groups=["p", "q", "p"])
    return GroupStudent(known={"q": 0.2}).bind(data)


@pytest.mark.parametrize("gap", [False, True])
def test_terms_are_those_of_scipy(gap: bool) -> None:
    errors = law(gap)
    residual = 2.0 * np.random.default_rng(4).standard_normal((3, 12))
    expected = np.array(
        [
            stats.t.logpdf(row, nu, scale=s)
            for row, nu, s in zip(residual, (3.5, 12.0, 3.5), (0.7, 0.2, 0.7), strict=True)
        ]
    )
    expected[~errors.on.measured] = 0.0
    residual[~errors.on.measured] = np.nan
    np.testing.assert_allclose(errors.terms(residual, VALUES), expected, rtol=1e-12)
    assert errors.variance(VALUES)[:, 0] == pytest.approx([stats.t.var(3.5, scale=0.7), 0.048, 1.1433333])
    z = errors.whiten(residual, VALUES)
    below = stats.t.cdf(residual[0], 3.5, scale=0.7)
    np.testing.assert_allclose(stats.norm.cdf(z[0]), below, rtol=1e-10)


@pytest.mark.parametrize("gap", [False, True])
def test_gradients_are_those_of_differences(gap: bool) -> None:
    errors = law(gap)
    rng = np.random.default_rng(6)
    residual, weight = rng.standard_normal((3, 12)), rng.standard_normal((3, 12))
    by_residual, by_value = errors.gradient(residual, VALUES, weight)

    def total(r: np.ndarray, values: dict[str, float]) -> float:
        return float(np.sum(weight * errors.terms(r, values)))

    assert set(by_value) == set(VALUES)
    for name in VALUES:
        up, down = (total(residual, VALUES | {name: VALUES[name] + h}) for h in (1e-5, -1e-5))
        assert by_value[name] == pytest.approx((up - down) / 2e-5, rel=1e-7)
    for at in [(0, 0), (1, 4), (1, 5), (2, 11)]:
        step = np.zeros((3, 12))
        step[at] = 1e-5
        slope = (total(residual + step, VALUES) - total(residual - step, VALUES)) / 2e-5
        assert by_residual[at] == pytest.approx(slope, rel=1e-6, abs=1e-9)


def test_samples_that_are_far_off_change_little() -> None:
    """A line of slope 2 with two samples of twelve wrong by 5: normal errors follow them, these do not."""
    y = 2.0 * TIMES + 0.05 * np.random.default_rng(1).standard_normal(12)
    y[-2:] += 5.0
    found = {}
    for name, errors in (("normal", GroupNoise()), ("robust", GroupStudent())):
        parameters = (Parameter("slope", Normal(0.0, 10.0)),)
        forward = FunctionModel(lambda c, t: c["slope"] * t, parameters, Outputs(("u",), TIMES))
        model = bayesian_model(name, forward, Data(TIMES, y, labels=["u"]), errors)
        idata = zoo.sample(model, draws=300, chains=2, cores=0, seed=1, method="exact", progress=False)
        found[name] = float(dataset(idata)["slope"].median())
    assert found["robust"] == pytest.approx(2.0, abs=0.15)
    assert found["normal"] > 3.0


def test_a_model_of_blood_has_them_by_name() -> None:
    study = zoo.load_study("demo")
    model = zoo.model_G(study, errors="student-t")
    assert model.zoo.error_parameters == ("noise_pressure_mmHg", "nu_pressure_mmHg")
    assert has_gradient(model)
    with pytest.raises(zoo.StudyError, match="errors = 'cauchy': must be student-t"):
        zoo.model_G(study, errors="cauchy")
