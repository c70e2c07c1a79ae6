"""Surrogates of a forward model against the model itself, and corrected draws against known posteriors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytensor
import pytensor.tensor as pt
import pytest
from scipy import stats

from zoo.core.data import Data
from zoo.core.errors.gaussian_process import GaussianProcess
from zoo.core.errors.independent import Independent
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.inference import building, methods
from zoo.core.inference import surrogate_sampling as correcting
from zoo.core.inference.building import Builder, Weighed
from zoo.core.inference.correction import along_chains, pareto_weights
from zoo.core.inference.logposterior import LogPosterior, SamplingError
from zoo.core.inference.methods import choose, sample
from zoo.core.inference.record import RunRecord
from zoo.core.inference.sampling import check_settings
from zoo.core.inference.surrogate_sampling import sample_surrogate
from zoo.core.model import bayesian_model
from zoo.core.parameters import InverseGamma, LogUniform, Parameter, ParameterError, Uniform
from zoo.core.surrogate.kriging import Kriging
from zoo.core.surrogate.library import Library
from zoo.core.surrogate.powers import Coordinates
from zoo.core.surrogate.surrogate_model import log_likelihood, surrogate_model
from zoo.core.surrogate.waveform import LEFT_OUT, Surrogate, SurrogateError

T = np.linspace(0.0, 2.0, 40)
RATE = Parameter("rate", Uniform(0.2, 5.0), start=1.0, log=True)
LEVEL = Parameter("level", Uniform(-3.0, 3.0), start=0.5)
SD = 0.05
DATA = Data(T, 0.6 + np.exp(-1.3 * T) + SD * np.random.default_rng(7).standard_normal(T.size), units=["mmHg"])


def decay(configuration, times):
    return configuration["level"] + np.exp(-configuration["rate"] * times)


FORWARD = FunctionModel(decay, (RATE, LEVEL), Outputs(("y0",), T), name="decay")
KNOWN = Independent(Uniform(0.9 * SD**2, 1.1 * SD**2), start=SD**2)
PROCESS = GaussianProcess(LogUniform(0.1, 10.0), LogUniform(0.1, 10.0), noise_variance=SD**2)


@pytest.fixture(autouse=True)
def few_draws_between_those_that_are_solved(monkeypatch):
    """Posteriors of these models are all but normal."""
    monkeypatch.setattr(correcting, "THIN", 2)


def library_of(n: int, seed: int = 0, width: float = 0.15) -> Library:
    rng = np.random.default_rng(seed)
    theta = np.stack([1.3 * np.exp(width * rng.standard_normal(n)), 0.6 + width * rng.standard_normal(n)], 1)
    library = Library(FORWARD)
    library.add(theta, library.solve(theta))
    return library


def builder_of(model, library=None):
    library = Library(model.zoo.forward) if library is None else library
    return Builder(LogPosterior(model), library, seed=1, cores=1)


def exact_moments() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means, sds and 97.5 % points of rate and level by integration over a grid, also over sigma2."""
    rate, level = np.linspace(0.8, 2.0, 400), np.linspace(0.4, 0.8, 401)
    squares = ((DATA.values[0] - level[None, :, None] - np.exp(-rate[:, None] * T)[:, None]) ** 2).sum(-1)
    s2 = np.linspace(0.9, 1.1, 41) * SD**2
    ll = -0.5 * squares[..., None] / s2 - 0.5 * T.size * np.log(s2)
    p = np.exp(ll - ll.max()).sum(-1)
    p /= p.sum()
    margins = (p.sum(1), p.sum(0))
    means = np.array([(x * m).sum() for x, m in zip((rate, level), margins, strict=True)])
    pairs = list(zip((rate, level), margins, means, strict=True))
    sds = np.array([np.sqrt(((x - mean) ** 2 * m).sum()) for x, m, mean in pairs])
    tops = np.array([np.interp(0.975, np.cumsum(m), x) for x, m, _ in pairs])
    return means, sds, tops


@pytest.mark.parametrize("errors", [KNOWN, PROCESS])
def test_series_within_the_design_err_by_no_more_than_was_left_out(errors):
    bound = errors.bind(DATA)
    values = {p.name: p.first for p in bound.parameters}
    surrogate = Surrogate.fit(library_of(60), bound, values)
    new = library_of(200, seed=5, width=0.1)
    z = bound.whiten(surrogate.series(new.theta) - new.series, values)
    assert np.sqrt((z**2).sum((1, 2)).mean()) < 1.5 * np.sqrt(surrogate.map.left_out + LEFT_OUT)


def likelihoods(model, made, points):
    """What is in a surrogate's log-density beside the prior, at each point."""
    logp, prior = LogPosterior(made), model.compile_logp(vars=model.free_RVs)
    vectors = [logp.from_values(point) for point in points]
    return [logp(q) - float(prior(logp.point(q))) for q in vectors]


def test_the_table_of_a_process_is_its_log_density_and_its_gradient_that_of_differences():
    bound = PROCESS.bind(DATA)
    surrogate = Surrogate.fit(library_of(60), bound, {"w": 1.0, "b": 1.0})
    model = bayesian_model("toy", FORWARD, DATA, PROCESS)
    theta = library_of(20, seed=3, width=0.1).theta
    made = surrogate_model(model, model.zoo, surrogate, theta)
    rng = np.random.default_rng(4)
    errors = {"w": np.exp(rng.uniform(-1, 1, 20)), "b": np.exp(rng.uniform(-1, 1, 20))}
    rows = np.column_stack([theta, *errors.values()])
    points = [dict(zip(("rate", "level", "w", "b"), row, strict=True)) for row in rows]
    ours = likelihoods(model, made, points)
    np.testing.assert_allclose(ours, log_likelihood(model.zoo, surrogate.series(theta), errors), atol=2e-3)
    logp = made.compile_logp()
    slope = made.compile_dlogp()
    point = made.initial_point()
    gradient = slope(point)
    for i, (name, value) in enumerate(point.items()):
        h = 1e-5
        up, down = ({**point, name: value + s * h} for s in (1, -1))
        assert gradient[i] == pytest.approx((logp(up) - logp(down)) / (2 * h), rel=1e-5, abs=1e-5)


def test_the_graph_of_the_series_is_the_array_of_it():
    surrogate = Surrogate.fit(library_of(60), KNOWN.bind(DATA), {"sigma2": SD**2})
    model = bayesian_model("toy", FORWARD, DATA, KNOWN)
    made = surrogate_model(model, model.zoo, surrogate, library_of(5).theta)
    variables = {name: made[name] for name in ("rate", "level")}
    function = pytensor.function(list(variables.values()), surrogate.symbolic_series(variables))
    np.testing.assert_allclose(function(1.2, 0.5), surrogate.series([[1.2, 0.5]])[0], rtol=1e-9)


@pytest.mark.parametrize("errors", [KNOWN, PROCESS])
def test_its_draws_are_of_the_likelihood_to_a_power(errors):
    model = bayesian_model("toy", FORWARD, DATA, errors)
    bound = errors.bind(DATA)
    values = {p.name: p.first for p in bound.parameters}
    surrogate, theta = Surrogate.fit(library_of(60), bound, values), library_of(20, width=0.1).theta
    fence = surrogate.symbolic_fence({"rate": pt.constant(2.5), "level": pt.constant(1.4)}).eval()
    assert fence > 1.0  # beyond the design
    points = [{"rate": rate, "level": level} | values for rate, level in (theta[0], (2.5, 1.4))]
    plain, wider = (
        np.array(likelihoods(model, surrogate_model(model, model.zoo, surrogate, theta, power), points))
        for power in (1.0, 0.7)
    )
    beyond = np.array([0.0, fence])
    np.testing.assert_allclose(wider + beyond, 0.7 * (plain + beyond), rtol=1e-6)


def test_as_many_draws_as_asked_are_effective_of_a_normal_posterior():
    power = builder_of(bayesian_model("toy", FORWARD, DATA, KNOWN)).power
    x = np.random.default_rng(1).standard_normal((400_000, 3)) / np.sqrt(power)
    weights = np.exp(-0.5 * (1.0 - power) * (x**2).sum(1))
    assert weights.sum() ** 2 / (len(x) * (weights**2).sum()) == pytest.approx(building.DEFENSIVE, abs=0.003)


def test_a_corrected_posterior_is_the_exact_one_and_draws_are_added_until_they_are_enough(monkeypatch):
    monkeypatch.setattr(correcting, "TAIL", 5.0)  # which of so few draws would be chance
    model = bayesian_model("toy", FORWARD, DATA, KNOWN)
    idata = sample_surrogate(model, draws=60, seed=3, progress=False, cores=1, until_ess=1000.0)
    means, sds, tops = exact_moments()
    for name, mean, sd, top in zip(("rate", "level"), means, sds, tops, strict=True):
        draws = idata.posterior[name].to_numpy()
        assert draws.mean() == pytest.approx(mean, abs=0.12 * sd)
        assert draws.std() == pytest.approx(sd, rel=0.1)
        assert np.quantile(draws, 0.975) == pytest.approx(top, abs=0.25 * sd)
    record = RunRecord.of(idata)
    made, kept = record.settings["surrogate"], idata.posterior.sizes["draw"]
    assert kept == record.settings["draws"] > 250
    assert made["correction solves"] == 4 * kept
    assert idata.sample_stats["log_weight"].shape == (4, kept)
    assert record.solves == made["building solves"] + 4 * kept
    assert made["k_hat"] < 0.7


def test_a_bent_posterior_of_many_parameters_is_left_to_chains():
    """That of many parameters which are seen only together, with small independent errors."""
    parts = Parameter("parts", Uniform(0.5, 1.5), start=0.9, dims="part", size=12)
    forward = FunctionModel(decay, (parts,), Outputs(("y0",), T), name="shell")
    method, reason = choose(bayesian_model("shell", forward, DATA, KNOWN))
    assert method == "exact"
    assert "bent" in reason
    with pytest.raises(SamplingError, match=r"method = 'surrogate': .*bent posterior.*; use method exact"):
        choose(bayesian_model("shell", forward, DATA, KNOWN), "surrogate")
    assert choose(bayesian_model("shell", forward, DATA, PROCESS))[0] == "surrogate"


def spoiled(monkeypatch, spoil, rounds=1):
    """A model of which the first surrogate is spoiled."""
    fit, calls = Kriging.fit.__func__, []

    def wrong(cls, *arguments):
        fitted = fit(cls, *arguments)
        calls.append(1)
        return fitted if len(calls) > 1 else spoil(fitted)

    monkeypatch.setattr(Kriging, "fit", classmethod(wrong))
    monkeypatch.setattr(correcting, "ROUNDS", rounds)
    return bayesian_model("toy", FORWARD, DATA, KNOWN)


def beside(fitted):
    aside = np.zeros(fitted.beta.shape)
    aside[0, 0] = aside[1, 1] = 0.6
    return replace(fitted, beta=fitted.beta + aside)


def narrow(fitted):
    return replace(fitted, beta=3.0 * fitted.beta, of_points=3.0 * fitted.of_points)


def is_right(idata):
    means, sds, _ = exact_moments()
    return all(
        abs(idata.posterior[name].to_numpy().mean() - mean) < 0.3 * sd
        and abs(idata.posterior[name].to_numpy().std() / sd - 1.0) < 0.2
        for name, mean, sd in zip(("rate", "level"), means, sds, strict=True)
    )


@pytest.mark.nightly  # one that is far too narrow is corrected below
def test_a_surrogate_beside_the_posterior_is_corrected(monkeypatch):
    model = spoiled(monkeypatch, beside)
    idata = sample_surrogate(model, draws=600, seed=3, progress=False, cores=1)
    made = RunRecord.of(idata).settings["surrogate"]
    assert made["effective share"] < 0.8
    assert made["k_hat"] <= 0.7
    assert is_right(idata)


def test_a_surrogate_that_is_far_too_narrow_is_refused(monkeypatch):
    model = spoiled(monkeypatch, narrow)
    with pytest.raises(SurrogateError, match=r"misses at least [1-9]\d* %.*; sample with method exact"):
        sample_surrogate(model, draws=600, seed=3, progress=False, cores=1)


def test_draws_are_trusted_if_their_weights_are_and_little_is_missed():
    draws = np.random.default_rng(0).standard_normal((4, 1000))
    good = stats.norm.logpdf(draws, 0, 0.7) - stats.norm.logpdf(draws)
    bad = stats.norm.logpdf(draws, 0, 3.0) - stats.norm.logpdf(draws)
    assert Weighed({}, good, 0.0).trusted
    assert not Weighed({}, good, 2 * building.MISSED).trusted
    assert not Weighed({}, bad, 0.0).trusted


def test_what_a_surrogate_leaves_out_is_estimated_and_refused(monkeypatch):
    """Of a posterior that is all but normal, the part beyond an edge at which a surrogate ends.

    As far as moved draws reach: those of its density to a power, cut there and moved away from their mean.
    """
    edge = 0.7
    means, sds, _ = exact_moments()
    at = means[1] + edge * sds[1]
    fence = Surrogate.symbolic_fence

    def walled(self, variables):
        return fence(self, variables) + 1e6 * pt.maximum(variables["level"] - at, 0.0) ** 2

    monkeypatch.setattr(Surrogate, "symbolic_fence", walled)
    monkeypatch.setattr(building, "BEYOND", 1200)
    builder = builder_of(bayesian_model("toy", FORWARD, DATA, KNOWN))
    looked = builder.look(builder.surrogate()[1], 300, 300, 2)
    assert looked.draws["level"].max() < at + 0.3 * sds[1]
    c, power = building.SEEN ** (-2 / 3), builder.power
    mean = stats.truncnorm.mean(-np.inf, edge * np.sqrt(power)) / np.sqrt(power)
    reach = mean + np.sqrt(c + np.sqrt(c * c - c)) * (edge - mean)
    expected = (stats.norm.cdf(reach) - stats.norm.cdf(edge)) / stats.norm.cdf(reach)
    assert expected > 0.1
    assert looked.missed == pytest.approx(expected, abs=0.05)
    assert not looked.trusted


def test_of_a_good_surrogate_nothing_is_missed():
    builder = builder_of(bayesian_model("toy", FORWARD, DATA, KNOWN))
    before = builder.library.solves
    looked = builder.look(builder.surrogate()[1], 150, 400, 2)
    assert looked.missed < 0.01
    assert looked.trusted
    assert builder.library.solves - before == 600 + building.BEYOND


def test_where_the_surrogate_is_refused_chains_of_the_model_are_made(monkeypatch, capsys, tmp_path):
    """As the method is chosen; one that was asked for says why not."""
    monkeypatch.setattr(methods, "FEW", 1)
    monkeypatch.setattr(building, "MISSED", -1.0)
    monkeypatch.setattr(correcting, "ROUNDS", 1)
    model = bayesian_model("toy", FORWARD, DATA, KNOWN)
    settings = {"draws": 20, "tune": 20, "chains": 2, "cores": 1, "seed": 1}
    idata = sample(model, method="auto", checkpoint=tmp_path / "run", **settings)
    assert (tmp_path / "run" / "run.json").exists()
    assert RunRecord.of(idata).settings["step"] == "demetropolisz"
    assert "misses" in capsys.readouterr().err

    def cannot(*arguments, **settings):
        raise SurrogateError("sample with method exact")

    monkeypatch.setattr(methods, "sample_surrogate", cannot)
    with pytest.raises(SurrogateError, match="sample with method exact"):
        sample(model, method="surrogate", progress=False, **settings)


def test_what_was_solved_joins_a_surrogate_that_is_far_too_narrow(monkeypatch):
    model = spoiled(monkeypatch, narrow, rounds=2)
    idata = sample_surrogate(model, draws=200, seed=3, progress=False, cores=1)
    made = RunRecord.of(idata).settings["surrogate"]
    first, second = made["rounds"]
    assert first["k_hat"] > 0.5
    more = second["points"] - first["points"]
    assert 320 < more <= 320 + building.BEYOND  # what lies far from the posterior is left out
    assert made["effective share"] > 0.95 * building.DEFENSIVE
    assert is_right(idata)


def test_weights_tell_an_approximation_that_is_too_narrow():
    rng = np.random.default_rng(0)
    draws = rng.standard_normal((4, 1000))
    wide = stats.norm.logpdf(draws, 0, 0.7) - stats.norm.logpdf(draws)
    narrow = stats.norm.logpdf(draws, 0, 3.0) - stats.norm.logpdf(draws)
    assert pareto_weights(wide).trusted
    assert not pareto_weights(narrow).trusted
    shifted = pareto_weights(stats.norm.logpdf(draws, 0.4, 0.9) - stats.norm.logpdf(draws))
    assert float((shifted.smoothed * draws).sum()) == pytest.approx(0.4, abs=0.06)
    none = np.full((4, 100), -np.inf)
    assert not pareto_weights(none).trusted


def test_weights_that_are_all_but_equal_have_no_tail():
    """Of a few draws beyond a surrogate's reach among many where it is exact; many such do not pass."""
    rounding = 1e-13 * np.random.default_rng(1).standard_normal((4, 300))
    few, many = rounding.copy(), rounding.copy()
    few[0, :6] = np.linspace(0.1, 0.4, 6)
    many[0, :12] = np.linspace(1.0, 4.0, 12)
    far = np.random.default_rng(0).standard_normal((4, 1000))
    beyond = 0.95 * stats.norm.pdf(far) + 0.05 * stats.norm.pdf(far, 4.25, 0.5)
    assert pareto_weights(rounding).trusted
    assert pareto_weights(few).trusted
    assert not pareto_weights(many).trusted
    rising = pareto_weights(np.log(beyond) - stats.norm.logpdf(far))
    assert rising.effective > 0.99
    assert not rising.trusted


def test_resampling_keeps_chains_and_the_order_of_their_draws():
    weights = np.random.default_rng(1).uniform(size=(3, 500))
    index = along_chains(weights, np.random.default_rng(2))
    assert np.all(np.diff(index, axis=1) >= 0)
    for w, i in zip(weights, index, strict=True):
        times = np.bincount(i, minlength=500)
        assert np.all(np.abs(times - 500 * w / w.sum()) < 1.0)  # rounded up or down


def test_one_library_serves_another_error_model():
    first = bayesian_model("toy", FORWARD, DATA, KNOWN)
    library = Library(FORWARD)
    builder_of(first, library)
    there = len(library)
    surrogate, _ = builder_of(bayesian_model("other", FORWARD, DATA, PROCESS), library).surrogate()
    assert len(surrogate.map.points) > there > 100
    other = FunctionModel(decay, (RATE, LEVEL), Outputs(("y0",), T), name="another")
    with pytest.raises(SamplingError, match="library: is of"):
        sample_surrogate(first, library=Library(other), progress=False)


def test_a_power_of_what_may_be_negative_is_refused():
    with pytest.raises(ParameterError, match=r"parameter x: power = -0.5, but its prior .* reaches below 0"):
        Parameter("x", Uniform(-1.0, 2.0), power=-0.5)
    assert Parameter("x", Uniform(-1.0, 2.0), power=1.0).response == 1.0


class Derived(FunctionModel):
    """With derivatives, here by central differences."""

    def solve_derivatives(self, configure, theta, scales, outputs=None):
        steps = 1e-5 * np.diag(scales)
        columns = [self.solve(configure(theta + h)) - self.solve(configure(theta - h)) for h in steps]
        return self.solve(configure(theta)), np.array(columns) / (2e-5 * np.asarray(scales)[:, None, None])


def test_a_start_is_followed_as_far_with_derivatives_as_without():
    """Charged by what a solve with its derivatives costs, and not stopped after three steps for that."""
    times = np.linspace(0.0, 1.0, 20)
    parameters = (
        Parameter("k", Uniform(0.05, 20.0), log=True, start=15.0),
        Parameter("s", Uniform(-3.0, 3.0), start=-2.0),
    )

    def decay(configuration, times):
        return np.exp(-configuration["k"] * times) + configuration["s"] * times

    noise = 0.02 * np.random.default_rng(1).standard_normal(20)
    data = Data(times, decay({"k": 0.4, "s": 0.5}, times) + noise, units=["mmHg"])
    heights = []
    for kind in (FunctionModel, Derived):
        model = bayesian_model(
            "decay", kind(decay, parameters, Outputs(("y0",), times), name="decay"), data, KNOWN
        )
        logp = LogPosterior(model)
        heights.append(logp(builder_of(model).begin()[0]))
    assert heights[1] == pytest.approx(heights[0], abs=0.1)


class SameSolves(FunctionModel):
    """Whose parameters' priors and powers are no part of what is solved."""

    @property
    def key(self):
        return "decay"


def test_solves_of_a_model_in_other_powers_serve():
    """The map is in the coordinates of the model that is sampled."""

    def decay(configuration, times):
        return np.exp(-configuration["k"] * times)

    times = np.linspace(0.0, 2.0, 20)
    data = Data(times, decay({"k": 0.4}, times), units=["mmHg"])
    k, library = np.linspace(0.35, 0.45, 9), None
    for power in (-0.5, None):
        parameter = Parameter("k", Uniform(0.05, 5.0), start=0.5, power=power)
        forward = SameSolves(decay, (parameter,), Outputs(("y0",), times), "decay")
        library = Library(forward) if library is None else library
        model = bayesian_model("decay", forward, data, KNOWN)
        surrogate, made = builder_of(model, library).surrogate()
        np.testing.assert_allclose(surrogate.series(k[:, None])[:, 0], np.exp(-k[:, None] * times), atol=1e-3)
        series = pytensor.function([made["k"]], surrogate.symbolic_series({"k": made["k"]}))
        np.testing.assert_allclose(series(0.4)[0], np.exp(-0.4 * times), atol=1e-3)


def test_coordinates_are_powers_or_logarithms_without_hyperparameters():
    mean = Parameter("mean", Uniform(0.0, 9.0), hyper=True)
    speed = Parameter("speed", LogUniform(1.0, 16.0), log=True, dims="part", size=2, power=-0.5)
    plain = Parameter("plain", Uniform(0.5, 2.0), log=True, power=1.0)
    each = Parameter("each", LogUniform(1.0, 10.0), log=True)
    coordinates = Coordinates((mean, speed, plain, each, LEVEL))
    theta = np.array([5.0, 4.0, 16.0, 1.5, np.e, -2.0])
    assert coordinates.n == 5
    np.testing.assert_allclose(coordinates.of(theta[None]), [[0.5, 0.25, 1.5, 1.0, -2.0]])
    values = {"speed": theta[1:3], "plain": theta[3], "each": theta[4], "level": theta[5]}
    np.testing.assert_allclose(coordinates.symbolic(values).eval(), [0.5, 0.25, 1.5, 1.0, -2.0])


def test_methods_are_chosen_with_a_reason_and_refused_in_one_line(tmp_path):
    model = bayesian_model("toy", FORWARD, DATA, KNOWN)
    method, reason = choose(model)
    assert (method, "3 dimensions" in reason) == ("exact", True)
    with pytest.raises(SamplingError, match=r"method = 'nuts'.*no gradient"):
        choose(model, "nuts")
    with pytest.raises(SamplingError, match="one of auto, exact, nuts, surrogate"):
        choose(model, "hmc")
    with pytest.raises(SamplingError, match="thin = 3: method surrogate has no use for it"):
        sample(model, method="surrogate", thin=3)
    unbounded = GaussianProcess(InverseGamma(2.0, 1.0), LogUniform(0.1, 10.0), noise_variance=SD**2)
    other = bayesian_model("unbounded", FORWARD, DATA, unbounded)
    assert choose(other)[0] == "exact"
    with pytest.raises(SamplingError, match="no positive bounds; use method exact"):
        choose(other, "surrogate")
    (tmp_path / "run.json").write_text("{}")
    assert choose(model, checkpoint=tmp_path)[1] == "a checkpoint of such a run is there"


def test_too_few_points_are_refused():
    with pytest.raises(SurrogateError, match="3 solved points for 2 coordinates"):
        Surrogate.fit(library_of(3), KNOWN.bind(DATA), {"sigma2": SD**2})


def test_points_on_a_line_are_refused():
    """As where the chains on an earlier surrogate did not move."""
    flat = np.zeros(2), np.outer([1.0, 2.0], [1.0, 2.0]) - 1e-12 * np.eye(2)
    with pytest.raises(SurrogateError, match="spread in all of its 2 coordinates"):
        Surrogate.fit(library_of(12), KNOWN.bind(DATA), {"sigma2": SD**2}, near=flat)


def test_settings_that_are_left_out_are_those_of_sample():
    check_settings(until_ess=400)  # of four chains
    with pytest.raises(SamplingError, match="at least 2 chains"):
        check_settings(until_ess=400, chains=1)
