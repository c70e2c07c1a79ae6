"""Posteriors beside their priors: laws whose mass at a bound and whose information are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pymc as pm
import pytest
from scipy import stats

from gaussian import autoregressive
from zoo.core.arviz_lines import InferenceData
from zoo.core.data import Data
from zoo.core.effects import EffectParameter, effect, with_effects
from zoo.core.errors.independent import Independent
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.inference.convergence import check_convergence, diagnostics, verdict
from zoo.core.inference.logposterior import SamplingError
from zoo.core.inference.prior_check import PriorCheck, check_priors, edges, modes_at_bounds, priors_of
from zoo.core.inference.record import ResultsError, RunRecord
from zoo.core.inference.sampling import sample
from zoo.core.model import bayesian_model
from zoo.core.parameters import InverseGamma, LogUniform, Normal, Parameter, Prior, Uniform
from zoo.core.posterior.comparison import compare
from zoo.core.posterior.storage import load, save_posterior, slim_posterior

TIMES = np.linspace(0.1, 1.0, 20)


def a(prior: Prior, unit: str = "1") -> tuple[Parameter, ...]:
    return (Parameter("a", prior, unit),)


def spread(law: object, n: int = 4000) -> dict[str, np.ndarray]:
    """The law's own quantiles in random order, as four chains: no Monte Carlo error."""
    x = law.ppf((np.arange(n) + 0.5) / n)  # type: ignore[attr-defined]
    return {"a": np.random.default_rng(1).permutation(x).reshape(4, -1)}


@pytest.mark.parametrize(
    ("prior", "low", "high"),
    [
        (Uniform(2.0, 4.0), 2.02, 3.98),
        (LogUniform(1.0, 100.0), 100.0**0.01, 100.0**0.99),
        (Normal(0.0, 1.0, -8.0, 8.0), -7.6, 7.6),  # not the 1 % quantile, which is far from the bound
        (Normal(0.0, 1.0, low=-1.0), float(stats.truncnorm.ppf(0.01, -1, np.inf)), None),
        (InverseGamma(3.0, 1.0), None, None),
        (Normal(0.0, 1.0, low=0.0), None, None),  # a positive number
    ],
)
def test_the_outer_part_of_a_prior(prior: Prior, low: float | None, high: float | None) -> None:
    found = edges(prior)
    assert found == (low and pytest.approx(low, rel=1e-6), high and pytest.approx(high, rel=1e-6))


@pytest.mark.parametrize("scale", [0.02, 0.1, 0.3])
def test_the_mass_at_a_bound_is_that_of_the_law(scale: float) -> None:
    """An exponential that ends at the bound has 1 - exp(-0.02/scale) of its mass in the outer 0.02."""
    down = {"a": 4.0 - spread(stats.expon(scale=scale))["a"]}
    found = check_priors(a(Uniform(2.0, 4.0), "s"), down).bounds
    mass = 1.0 - np.exp(-0.02 / scale)
    assert [(f.side, f.bound) for f in found] == ([("upper", 4.0)] if mass > 0.05 else [])
    if found:
        assert found[0].share == pytest.approx(mass, abs=1e-3)
        assert found[0].text == (
            f"a leans on the upper bound of its prior, 4 s, with {mass:.0%} of its draws in the outer 1 % of "
            "the prior: --prior a=..., or priors={'a': ...}, lifts it"
        )


def test_neither_the_tail_of_a_normal_nor_a_variance_near_zero_is_a_bound() -> None:
    normal, variance = Normal(0.0, 1.0, -8.0, 8.0), InverseGamma(0.001, 0.001)
    assert check_priors(a(normal), spread(stats.norm(-3.5, 0.1))) == PriorCheck()
    assert check_priors(a(variance), spread(stats.norm(1e-3, 1e-4))) == PriorCheck()


@pytest.mark.parametrize(("sd", "uninformed"), [(1.0, True), (0.9, True), (0.7, False), (0.3, False)])
def test_a_parameter_is_informed_by_what_its_posterior_adds(sd: float, uninformed: bool) -> None:
    """A normal of sd s has log(1/s) - (1 - s^2)/2 nats over the standard normal."""
    nats = -np.log(sd) - 0.5 * (1.0 - sd**2)
    assert (nats < 0.05) == uninformed
    assert check_priors(a(Normal(0.0, 1.0)), spread(stats.norm(0, sd))).uninformed == (("a",) * uninformed)


def test_few_effective_draws_say_neither() -> None:
    """By chance 250 effective draws of the prior differ from it by 0.02 nats, 30 by 0.15."""
    rng = np.random.default_rng(4)
    for phi, said in ((0.0, True), (0.6, True), (0.97, False)):
        draws = {"a": autoregressive(rng, 4, 250, phi)}
        assert bool(check_priors(a(Normal(0.0, 1.0)), draws).uninformed) is said
    apart = (
        rng.normal(size=(4, 1000)) * 0.3 + np.array([-1.2, -0.4, 0.4, 1.2])[:, None]
    )  # together like N(0, 1)
    assert not check_priors(a(Normal(0.0, 1.0)), {"a": apart}).uninformed


def test_what_the_data_do_not_inform_does_not_make_a_run_unconverged() -> None:
    rng = np.random.default_rng(5)
    idle = stats.norm.cdf(autoregressive(rng, 4, 1000, 0.85))
    draws = {"idle": idle, "b": rng.normal(size=(4, 1000))}
    alone = check_convergence(draws)
    assert not alone.passes
    found = check_convergence(draws, priors=check_priors((Parameter("idle", Uniform(0.0, 1.0)),), draws))
    assert found.passes
    assert found.uninformed == ("idle",)
    assert found["idle"] == alone["idle"]  # told as it is
    assert f"posterior like prior: idle (R-hat at most {alone['idle'].rhat:.3f}, ESS at least" in found.text
    b_fails = {"idle": idle, "b": autoregressive(rng, 4, 1000, 0.9)}
    assert not check_convergence(b_fails, priors=PriorCheck(uninformed=("idle",))).passes


def test_a_mode_at_a_bound() -> None:
    parameters = (
        Parameter("a", LogUniform(1.0, 100.0), "s"),
        Parameter("v", Uniform(0, 1), dims="k", size=3),
    )
    values = {"a": 100.0, "v": np.array([0.5, 0.0005, 0.002])}
    found = modes_at_bounds(parameters, values)
    assert [(f.parameter, f.side, f.share) for f in found] == [("a", "upper", None), ("v[1]", "lower", None)]
    assert (
        found[0].text == "the mode of a stands at the upper bound of its prior, 100 s: "
        "--prior a=..., or priors={'a': ...}, lifts it"
    )
    assert found[1].text.endswith(": --prior v=..., or priors={'v': ...}, lifts it")


def line(configuration, times):  # type: ignore[no-untyped-def]
    """A line whose second parameter does nothing."""
    return configuration["slope"] * times


LINE = FunctionModel(
    line,
    (Parameter("slope", Uniform(0.0, 1.0), "V/s"), Parameter("idle", Uniform(-2.0, 2.0))),
    Outputs(("y",), TIMES),
    "line",
)


class Inexact(FunctionModel):
    """A forward model that knows where it is less exact than promised."""

    def warning_at(self, configuration):  # type: ignore[no-untyped-def]
        return "the slope is steep here" if configuration["slope"] > 0.5 else ""


@pytest.mark.parametrize(("slope", "words"), [(0.8, "the slope is steep here"), (0.2, "")])
def test_what_a_forward_model_says_of_its_exactness_at_the_mode_is_heard(slope: float, words: str) -> None:
    y = slope * TIMES + 0.1 * np.random.default_rng(2).standard_normal(len(TIMES))
    data = Data(TIMES, y[None], labels=["y"], units=["V"], name="steep")
    forward = Inexact(line, (Parameter("slope", Uniform(0.0, 1.0), "V/s"),), LINE.outputs, "line")
    model = bayesian_model("line", forward, data, Independent(InverseGamma(3.0, 0.05)))
    found = verdict(sample(model, draws=100, tune=100, cores=0, seed=1, progress=False))
    assert not found.bounds
    assert found.text.startswith(f"{words}. " if words else ("converged", "not converged"))


@pytest.fixture(scope="module")
def model() -> pm.Model:
    """The truth, 1.5, is beyond the prior of the slope."""
    y = 1.5 * TIMES + 0.1 * np.random.default_rng(2).standard_normal(len(TIMES))
    data = Data(TIMES, y[None], labels=["y"], units=["V"], name="beyond")
    return bayesian_model("line", LINE, data, Independent(InverseGamma(3.0, 0.05)))


@pytest.fixture(scope="module")
def idata(model: pm.Model) -> InferenceData:
    return sample(model, draws=500, until_ess=400, max_draws=4000, cores=0, seed=1, progress=False)


def test_a_run_stores_what_it_heard_and_its_verdict_says_it_first(idata: InferenceData) -> None:
    stored = PriorCheck.from_dict(RunRecord.of(idata).prior_check or {})
    assert [(f.parameter, f.side, f.bound, f.unit) for f in stored.bounds] == [("slope", "upper", 1.0, "V/s")]
    assert stored.uninformed == ("idle",)
    found = verdict(idata)
    assert found.passes
    assert found.text.startswith("slope leans on the upper bound of its prior, 1 V/s")
    assert "lifts it. Converged: " in found.text
    assert found.text.index("Converged") < found.text.index("Not informed by the data")


def test_files_slim_files_and_comparisons_keep_it(
    idata: InferenceData, model: pm.Model, tmp_path: Path
) -> None:
    for kept in (
        load(save_posterior(idata, tmp_path / "whole.nc")),
        load(save_posterior(slim_posterior(idata, 200), tmp_path / "slim.nc")),
    ):
        assert diagnostics(kept).verdict.text == verdict(idata).text
    table = compare({"line": idata}, {"line": model}, n_draws=100)
    assert table.loc["line", "at_bounds"].startswith("slope leans on the upper bound")
    assert table.loc["line", "uninformed"] == "idle"


def test_a_posterior_of_before_is_heard_by_its_model(idata: InferenceData, model: pm.Model) -> None:
    from dataclasses import replace

    older = idata.copy()
    replace(RunRecord.of(idata), prior_check=None).attach(older)
    assert not verdict(older).bounds
    assert verdict(older, model=model).text == verdict(idata).text
    found = diagnostics(slim_posterior(older, 400), model=model).verdict
    assert found.bounds
    assert found.uninformed == ("idle",)


@effect("bend", parameters=[EffectParameter("size", "V", 0.5, 0.0, 2.0, (0.1,))])
def bend(configuration, values, location):  # type: ignore[no-untyped-def]
    """A quadratic part."""
    return {**configuration, "bend": values[0]}


def test_an_effect_that_is_not_there_leans_on_no_bound() -> None:
    data = Data(TIMES, TIMES[None], labels=["y"], units=["V"], name="straight")
    built = bayesian_model(
        "line", with_effects(LINE, [bend.at()]), data, Independent(InverseGamma(3.0, 0.05))
    )
    parameters, effects = priors_of(built)
    assert effects == {"bend.size"}
    draws = {"bend.size": spread(stats.expon(scale=0.02))["a"]}
    assert not check_priors(parameters, draws, effects=effects).bounds
    assert check_priors(parameters, draws).bounds
    assert not modes_at_bounds(parameters, {"bend.size": 0.0}, effects=effects)


def test_what_cannot_be_sampled_or_read_is_named() -> None:
    with pytest.raises(SamplingError, match=r"model = 'A'.*give a PyMC model"):
        sample("A")
    with pytest.raises(ResultsError, match="prior_check is not readable"):
        PriorCheck.from_dict({"bounds": [{"parameter": "a"}], "uninformed": []})


def test_reports_and_comparisons_on_screen_warn(idata: InferenceData, model: pm.Model) -> None:
    from types import SimpleNamespace

    from zoo.cli.compare import _comparison_summary
    from zoo.report.sentences import summary

    lines = summary(None, {"line": diagnostics(idata)}, {"line": RunRecord.of(idata)})
    assert lines[0].startswith("Warning: model line: slope leans on the upper bound of its prior, 1 V/s")
    assert lines[1:3] == [
        "The posterior of model line converged.",
        "Not informed by the data, with a posterior like the prior, in model line: idle.",
    ]
    table = compare({"line": idata}, {"line": model}, n_draws=100)
    said = [str(line) for line in _comparison_summary(table, "waic", SimpleNamespace(name="beyond"))]  # type: ignore[arg-type]
    assert any(line.startswith("warning: model line: slope leans on the upper bound") for line in said)
    assert "model line: not informed by the data, posterior like prior: idle" in said
