"""Comparison of models: terms from re-solved draws, WAIC three ways, PSIS-LOO, the table."""

from __future__ import annotations

import math
from dataclasses import replace

import arviz as az
import numpy as np
import pymc as pm
import pytest
from scipy import stats

from gaussian import a_record
from test_op import small_study
from zoo.blood.baseline import Baseline, study_model
from zoo.blood.blood_flow import radius_dependent_stiffness
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import Study
from zoo.core.arviz_lines import ARVIZ_1, InferenceData, dataset, made, of_draws
from zoo.core.errors.independent import Independent
from zoo.core.inference.convergence import check_convergence
from zoo.core.model import ModelError
from zoo.core.parameters import Normal, Parameter, Uniform
from zoo.core.posterior.comparison import (
    ComparisonError,
    compare,
    describe_difference,
    forward_points,
    log_likelihoods,
    posterior_means,
    prior_sensitivity,
    sse_at_median,
    thin,
    waic_one_observation,
)
from zoo.models import get_model

pytestmark = pytest.mark.filterwarnings(
    "ignore:For one or more samples the posterior variance",
    "ignore:Estimated shape parameter of Pareto",
    "ignore:The inplace keyword in DataFrame.sort_values",
)

CENTRE = {"f3": 5e4, "psi1": 0.3, "psi2": 0.9, "c": 1.2, "sigma2": 0.0025, "w": 5e4, "b": 100.0}


def posterior(model: pm.Model, n_draws: int = 40, seed: int = 0, spread: float = 0.003) -> InferenceData:
    """Draws scattered around the truth, two chains, every draw twice as Metropolis leaves them."""
    rng = np.random.default_rng(seed)
    draws = {
        name: CENTRE[name] * np.exp(spread * rng.standard_normal((2, n_draws // 2))).repeat(2, axis=1)
        for name in model.zoo.parameters
    }
    return of_draws({"posterior": draws})


@pytest.fixture(scope="module")
def models(study: Study) -> dict[str, pm.Model]:
    return {name: get_model(name)(study) for name in ("A", "B")}


@pytest.fixture(scope="module")
def idatas(models: dict[str, pm.Model]) -> dict[str, InferenceData]:
    return {name: posterior(model) for name, model in models.items()}


def with_terms(idata, model, decomposition="sequential", n_draws=None) -> InferenceData:
    """What ArviZ's own functions take."""
    terms = log_likelihoods(idata, model, n_draws=n_draws)[decomposition]
    return made({"posterior": thin(idata, n_draws), "log_likelihood": terms.to_dataset(name="y")})


# WAIC with one observation


def test_one_observation_by_hand() -> None:
    joint = np.array([-3.0, -2.0, -2.5])
    lppd = math.log(np.mean(np.exp(joint)))
    result = waic_one_observation(joint)
    assert result.p_waic == pytest.approx(0.25)
    assert result.waic == pytest.approx(-2 * (lppd - 0.25))


def test_one_observation_does_not_overflow() -> None:
    result = waic_one_observation(np.array([[2240.0, 2243.0], [2241.0, 2242.0]]))
    assert result.waic == pytest.approx(waic_one_observation([0.0, 3.0, 1.0, 2.0]).waic - 2 * 2240)


def test_one_observation_of_a_normal_mean() -> None:
    # y ~ N(mu, 1), mu | y ~ N(y, 1): E exp(l) and var(l) = var(chi2_1)/4 are known
    mu = np.random.default_rng(1).standard_normal(200_000)
    result = waic_one_observation(stats.norm.logpdf(0.0, mu, 1.0))
    assert result.p_waic == pytest.approx(0.5, rel=0.03)
    assert result.waic == pytest.approx(-2 * (stats.norm.logpdf(0.0, 0.0, math.sqrt(2.0)) - 0.5), rel=0.01)


# draws


def test_thin_takes_the_same_number_from_each_chain(idatas) -> None:
    assert dict(thin(idatas["A"], 11).sizes) == {"chain": 2, "draw": 6}
    assert list(thin(idatas["A"], 6)["draw"].to_numpy()) == [0, 20, 39]
    assert thin(idatas["A"], 10_000).sizes["draw"] == 40
    assert thin(idatas["A"], None).sizes["draw"] == 40


def test_points_of_vectors_and_scalars(study: Study) -> None:
    parameters = (
        Parameter("f1", Uniform(1e3, 1e7)),
        Parameter("f3", Uniform(3e4, 6e4)),
        Parameter("psi1", Uniform(0.05, 2.5), dims="vessel"),
    )
    fixed = {"f2": -50.0, "psi2": 0.9, "c": 1.2}
    baseline = Baseline("E-like", "linear", radius_dependent_stiffness, parameters, fixed=fixed)
    model = study_model("E-like", baseline, Independent())(study)
    draws = {
        "f1": np.array([[1e5, 2e5]]),
        "f3": np.array([[4e4, 5e4]]),
        "psi1": np.array([[[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]]),
        "sigma2": np.ones((1, 2)),
    }
    points = forward_points(model, dataset(of_draws({"posterior": draws})))
    np.testing.assert_array_equal(points, [[1e5, 4e4, 0.1, 0.2, 0.3], [2e5, 5e4, 0.4, 0.5, 0.6]])


def test_means_are_the_solver_s_at_each_draw(study: Study, models, idatas) -> None:
    draws = thin(idatas["B"], 8)
    reported: list[tuple[int, int]] = []
    means = posterior_means(models["B"], draws, progress=lambda done, of: reported.append((done, of)))
    assert means.shape == (8, 2, 32)
    flat = {name: draws[name].to_numpy().ravel() for name in draws}
    for i in (0, 7):
        point = [flat["f3"][i], 2.0, flat["psi1"][i], flat["psi2"][i], flat["c"][i]]
        np.testing.assert_allclose(means[i], Solver.for_study(study).solve(*point).pressure_mmHg, rtol=1e-12)
    assert reported[-1][0] == reported[-1][1]


def test_repeated_draws_are_solved_once(models, idatas) -> None:
    reported = []
    means = posterior_means(models["A"], thin(idatas["A"], None), progress=lambda *n: reported.append(n))
    assert len(means) == 80
    assert reported[-1] == (40, 40)


# log-likelihood


@pytest.mark.parametrize("name", ["A", "B"])
def test_terms_agree_with_pymc(name: str, models, idatas) -> None:
    idata = idatas[name].copy()
    pm.compute_log_likelihood(idata, model=models[name], progressbar=False)
    ours = log_likelihoods(idata, models[name], n_draws=None)["sequential"]
    assert ours.dims == idata.log_likelihood["y"].dims
    # on PyMC 6 theirs is numba's: rounding in a kernel whose noise is 3e-6 of it
    np.testing.assert_allclose(ours, idata.log_likelihood["y"], rtol=1e-7, atol=1e-7)


def test_decompositions(study: Study, models, idatas) -> None:
    b = log_likelihoods(idatas["B"], models["B"], n_draws=10)
    np.testing.assert_allclose(b["sequential"].sum(("series", "time")), b["joint"], rtol=1e-12)
    assert float(abs(b["leave-one-out"] - b["sequential"]).max()) > 0.1
    # given everything, the last point of a series is no worse known than given the past: the same
    np.testing.assert_allclose(b["leave-one-out"][..., -1], b["sequential"][..., -1], rtol=1e-5, atol=1e-5)
    a = log_likelihoods(idatas["A"], models["A"], n_draws=10)
    np.testing.assert_array_equal(a["leave-one-out"], a["sequential"])
    assert list(a["series"].to_numpy()) == [series.label for series in study.series]


def test_sse_at_the_median(study: Study, models, idatas) -> None:
    def expected(draws) -> float:
        median = {name: float(np.median(draws[name])) for name in draws}
        solution = Solver.for_study(study).solve(
            median["f3"], 2.0, median["psi1"], median["psi2"], median["c"]
        )
        return float(np.sum((study.values - solution.pressure_mmHg) ** 2))

    posterior = idatas["A"].posterior
    found = sse_at_median(idatas["A"], models["A"])["pressure_mmHg"]
    assert found.value == pytest.approx(expected(posterior), rel=1e-6)
    one, two = (expected(posterior.sel(chain=chain)) for chain in posterior["chain"])
    assert found.mcse == pytest.approx(abs(one - two) / 2, rel=1e-6)
    alone = sse_at_median(idatas["A"].sel(chain=[0]), models["A"])["pressure_mmHg"]
    assert np.isnan(alone.mcse)


# the table


def test_table(study: Study, models, idatas) -> None:
    table = compare(idatas, models, n_draws=None)
    assert list(table["rank"]) == [0, 1]
    assert table.index[0] == "A"  # the noise is white
    best, other = table.iloc[0], table.iloc[1]
    assert best["standing"] == "best"
    assert other["difference"] == pytest.approx(other["waic"] - best["waic"])
    assert other["standing"] == describe_difference(other["difference"], other["difference_se"])
    assert table["weight"].sum() == pytest.approx(1.0)
    terms = log_likelihoods(idatas["A"], models["A"], n_draws=None)
    values = terms["sequential"].to_numpy().reshape(80, -1)
    lppd = np.log(np.mean(np.exp(values), axis=0))
    assert best["waic"] == pytest.approx(-2 * np.sum(lppd - values.var(axis=0)))
    assert best["waic_one_observation"] == pytest.approx(waic_one_observation(values.sum(axis=1)).waic)
    one, two = (waic_one_observation(chain).waic for chain in terms["joint"].to_numpy())
    assert best["one_observation_mcse"] == pytest.approx(abs(one - two) / 2)
    assert best["waic_leave_one_out"] == pytest.approx(best["waic"])
    assert best["loo"] == pytest.approx(best["waic"], abs=1.0)
    assert (best["sse_pressure_mmHg"], best["sse_pressure_mmHg_mcse"]) == pytest.approx(
        sse_at_median(idatas["A"], models["A"])["pressure_mmHg"]
    )
    k = az.loo(with_terms(idatas["A"], models["A"], n_draws=None), pointwise=True).pareto_k
    assert best["pareto_k_max"] == pytest.approx(float(k.max()))
    assert best["pareto_k_bad"] == int((k > 1 - 1 / math.log10(80)).sum())
    assert best["draws"] == 80
    assert not best["converged"]
    assert "2 chains: at least 4 are needed" in best["convergence"]
    assert table.attrs["scale"] == "deviance"


def test_table_ranked_by_loo_with_given_verdicts(models, idatas) -> None:
    rng = np.random.default_rng(0)
    good = check_convergence({"x": rng.standard_normal((4, 1000))})
    assert good.passes
    table = compare(idatas, models, ic="loo", n_draws=40, verdicts={"A": good})
    assert table.loc["A", "converged"]
    assert not table.loc["B", "converged"]
    difference = table["loo"].iloc[1] - table["loo"].iloc[0]
    assert table["difference"].iloc[1] == pytest.approx(difference)
    for name in models:  # only terms given all other points have weights that leave a point out
        scored = with_terms(idatas[name], models[name], "leave-one-out", n_draws=40)
        wanted = float(az.loo(scored).elpd if ARVIZ_1 else az.loo(scored).elpd_loo)
        assert table.loc[name, "loo"] == pytest.approx(-2 * wanted, rel=1e-9)


def test_one_model_and_two_fits_of_it(models, idatas) -> None:
    table = compare({"A": idatas["A"]}, models, n_draws=20)
    assert table.loc["A", "weight"] == pytest.approx(1.0)
    assert table.loc["A", "standing"] == "best"
    again = posterior(models["A"], seed=1)
    table = compare({"first": idatas["A"], "second": again}, {"first": models["A"], "second": models["A"]})
    assert table["difference"].iloc[1] < 5.0
    assert table["standing"].iloc[1] == describe_difference(*table[["difference", "difference_se"]].iloc[1])


def test_weights_do_not_underflow(models, idatas) -> None:
    # at a sigma2 of 1e-6 some terms of A are below -745, where exp is zero
    sharp = posterior(models["A"])
    sharp.posterior["sigma2"] = sharp.posterior["sigma2"] * 0 + 1e-6
    table = compare({"A": sharp, "B": idatas["B"]}, models, n_draws=20)
    assert float(log_likelihoods(sharp, models["A"], n_draws=20)["sequential"].min()) < -745
    assert table.loc["B", "weight"] == pytest.approx(1.0, abs=1e-3)


def test_weights_and_differences_are_arviz_s(models, idatas) -> None:
    """ArviZ 1 has no WAIC of its own."""
    ic, terms, elpd = ("loo", "leave-one-out", "elpd") if ARVIZ_1 else ("waic", "sequential", "elpd_waic")
    settings = {"round_to": "none"} if ARVIZ_1 else {"ic": ic, "scale": "log"}
    scored = {name: with_terms(idatas[name], models[name], terms, n_draws=40) for name in models}
    theirs = az.compare(scored, **settings)
    ours = compare(idatas, models, ic=ic, n_draws=40)
    assert list(ours.index) == list(theirs.index)
    np.testing.assert_allclose(ours[ic], -2 * theirs[elpd], rtol=1e-6)
    np.testing.assert_allclose(ours["difference"], 2 * abs(theirs["elpd_diff"]), rtol=1e-6)
    np.testing.assert_allclose(ours["difference_se"], 2 * theirs["dse"], rtol=1e-6)
    np.testing.assert_allclose(ours["weight"], theirs["weight"], atol=0.02)


def test_arviz_names_stand_beside_ours(models, idatas) -> None:
    for ic in ("waic", "loo"):
        table = compare(idatas, models, ic=ic)
        elpd, per_elpd, scale = ("elpd", -2, "log") if ARVIZ_1 else (f"elpd_{ic}", 1, "deviance")
        assert {"rank", f"p_{ic}", "weight", "warning", "scale"} <= set(table)
        for theirs, ours in {elpd: ic, "elpd_diff": "difference"}.items():
            np.testing.assert_array_equal(per_elpd * table[theirs], table[ours])
        for theirs, ours in {"se": f"{ic}_se", "dse": "difference_se"}.items():
            np.testing.assert_allclose(abs(per_elpd) * table[theirs], table[ours], rtol=1e-12)
        assert set(table["scale"]) == {scale}
        az.plot_compare(table)


def test_posteriors_of_something_else_are_refused_by_name(study: Study, models, idatas) -> None:
    source, conventions = models["A"].zoo.study, models["A"].zoo.settings["conventions"]
    fits = replace(
        a_record(), model="A", study=source.name, study_checksum=source.checksum, conventions=conventions,
        priors=models["A"].zoo.priors,
    )  # fmt: skip

    def table(**changed):
        idata = idatas["A"].copy()
        replace(fits, **changed).attach(idata)
        return compare({"A": idata}, {"A": models["A"]}, n_draws=10)

    assert list(table().index) == ["A"]
    for changed, words in (
        ({"study": "mouse"}, f"posterior 'A': study is mouse, here it is {source.name}"),
        ({"study_checksum": "0ff"}, "checksum of the study is 0ff"),
        ({"model": "B"}, "model is B, here it is A"),
        ({"conventions": {"name": "custom"}}, "conventions is custom"),
        ({"priors": {"f3": "Uniform(1, 2)"}}, r"prior of f3 is Uniform\(1, 2\), here it is "),
    ):
        with pytest.raises(ComparisonError, match=words):
            table(**changed)


def test_a_difference_in_words() -> None:
    assert describe_difference(3.0, 4.0) == "within its SE of the best"
    assert describe_difference(10.0, 4.0) == "2.5 SE behind the best"
    assert describe_difference(0.0, 0.0) == "within its SE of the best"
    assert describe_difference(1.0, 0.0) == "behind the best"


def test_what_cannot_be_compared_is_refused(study: Study, models, idatas) -> None:
    with pytest.raises(ComparisonError, match="no posteriors"):
        compare({}, models)
    with pytest.raises(ComparisonError, match=r"ic = 'bic': must be one of waic, loo"):
        compare(idatas, models, ic="bic")
    with pytest.raises(ComparisonError, match=r"posterior 'C': no model of that name among A, B"):
        compare({"C": idatas["A"]}, models)
    with pytest.raises(ComparisonError, match=r"no 'w' in the posterior, which has f3, psi1, psi2, c,"):
        compare({"B": idatas["A"]}, models)
    with pytest.raises(ModelError, match="has no record"):
        compare({"A": idatas["A"]}, {"A": pm.Model()})
    other = get_model("A")(small_study(n_times=16))
    with pytest.raises(ComparisonError, match="with other values: compare models of the same observations"):
        compare({"A": idatas["A"], "other": idatas["A"]}, {"A": models["A"], "other": other})


def test_draws_that_do_not_solve_are_refused(study: Study, idatas) -> None:
    hasty = get_model("A")(study, options=SolverOptions(max_beats=1, tolerance_mmHg=1e-12))
    with pytest.raises(ComparisonError, match="10 of 10 posterior draws do not solve"):
        log_likelihoods(idatas["A"], hasty, n_draws=10)
    assert math.isnan(sse_at_median(idatas["A"], hasty)["pressure_mmHg"].value)


def test_a_prior_that_disagrees_with_the_data_moves_its_parameter() -> None:
    """y = mean + e of known noise: by how far the prior's mean is off, and not at all for a flat prior."""
    rng, n = np.random.default_rng(2), 50
    found = {}
    for prior in (0.0, 0.6, "flat"):
        law = Uniform(-50.0, 50.0) if prior == "flat" else Normal(float(prior), 0.1)
        precision = 0.0 if prior == "flat" else 1.0 / 0.1**2
        with pm.Model() as model:
            law.variable("mean", {})
        C = 1.0 / (n + precision)
        at = 0.0 if prior == "flat" else C * precision * float(prior)  # the mean of the data is 0
        draws = at + np.sqrt(C) * rng.standard_normal((4, 500))
        posterior = dataset(of_draws({"posterior": {"mean": draws}}))
        found[prior] = prior_sensitivity(posterior, model)["mean"]
    assert found["flat"] < 0.01
    assert 0.05 < found[0.0] < 0.5 * found[0.6]
