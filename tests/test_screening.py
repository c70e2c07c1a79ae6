"""Search, evidence, groups: on data of the solver itself, and against brute force."""

import contextlib
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import binom

from made import QUANTITY, SEARCH, THETA, baseline_of, hypothesis_model, made, screening_of, solved
from zoo import load_study
from zoo.blood.effects import CATALOGUE
from zoo.blood.study import Series
from zoo.core.diagnosis.discrepancy import model_discrepancy, possible_noise
from zoo.core.diagnosis.estimates import posteriors_of
from zoo.core.diagnosis.evidence import Fit
from zoo.core.diagnosis.hypothesis import (
    CORRELATED,
    NONPARAMETRIC,
    NULL,
    Hypothesis,
    HypothesisModel,
    coordinates,
)
from zoo.core.diagnosis.scoring import VISIBLE, _groups, score
from zoo.core.diagnosis.screening import Screening
from zoo.core.diagnosis.search import Point, Search, SearchError
from zoo.core.effects import EVERYWHERE, EffectParameter
from zoo.core.errors.spectral import GroupErrors, Harmonics, log_density
from zoo.core.forward import Outputs
from zoo.core.parameters import InverseGamma, Normal, Parameter, Population, Uniform, log_prior

TRUE_VALUES = {
    "tangent-wall": (0.4,),
    "beat-jitter": (0.003,),
    "viscoelastic-wall": (0.0015,),
    "radius-dependent-stiffness": (1.0, 0.0164),
    "velocity-profile": (1.0,),
    "stenosis": (0.4,),
    "catheter-resonance": (0.012, 0.3),
    "side-branches": (0.3, 1.0),
    "structured-tree": (0.7,),
    "hydrostatic": (0.6,),
}


def true_values(name: str) -> tuple[float, ...]:
    first = CATALOGUE[name].of(baseline_of(load_study("demo"))).parameters[0]
    return TRUE_VALUES.get(name, (min(first.scale, 0.6 * first.high),))


HARDLY_SHOWN = {"radius-dependent-viscosity", "coarse-grid"}
"""Effects that move the demo study's waves by less than the errors of 0.01 mmHg that are assumed."""


def mode(search: Search, start: np.ndarray) -> Point:
    """Where a search from far away ends: with loose errors first, as a screening begins."""
    loose = Search(search.forward, search.data, 1e4 * search.S)
    point = search.resume(loose.descend(loose.at(start), 15, 1e-3))
    return search.refine(search.descend(point, 15, 1e-4), 6, 15, fine=True)


@pytest.mark.parametrize("name", [n for n, e in CATALOGUE.items() if e.apply is not None])
def test_effect_parameter_is_recovered_from_noise_free_data(name: str) -> None:
    """To 1 %, from the baseline's start and each of the effect's own, which know nothing of the truth."""
    locations = CATALOGUE[name].locations(baseline_of(load_study("demo")))
    location = locations[min(2, len(locations) - 1)]
    wanted = true_values(name)
    study = made([(name, wanted, location)], noise=0.0)
    forward, base = hypothesis_model(study, ((name, location),)), hypothesis_model(study)
    S = forward.errors.variances({QUANTITY: GroupErrors(0.01)})
    data = forward.errors.flat(study.values)
    alone = mode(Search(base, data, S), base.start)
    if name in HARDLY_SHOWN:
        assert math.sqrt(float(np.mean((data - alone.computed) ** 2))) < 0.005
        return
    first, *shapes = CATALOGUE[name].of(forward.baseline).parameters
    starts = [np.array([*alone.u, a, *(p.centre for p in shapes)]) for a in first.starts]
    points = []
    for u in starts:
        with contextlib.suppress(SearchError):  # nothing solves there
            points.append(mode(Search(forward, data, S), u))
    found = min(points, key=lambda point: point.cost)
    assert forward.theta(found.u)[4] == pytest.approx(wanted[0], rel=0.01)


def test_evidence_is_the_integral_over_the_parameters() -> None:
    """Against importance sampling of all five parameters with the solver itself."""
    study = made([("sensor-offset", (1.0,), EVERYWHERE)], series=(0,), n=64)
    screening = screening_of(study, ["sensor-offset"])
    screened = screening.run()
    (fit,) = screened.fits.values()
    errors = {q: replace(e, delta=0.0) for q, e in fit.errors.items()}
    S = screening.errors.variances(errors)
    # a wide importance sample of all five parameters around the mode
    rng = np.random.default_rng(1)
    L = np.linalg.cholesky(1.5 * fit.covariance)
    total = []
    for _ in range(400):
        z = rng.standard_normal(5)
        u = fit.mean + L @ z
        if np.any(u < fit.forward.low) or np.any(u > fit.forward.high):
            total.append(-math.inf)
            continue
        computed = fit.forward(u)
        assert computed is not None
        log_q = -0.5 * z @ z - 2.5 * math.log(2 * math.pi) - float(np.log(np.diag(L)).sum())
        total.append(log_density(screening.coefficients - computed, S) + fit.forward.prior(u)[0] - log_q)
    wanted = float(logsumexp(total)) - math.log(len(total))
    point = Point(fit.u, fit.computed, fit.jacobian)
    again = screening.evidence(fit.forward, point, dict.fromkeys(fit.allowances, 0.0))
    noise = {q: replace(e, delta=0.0) for q, e in again.errors.items()}
    for q in noise:  # the same noise as in the brute force, to within its own search
        assert noise[q].noise == pytest.approx(errors[q].noise, rel=0.05)
    own = again.log_z - sum(screening.errors.noise_log_prior(e) for e in again.errors.values())
    own_S = screening.errors.variances(again.errors)
    shift = log_density(again.residual, S) - log_density(again.residual, own_S)
    assert own + shift == pytest.approx(wanted, abs=0.5)


@pytest.fixture(scope="module")
def gain():  # type: ignore[no-untyped-def]
    study = made([("sensor-gain", (0.15,), EVERYWHERE)])
    names = ["sensor-gain", "sensor-offset", "inflow-shift", "radius-dependent-viscosity", "tangent-wall"]
    return score(screening_of(study, names).run())


def test_the_cause_is_found_with_its_amplitude(gain) -> None:  # type: ignore[no-untyped-def]
    assert gain.leader == "sensor-gain"
    assert gain.probability["sensor-gain"] > 0.95
    size = posteriors_of(gain.screened.screening, gain.best["sensor-gain"])[0]
    assert abs(size.mean - 0.15) < 4 * size.sd
    assert size.sd < 0.03
    assert sum(gain.probability.values()) == pytest.approx(1.0)
    assert gain.log_z[NULL] < gain.log_z[NONPARAMETRIC] < gain.log_z["sensor-gain"]


def test_what_the_study_cannot_show_is_invisible(gain) -> None:  # type: ignore[no-untyped-def]
    assert "radius-dependent-viscosity" in gain.invisible
    assert gain.probability["radius-dependent-viscosity"] == 0.0


def test_noise_alone_is_no_gap() -> None:
    study = made([], seed=3)
    found = score(screening_of(study, ["sensor-gain", "inflow-shift", "tangent-wall", "taper"]).run())
    assert found.leader == NULL
    assert found.probability[NULL] > 0.5


def test_a_bump_is_unlisted() -> None:
    """A click in all series that no effect of the list makes."""
    study = made([], seed=4)
    t = study.time_s
    click = 0.5 * np.exp(-((t - 0.05) ** 2) / 0.004**2) * np.sin(900 * (t - 0.05))
    study = replace(study, series=tuple(replace(s, value=s.value + click) for s in study.series))
    found = score(screening_of(study, ["sensor-gain", "inflow-shift", "tangent-wall", "taper"]).run())
    assert found.leader == NONPARAMETRIC


def test_signatures_that_coincide_make_one_group() -> None:
    """From the root alone a delay of the inflow is a delay of the sensor: a fast, well-damped resonance."""
    study = made([("inflow-shift", (0.001,), EVERYWHERE)], series=(0,))
    found = score(screening_of(study, ["inflow-shift", "catheter-resonance", "tangent-wall"]).run())
    members = found.members(found.leader)
    assert {"inflow-shift", "catheter-resonance"} <= set(members)
    a, b = (found.best[n].computed for n in ("inflow-shift", "catheter-resonance"))
    assert 0.5 * float(np.sum((a - b) ** 2)) / 0.05**2 < VISIBLE * 1.5


@pytest.fixture(scope="module")
def linear():  # type: ignore[no-untyped-def]
    """A screening whose base is replaced by a linear model of three smooth waves, with flat priors."""
    screening = screening_of(made([], n=64), ["sensor-gain"])
    H = screening.errors
    t = np.arange(64) / 64
    waves = np.stack([np.sin(2 * np.pi * (t[None] * k + phase)) for k, phase in ((1, 0), (2, 0.1), (3, 0.3))])
    J = np.stack([H.flat(np.repeat(w[None] if w.ndim == 1 else w, 3, axis=0)) for w in waves], axis=1)

    class Linear(HypothesisModel):
        def __init__(self, d):  # type: ignore[no-untyped-def]
            self.low, self.high, self.errors = np.full(d, -1e3), np.full(d, 1e3), H

        def prior(self, u):  # type: ignore[no-untyped-def]
            return 0.0, np.zeros(len(u)), np.zeros(len(u))

    def fitted(truth, noise):  # type: ignore[no-untyped-def]
        """Least squares of data that are truth and noise; its own error is truth - J u."""
        data = truth + noise
        u = np.linalg.lstsq(J, data, rcond=None)[0]
        errors = {QUANTITY: GroupErrors(0.05)}
        S = H.variances(errors)
        C = np.linalg.inv(J.T @ (J / S[:, None]))
        return Fit(Hypothesis(), Linear(3), u, J @ u, J, data - J @ u, errors, {QUANTITY: 0.1}, 0.0, u, C)

    return screening, J, fitted


def test_what_a_fit_leaves_has_calibrated_intervals(linear) -> None:  # type: ignore[no-untyped-def]
    """True rms of truth minus fit in 60 data sets whose noise is correlated, half with a discrepancy.

    It lies below and above them no more often than it should, and they are no wider than it is large.
    """
    screening, J, fitted = linear
    H, rng = screening.errors, np.random.default_rng(1)
    T = screening.data.duration
    below, above, widths, total = 0, 0, [], 60
    for i in range(total):
        ratio, tau = rng.uniform(0.0, 1.0), 0.03 * T * math.exp(0.5 * rng.standard_normal())
        noise = {QUANTITY: GroupErrors(0.05, ratio, tau)}
        smooth = {QUANTITY: GroupErrors(0.0, delta=0.1 * (i % 2), length=0.05 * T)}
        truth = J @ rng.standard_normal(3)
        truth += np.sqrt(H.variances(smooth)) * rng.standard_normal(H.size)
        fit = fitted(truth, np.sqrt(H.variances(noise)) * rng.standard_normal(H.size))
        draws = model_discrepancy(fit, possible_noise(fit), rng, 200).draws
        sizes = np.sqrt(np.mean(draws**2, axis=1))
        wanted = math.sqrt(float(np.mean((truth - fit.computed) ** 2)))
        low, high = np.quantile(sizes, [0.025, 0.975])
        below, above = below + bool(wanted < low), above + bool(wanted > high)
        widths.append((high - low) / wanted)
    assert binom.cdf(total - below - above, total, 0.95) > 0.005, f"{below} below, {above} above"
    for outside in (below, above):
        assert binom.sf(outside - 1, total, 0.025) > 0.005, f"{below} below, {above} above"
    assert float(np.median(widths)) < 1.1


def test_without_a_discrepancy_the_parameters_error_is_left(linear) -> None:  # type: ignore[no-untyped-def]
    """White noise of 0.05 and three parameters: rms sqrt(3/192) 0.05."""
    screening, J, fitted = linear
    rng = np.random.default_rng(2)
    means = []
    for _ in range(20):
        fit = fitted(J @ np.ones(3), 0.05 * rng.standard_normal(screening.errors.size))
        draws = model_discrepancy(fit, possible_noise(fit), rng, 100).draws
        means.append(float(np.sqrt(np.mean(draws**2))))
    expected = 0.05 * math.sqrt(3 / screening.errors.size)
    assert expected < np.mean(means) < 1.6 * expected  # a discrepancy as small as this cannot be excluded


def test_what_is_left_does_not_depend_on_a_parameter_without_a_say(linear) -> None:  # type: ignore[no-untyped-def]
    """One that hardly moves the waves leaves room for no larger a discrepancy."""
    screening, J, fitted = linear
    H, rng = screening.errors, np.random.default_rng(3)
    small = GroupErrors(0.0, delta=0.03, length=0.05 * screening.data.duration)
    smooth = np.sqrt(H.variances({QUANTITY: small}))
    idle = 1e-9 * smooth * rng.standard_normal(H.size)
    fit = fitted(J @ np.ones(3) + smooth * rng.standard_normal(H.size), 0.05 * rng.standard_normal(H.size))
    noise = possible_noise(fit)
    wider = {"u": np.append(fit.u, 0.0), "jacobian": np.column_stack((J, idle))}
    more = replace(fit, forward=type(fit.forward)(4), **wider)
    sizes = [
        np.sqrt(np.mean(model_discrepancy(f, noise, np.random.default_rng(4), 400).draws ** 2, axis=1))
        for f in (fit, more)
    ]
    np.testing.assert_allclose(*(np.quantile(x, [0.1, 0.5, 0.9]) for x in sizes), rtol=0.15)
    found = model_discrepancy(fit, noise, np.random.default_rng(4), 400)
    errors = (found.draws.mean(axis=0) - found.mean) / (found.draws.std(axis=0) / math.sqrt(400))
    assert math.sqrt(float(np.mean(errors**2))) < 1.3  # the mean is that of the draws


@pytest.mark.parametrize("name", [NONPARAMETRIC, CORRELATED])
def test_evidence_is_at_most_the_largest_likelihood(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Priors are proper, also where the data have no say on a parameter, here between the paper's bounds."""
    screening = screening_of(replace(made([]), priors={"set": "paun2020"}), ["sensor-gain"])
    base = screening.fit_base()
    base = replace(base, jacobian=1e-5 * base.jacobian)

    def excess() -> float:
        fit = screening.fit_free(base, name)
        whole = 1.0 / np.sqrt(screening.errors.variances(fit.errors))
        d = np.linalg.lstsq(fit.jacobian * whole[:, None], fit.residual * whole, rcond=None)[0]
        return fit.log_z - float(log_density(fit.residual - fit.jacobian @ d, whole**-2.0))

    assert excess() < 0.0
    monkeypatch.setattr(HypothesisModel, "log_mass", lambda *arguments: 0.0)
    assert excess() > 0.0  # what it would be without bounds


def test_search_stays_inside_the_bounds() -> None:
    study = made([])
    forward = hypothesis_model(study, (("beat-jitter", EVERYWHERE),))
    H = forward.errors
    search = Search(forward, H.flat(study.values), H.variances({QUANTITY: GroupErrors(0.05)}))
    start = [math.log(THETA[p]) for p in ("f3", "psi1", "psi2", "c")]
    point = search.descend(search.at(np.array([*start, 0.01])), 15)
    assert np.all(point.u >= forward.low)
    assert point.u[4] < 0.002


def test_a_search_without_a_solve_says_why() -> None:
    study = made([])
    forward = hypothesis_model(study, options=replace(SEARCH, max_beats=1))
    search = Search(forward, forward.errors.flat(study.values), np.ones(forward.errors.size))
    with pytest.raises(SearchError, match="periodic"):
        search.at(np.array([math.log(THETA[p]) for p in ("f3", "psi1", "psi2", "c")]))
    assert (forward.failures, forward.solves) == (1, 1)


def test_priors_integrate_to_one_in_the_coordinates_of_a_search() -> None:
    """Each density over its bounds, in the parameter or in its logarithm."""
    for p in (
        Parameter("f3", Uniform(2e4, 1e5), log=True),
        Parameter("f2", Uniform(-3, 5)),
        Parameter("a", EffectParameter("a", "1", 0.7, 0.0, 2.0, (0.1,)).prior),
        Parameter("z", Normal(0.3, 0.2, 0.1, 1.5)),
        Parameter("v", InverseGamma(3, 7.78)),
    ):
        (c,) = coordinates([p])
        low, high = max(c.coordinate(c.low), -4.0), min(c.coordinate(c.high), 12.0)
        u = np.linspace(low, high, 20001)
        density = [math.exp(p.prior.log_density(c.value(x), {}) + (x if c.log else 0.0)) for x in u]
        assert np.trapezoid(density, u) == pytest.approx(1.0, rel=1e-4)


def bare(parameters: tuple[Parameter, ...]) -> HypothesisModel:
    outputs = Outputs(("y",), np.arange(8.0))
    model = SimpleNamespace(parameters=parameters, outputs=outputs, families=(), name="x")
    return HypothesisModel(model, Hypothesis(), None)  # type: ignore[arg-type]


def test_precision_and_pull_of_independent_priors_are_those_of_differences() -> None:
    """In the search's coordinates, of which some are logarithms; a density that is not concave has none."""
    parameters = (
        Parameter("v", InverseGamma(3, 7.78), log=True),
        Parameter("z", Normal(0.3, 0.2)),
        Parameter("k", Normal(2.0, 0.5), log=True),
    )
    forward = bare(parameters)
    u, h = np.array([math.log(2.5), 0.45, math.log(2.2)]), 1e-4
    _, precision, pull = forward.prior(u)
    for i, step in enumerate(h * np.eye(3)):
        below, at, above = (forward.prior(u + move)[0] for move in (-step, 0.0 * step, step))
        assert pull[i] == pytest.approx(-(above - below) / (2 * h), rel=1e-5)
        assert precision[i] == pytest.approx(max(0.0, -(above - 2 * at + below) / h**2), rel=1e-4)
        assert precision[i] > 0.0


def test_slopes_and_curvatures_of_priors_are_those_of_differences() -> None:
    """Also of a population, whose density depends on its mean and variance."""
    parameters = (
        Parameter("m", Normal(6.0, 1.5)),
        Parameter("v", InverseGamma(3, 7.78), log=True),
        Parameter("chi", Population("m", "v", 2.0), dims="vessel", size=3, log=True),
        Parameter("psi", Uniform(0.05, 2.5), log=True),
    )
    forward = bare(parameters)
    u = np.array([6.5, math.log(2.0), math.log(8.0), math.log(6.0), math.log(7.0), math.log(0.4)])

    def value(u: np.ndarray) -> float:
        jacobian = float(np.sum(u[[1, 2, 3, 4, 5]]))
        return log_prior(parameters, forward.theta(u)) + jacobian

    total, precision, pull = forward.prior(u)
    assert total == pytest.approx(value(u), rel=1e-12)
    h, eye = 1e-4, np.eye(len(u))
    slope = [(value(u + h * e) - value(u - h * e)) / (2 * h) for e in eye]
    np.testing.assert_allclose(-pull, slope, rtol=1e-6, atol=1e-7)

    def mixed(a: np.ndarray, b: np.ndarray) -> float:
        both, one = h * (a + b), h * (a - b)
        return (value(u + both) - value(u + one) - value(u - one) + value(u - both)) / (4 * h * h)

    bend = -np.array([[mixed(a, b) for a in eye] for b in eye])
    assert np.linalg.eigvalsh(bend).min() > -1e-6  # where it is positive it is not changed
    np.testing.assert_allclose(precision, bend, rtol=1e-4, atol=1e-4)


def test_noise_of_one_quantity_alone_is_explained_by_correlated_noise() -> None:
    """A noisy pressure beside a clean flow: no discrepancy that both have, and no effect."""
    study = made([], series=(0,))
    waves = solved(load_study("demo"), [], Outputs(((1, 0.0, "flow_ml_s"),), study.time_s))
    rng = np.random.default_rng(5)
    H = hypothesis_model(study).errors
    alone = {QUANTITY: GroupErrors(0.0, delta=0.8, length=0.03 * study.period_s, rough=True)}
    [rough] = H.unflat(np.sqrt(H.variances(alone)) * rng.standard_normal(H.size))
    flow = waves[0] + 0.01 * np.ptp(waves[0]) * rng.standard_normal(len(waves[0]))
    noisy = Series(1, 0.0, QUANTITY, study.series[0].value + rough)
    study = replace(study, series=(noisy, Series(1, 0.0, "flow_ml_s", flow)))
    screening = screening_of(study, ["sensor-gain", "sensor-offset"])
    found = score(screening.run())
    assert found.leader == CORRELATED
    assert found.probability[CORRELATED] > 0.99
    errors = found.best[CORRELATED].errors
    assert errors["flow_ml_s"].delta == 0.0
    assert errors[QUANTITY].delta == pytest.approx(0.8, rel=0.4)


def test_what_can_imitate_the_leader_after_a_refit_is_in_its_group() -> None:
    """Waves that differ by what another size would change, by noise, or by something else."""
    rng = np.random.default_rng(6)
    base, leader, change, other = rng.standard_normal((4, 60))
    S = np.full(60, 0.01)

    def fit(computed: np.ndarray) -> SimpleNamespace:
        forward = SimpleNamespace(asked=0)
        return SimpleNamespace(computed=computed, jacobian=change[:, None], forward=forward)

    best = {
        "leader": fit(leader),
        "imitates": fit(leader + 0.8 * change),
        "nearly the same": fit(leader + 0.02 * other),
        "another": fit(leader + 0.5 * other),
    }
    screened = SimpleNamespace(base=fit(base))
    group = _groups(screened, list(best), best, dict.fromkeys(best, 0.0), (), S)  # type: ignore[arg-type]
    assert group == {"leader": 0, "imitates": 0, "nearly the same": 0, "another": 1}


def test_an_effect_that_was_added_is_tried_elsewhere_only() -> None:
    study = made([], series=(0,), n=32)
    stenosis = CATALOGUE["stenosis"]
    [first, second, *_] = stenosis.locations(baseline_of(study))
    gain = CATALOGUE["sensor-gain"].at(EVERYWHERE)
    screening = screening_of(study, ["stenosis", "sensor-gain"])
    assert first in {h.location for h in screening.hypotheses["stenosis"]}
    beside = Screening(
        screening.data, screening.baseline, [stenosis, CATALOGUE["sensor-gain"]], errors=Harmonics(),
        added=[stenosis.at(first), gain],
    )  # fmt: skip
    left = {h.location for h in beside.hypotheses["stenosis"]}
    assert second in left
    assert first not in left
    assert list(beside.hypotheses) == ["stenosis"]
    for hypothesis in beside.hypotheses["stenosis"][:2]:
        beside.forward(hypothesis)


class Kinked:
    """y = (u0, |u1 - 1|, 2 u1) with flat priors: at u1 = 1 derivatives of either side mislead."""

    low, high, units = np.array([-5.0, -5.0]), np.array([5.0, 5.0]), np.ones(2)
    last_failure = ""

    def __call__(self, u: np.ndarray) -> np.ndarray:
        return np.array([u[0], 30.0 * abs(u[1] - 1.0), 2.0 * u[1]])

    def prior(self, u: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        return 0.0, np.zeros(2), np.zeros(2)


def test_a_search_without_derivatives_ends_in_a_kink() -> None:
    search = Search(Kinked(), np.array([0.5, 0.0, 4.0]), np.full(3, 0.01))  # type: ignore[type-var]
    start = search.at(np.array([0.0, 1.05]))
    found = search.polish(start, np.array([0.1, 0.02]), 100)
    # beyond the kink: 900 (u - 1)^2 + 4 (u - 2)^2, over 2 S
    best = (900.0 + 8.0) / 904.0
    np.testing.assert_allclose(found.u, [0.5, best], atol=5e-3)
    assert found.cost == pytest.approx(search.cost(found.u, Kinked()(found.u)))
    nowhere = search.polish(found, np.array([0.1, 0.02]), 0)
    assert nowhere.cost == found.cost  # a point is never left for a worse one


@pytest.mark.parametrize(("slope", "cut"), [(30.0, False), (-30.0, True)])
def test_evidence_counts_no_more_than_a_solve_delivers(slope: float, cut: bool) -> None:
    """A derivative from the wrong side of a kink promises a gain; the right one keeps its promise."""
    forward, S = Kinked(), np.full(3, 0.01)
    u = np.array([0.5, 1.02])
    computed = forward(u)
    jacobian = np.array([[1.0, 0.0], [0.0, slope], [0.0, 2.0]])
    data = np.array([0.5, 0.0 if slope > 0 else 2.0, 2.04])
    residual = data - computed
    mean = u + np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    fit = SimpleNamespace(
        forward=forward, u=u, computed=computed, jacobian=jacobian, errors={}, mean=mean, log_z=-7.0
    )
    kept = residual - jacobian @ (mean - u)
    promised = 50.0 * float(residual @ residual) - 50.0 * float(kept @ kept)
    assert promised > 1.0
    screening = SimpleNamespace(
        kinks=True, coefficients=data, errors=SimpleNamespace(variances=lambda errors: S)
    )
    there = data - forward(mean)
    gained = max(0.0, 50.0 * float(residual @ residual) - 50.0 * float(there @ there))
    assert (gained < promised - 1.0) == cut
    delivered = Screening.delivered(screening, fit)  # type: ignore[arg-type]
    assert delivered == pytest.approx(-7.0 - max(0.0, promised - gained))
    smooth = SimpleNamespace(**{**vars(screening), "kinks": False})
    assert Screening.delivered(smooth, fit) == -7.0  # type: ignore[arg-type]


def test_a_wider_baseline_is_screened_as_the_first_was() -> None:
    study = made([], series=(0,), n=32)
    baseline = baseline_of(study)
    data = screening_of(study, ["sensor-gain"]).data
    first = Screening(data, baseline, [], errors=Harmonics(), smooth=False, kinks=True)
    wider = first.with_baseline(baseline, np.zeros(4))
    assert (wider.smooth, wider.kinks) == (False, True)
