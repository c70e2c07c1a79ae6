"""Search, evidence, groups: on data of the solver itself, and against brute force."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import binom

from zoo import load_study
from zoo.blood.effects import CATALOGUE, Place, apply_all, get_base, simulate
from zoo.blood.study import Series, Study
from zoo.core.diagnosis.discrepancy import Errors, Harmonics, log_density
from zoo.core.diagnosis.screening import (
    CORRELATED,
    NO_GAP,
    SEARCH,
    UNLISTED,
    VISIBLE,
    Fit,
    Forward,
    Hypothesis,
    Parameter,
    Screening,
    Search,
    SearchError,
    _groups,
    score,
)

QUANTITY = "pressure_mmHg"
THETA = {"f3": 4.6e4, "psi1": 0.35, "psi2": 0.9, "c": 1.2}


def made(
    added: list[tuple[str, tuple[float, ...], Place]],
    *,
    series: tuple[int, ...] = (0, 1, 2),
    noise: float = 0.05,
    seed: int = 1,
    n: int = 256,
) -> Study:
    """The demo study with data of the solver: linear-constant, with effects, and white noise in mmHg."""
    demo = load_study("demo")
    base = get_base("linear-constant")
    case = apply_all(
        base.case(demo, THETA, SEARCH), [(CATALOGUE[name], values, place) for name, values, place in added]
    )
    chosen = [demo.series[i] for i in series]
    times = np.arange(n) * demo.period_s / n
    waves, reason = simulate(case, [(s.vessel, s.position, s.quantity) for s in chosen], times)
    assert reason is None
    waves = waves + noise * np.random.default_rng(seed).standard_normal(waves.shape)
    return replace(
        demo,
        time_s=times,
        series=tuple(Series(s.vessel, s.position, s.quantity, w) for s, w in zip(chosen, waves, strict=True)),
    )


AMPLITUDES = {
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


def amplitudes(name: str) -> tuple[float, ...]:
    first = CATALOGUE[name].amplitudes[0]
    return AMPLITUDES.get(name, (min(first.scale, 0.6 * first.high),))


@pytest.mark.parametrize("name", [n for n, e in CATALOGUE.items() if e.apply is not None])
def test_amplitude_is_recovered_from_noise_free_data(name: str) -> None:
    """To 1 %, or the base alone fits as well: then the effect is absorbed, and no amplitude can be told."""
    effect = CATALOGUE[name]
    places = effect.places(get_base("linear-constant").case(load_study("demo"), THETA).network)
    place = places[min(2, len(places) - 1)]
    wanted = amplitudes(name)
    study = made([(name, wanted, place)], noise=0.0)
    H = Harmonics(study)
    S = H.variances({QUANTITY: Errors(0.01)})
    data = H(study.values)
    forward = Forward(study, get_base("linear-constant"), Hypothesis(((name, place),)), H)
    search = Search(forward, data, S)
    start = [math.log(THETA[p]) for p in ("f3", "psi1", "psi2", "c")]
    u = np.array([*start, *(1.3 * a for a in wanted)])
    point = search.polish(search.descend(search.at(u), 15, 1e-4), 4)
    found = forward.values(point.u)[4]
    if found == pytest.approx(wanted[0], rel=0.01):
        return
    base = Search(Forward(study, get_base("linear-constant"), Hypothesis(), H), data, S)
    alone = base.polish(base.descend(base.at(np.array(start)), 15, 1e-4), 3)
    absorbed = math.sqrt(float(np.mean((data - alone.computed) ** 2)))
    assert absorbed < 0.05, f"{found} instead of {wanted[0]}, and the base leaves {absorbed} mmHg"


def test_evidence_is_the_integral_over_the_parameters() -> None:
    """Against importance sampling of all five parameters with the solver itself."""
    study = made([("sensor-offset", (1.0,), Place())], series=(0,), n=64)
    screening = Screening(study, effects=["sensor-offset"])
    screened = screening.run()
    (fit,) = screened.fits.values()
    errors = {q: replace(e, delta=0.0) for q, e in fit.errors.items()}
    S = screening.harmonics.variances(errors)
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
        total.append(log_density(screening.data - computed, S) + fit.forward.prior(u)[0] - log_q)
    wanted = float(logsumexp(total)) - math.log(len(total))
    point = replace_point(fit)
    from zoo.core.diagnosis.discrepancy import noise_log_prior

    again = screening.evidence(fit.forward, point, dict.fromkeys(fit.allowances, 0.0))
    noise = {q: replace(e, delta=0.0) for q, e in again.errors.items()}
    for q in noise:  # the same noise as in the brute force, to within its own search
        assert noise[q].noise == pytest.approx(errors[q].noise, rel=0.05)
    own = again.log_z - sum(noise_log_prior(e, study.period_s) for e in again.errors.values())
    shift = log_density(again.residual, S) - log_density(
        again.residual, screening.harmonics.variances(again.errors)
    )
    assert own + shift == pytest.approx(wanted, abs=0.5)


def replace_point(fit):  # type: ignore[no-untyped-def]
    from zoo.core.diagnosis.screening import Point

    return Point(fit.u, fit.computed, fit.jacobian)


@pytest.fixture(scope="module")
def gain():  # type: ignore[no-untyped-def]
    study = made([("sensor-gain", (0.15,), Place())])
    names = ["sensor-gain", "sensor-offset", "inflow-shift", "radius-dependent-viscosity", "tangent-wall"]
    return score(Screening(study, effects=names).run())


def test_the_cause_is_found_with_its_amplitude(gain) -> None:  # type: ignore[no-untyped-def]
    assert gain.leader == "sensor-gain"
    assert gain.probability["sensor-gain"] > 0.95
    mean, sd = gain.best["sensor-gain"].amplitude()
    assert abs(mean - 0.15) < 4 * sd
    assert sd < 0.03
    assert sum(gain.probability.values()) == pytest.approx(1.0)


def test_the_free_discrepancy_is_no_better(gain) -> None:  # type: ignore[no-untyped-def]
    assert gain.log_z[NO_GAP] < gain.log_z[UNLISTED] < gain.log_z["sensor-gain"]


def test_what_the_study_cannot_show_is_invisible(gain) -> None:  # type: ignore[no-untyped-def]
    assert "radius-dependent-viscosity" in gain.invisible
    assert gain.probability["radius-dependent-viscosity"] == 0.0


def test_noise_alone_is_no_gap() -> None:
    study = made([], seed=3)
    found = score(Screening(study, effects=["sensor-gain", "inflow-shift", "tangent-wall", "taper"]).run())
    assert found.leader == NO_GAP
    assert found.probability[NO_GAP] > 0.5


def test_a_bump_is_unlisted() -> None:
    """A click in all series that no effect of the list makes."""
    study = made([], seed=4)
    t = study.time_s
    click = 0.5 * np.exp(-((t - 0.05) ** 2) / 0.004**2) * np.sin(900 * (t - 0.05))
    study = replace(study, series=tuple(replace(s, value=s.value + click) for s in study.series))
    found = score(Screening(study, effects=["sensor-gain", "inflow-shift", "tangent-wall", "taper"]).run())
    assert found.leader == UNLISTED


def test_signatures_that_coincide_make_one_group() -> None:
    """From the root alone a delay of the inflow is a delay of the sensor: a fast, well-damped resonance."""
    study = made([("inflow-shift", (0.001,), Place())], series=(0,))
    found = score(Screening(study, effects=["inflow-shift", "catheter-resonance", "tangent-wall"]).run())
    members = found.members(found.leader)
    assert {"inflow-shift", "catheter-resonance"} <= set(members)
    a, b = (found.best[n].computed for n in ("inflow-shift", "catheter-resonance"))
    assert 0.5 * float(np.sum((a - b) ** 2)) / 0.05**2 < VISIBLE * 1.5


@pytest.fixture(scope="module")
def linear():  # type: ignore[no-untyped-def]
    """A screening whose base is replaced by a linear model of three smooth waves, with flat priors."""
    screening = Screening(made([], n=64), effects=["sensor-gain"])
    H = screening.harmonics
    t = np.arange(64) / 64
    waves = np.stack([np.sin(2 * np.pi * (t[None] * k + phase)) for k, phase in ((1, 0), (2, 0.1), (3, 0.3))])
    J = np.stack([H(np.repeat(w, 3, axis=0)) for w in waves], axis=1)

    class Linear(Forward):
        def __init__(self, d):  # type: ignore[no-untyped-def]
            self.low, self.high = np.full(d, -1e3), np.full(d, 1e3)

        def prior(self, u):  # type: ignore[no-untyped-def]
            return 0.0, np.zeros(len(u)), np.zeros(len(u))

    def fitted(truth, noise):  # type: ignore[no-untyped-def]
        """Least squares of data that are truth and noise; its own error is truth - J u."""
        data = truth + noise
        u = np.linalg.lstsq(J, data, rcond=None)[0]
        errors = {QUANTITY: Errors(0.05)}
        S = H.variances(errors)
        C = np.linalg.inv(J.T @ (J / S[:, None]))
        return Fit(Hypothesis(), Linear(3), u, J @ u, J, data - J @ u, errors, {QUANTITY: 0.1}, 0.0, u, C)

    return screening, J, fitted


def test_what_a_fit_leaves_has_calibrated_intervals(linear) -> None:  # type: ignore[no-untyped-def]
    """True rms of truth minus fit in 60 data sets whose noise is correlated, half with a discrepancy."""
    screening, J, fitted = linear
    H, rng = screening.harmonics, np.random.default_rng(1)
    T = screening.study.period_s
    inside, total = 0, 60
    for i in range(total):
        noise = {
            QUANTITY: Errors(0.05, rng.uniform(0.0, 1.0), 0.03 * T * math.exp(0.5 * rng.standard_normal()))
        }
        smooth = {QUANTITY: Errors(0.0, delta=0.1 * (i % 2), length=0.05 * T)}
        truth = J @ rng.standard_normal(3)
        truth += np.sqrt(H.variances(smooth)) * rng.standard_normal(H.size)
        fit = fitted(truth, np.sqrt(H.variances(noise)) * rng.standard_normal(H.size))
        draws = screening.unexplained(fit, screening.possible_noise(fit), rng, 200).draws
        sizes = np.sqrt(np.mean(draws**2, axis=1))
        wanted = math.sqrt(float(np.mean((truth - fit.computed) ** 2)))
        low, high = np.quantile(sizes, [0.025, 0.975])
        inside += bool(low <= wanted <= high)
    assert binom.cdf(inside, total, 0.95) > 0.005, f"{inside} of {total}"


def test_without_a_discrepancy_the_parameters_error_is_left(linear) -> None:  # type: ignore[no-untyped-def]
    """White noise of 0.05 and three parameters: rms sqrt(3/192) 0.05."""
    screening, J, fitted = linear
    rng = np.random.default_rng(2)
    means = []
    for _ in range(20):
        fit = fitted(J @ np.ones(3), 0.05 * rng.standard_normal(screening.harmonics.size))
        draws = screening.unexplained(fit, screening.possible_noise(fit), rng, 100).draws
        means.append(float(np.sqrt(np.mean(draws**2))))
    expected = 0.05 * math.sqrt(3 / screening.harmonics.size)
    assert expected < np.mean(means) < 1.6 * expected  # a discrepancy as small as this cannot be excluded


def test_what_is_left_does_not_depend_on_a_parameter_without_a_say(linear) -> None:  # type: ignore[no-untyped-def]
    """One that hardly moves the waves leaves room for no larger a discrepancy."""
    screening, J, fitted = linear
    H, rng = screening.harmonics, np.random.default_rng(3)
    smooth = np.sqrt(H.variances({QUANTITY: Errors(0.0, delta=0.03, length=0.05 * screening.study.period_s)}))
    idle = 1e-9 * smooth * rng.standard_normal(H.size)
    fit = fitted(J @ np.ones(3) + smooth * rng.standard_normal(H.size), 0.05 * rng.standard_normal(H.size))
    noise = screening.possible_noise(fit)
    more = replace(
        fit, forward=type(fit.forward)(4), u=np.append(fit.u, 0.0), jacobian=np.column_stack((J, idle))
    )
    sizes = [
        np.sqrt(np.mean(screening.unexplained(f, noise, np.random.default_rng(4), 400).draws ** 2, axis=1))
        for f in (fit, more)
    ]
    np.testing.assert_allclose(*(np.quantile(x, [0.1, 0.5, 0.9]) for x in sizes), rtol=0.15)


@pytest.mark.parametrize("name", [UNLISTED, CORRELATED])
def test_evidence_is_at_most_the_largest_likelihood(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Priors are proper, also where the data have no say on a parameter."""
    screening = Screening(made([]), effects=["sensor-gain"])
    base = screening.fit_base()
    base = replace(base, jacobian=1e-5 * base.jacobian)

    def excess() -> float:
        fit = screening.fit_free(base, name)
        whole = 1.0 / np.sqrt(screening.harmonics.variances(fit.errors))
        d = np.linalg.lstsq(fit.jacobian * whole[:, None], fit.residual * whole, rcond=None)[0]
        return fit.log_z - float(log_density(fit.residual - fit.jacobian @ d, whole**-2.0))

    assert excess() < 0.0
    monkeypatch.setattr(Forward, "log_mass", lambda *arguments: 0.0)
    assert excess() > 0.0  # what it would be without bounds


def test_search_stays_inside_the_bounds() -> None:
    study = made([])
    H = Harmonics(study)
    forward = Forward(study, get_base("linear-constant"), Hypothesis((("beat-jitter", Place()),)), H)
    search = Search(forward, H(study.values), H.variances({QUANTITY: Errors(0.05)}))
    start = [math.log(THETA[p]) for p in ("f3", "psi1", "psi2", "c")]
    point = search.descend(search.at(np.array([*start, 0.01])), 15)
    assert np.all(point.u >= forward.low)
    assert point.u[4] < 0.002


def test_a_search_without_a_solve_says_why() -> None:
    study = made([])
    H = Harmonics(study)
    forward = Forward(study, get_base("linear-constant"), Hypothesis(), H, replace(SEARCH, max_beats=1))
    search = Search(forward, H(study.values), np.ones(H.size))
    with pytest.raises(SearchError, match="periodic"):
        search.at(np.array([math.log(THETA[p]) for p in ("f3", "psi1", "psi2", "c")]))
    assert forward.failures == 1


def test_parameters_have_proper_priors() -> None:
    """The densities integrate to 1 over their bounds."""
    for p in (
        Parameter("f3", "", 2e4, 1e5, True),
        Parameter("f2", "", -3, 5),
        Parameter("a", "", 0.0, 2.0, scale=0.7),
        Parameter("z", "", 0.1, 1.5, centre=0.3, scale=0.2),
    ):
        u = np.linspace(p.outside(p.low), p.outside(p.high), 20001)
        density = np.exp([p.log_prior(float(x)) for x in u])
        assert np.trapezoid(density, u) == pytest.approx(1.0, rel=1e-4)


def test_noise_of_one_quantity_alone_is_explained_by_correlated_noise() -> None:
    """A noisy pressure beside a clean flow: no discrepancy that both have, and no effect."""
    study = made([], series=(0,))
    base = get_base("linear-constant").case(load_study("demo"), THETA, SEARCH)
    waves, _ = simulate(base, [(1, 0.0, "flow_ml_s")], study.time_s)
    rng = np.random.default_rng(5)
    H = Harmonics(study)
    alone = {QUANTITY: Errors(0.0, delta=0.8, length=0.03 * study.period_s, rough=True)}
    [rough] = H.back(np.sqrt(H.variances(alone)) * rng.standard_normal(H.size))
    flow = waves[0] + 0.01 * np.ptp(waves[0]) * rng.standard_normal(len(waves[0]))
    study = replace(
        study,
        series=(
            Series(1, 0.0, QUANTITY, study.series[0].value + rough),
            Series(1, 0.0, "flow_ml_s", flow),
        ),
    )
    screening = Screening(study, effects=["sensor-gain", "sensor-offset"])
    found = score(screening.run())
    assert found.leader == CORRELATED
    assert found.probability[CORRELATED] > 0.99
    errors = found.best[CORRELATED].errors
    assert errors["flow_ml_s"].delta == 0.0
    assert errors[QUANTITY].delta == pytest.approx(0.8, rel=0.4)


def test_what_can_imitate_the_leader_after_a_refit_is_in_its_group() -> None:
    """Waves that differ by what another amplitude would change, by noise, or by something else."""
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
