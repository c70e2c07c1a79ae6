"""What weighs explanations, on a model that is linear: there each weight is known in closed form."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import halfnorm, kstest, multivariate_normal, norm, truncnorm

from zoo.core.data import Data
from zoo.core.diagnosis.answer import FitDiscrepancy
from zoo.core.diagnosis.discrepancy import SIZE_PART, _truncated
from zoo.core.diagnosis.hooks import Candidate, Hooks, next_measurement
from zoo.core.diagnosis.hypothesis import NONPARAMETRIC, NULL
from zoo.core.diagnosis.scoring import _groups, score
from zoo.core.diagnosis.screening import Screening
from zoo.core.effects import EffectParameter, Location, effect
from zoo.core.errors.spectral import Cosines
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.parameters import Normal, Parameter

TIMES = np.arange(64) / 64.0
WAVE, BUMP = np.cos(2 * np.pi * TIMES), np.exp(-0.5 * ((TIMES - 0.6) / 0.05) ** 2)
NOISE, PRIOR_SD = 0.05, 2.0


def waves(configuration, times):  # type: ignore[no-untyped-def]
    """A wave of unknown size, and a bump."""
    return (configuration["size"] * WAVE + configuration.get("bump", 0.0) * BUMP)[None]


MODEL = FunctionModel(
    waves, (Parameter("size", Normal(1.0, PRIOR_SD), "V"),), Outputs(("one",), TIMES), "waves"
)


def measured(added: np.ndarray | float = 0.0, seed: int = 3) -> Data:
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(TIMES))
    return Data(TIMES, (WAVE + added + noise)[None], labels=["one"], units=["V"], groups=["U"], name="waves")


def bump_at(*parts: int):  # type: ignore[no-untyped-def]
    """An effect that does the same wherever it acts."""

    @effect(
        "bump",
        parameters=[EffectParameter("height", "V", 0.3, -2.0, 2.0, (0.3, -0.3))],
        locations=lambda model: tuple(Location(part, noun="part") for part in parts),
    )
    def bump(configuration, values, location):  # type: ignore[no-untyped-def]
        """A bump."""
        return {**configuration, "bump": values[0]}

    return bump


def test_places_that_do_the_same_count_as_one() -> None:
    """To ask at eight places what one explains as well is no evidence: each has an eighth of the prior."""
    data = measured(0.2 * BUMP)
    found = [
        score(Screening(data, MODEL, [bump_at(*range(1, n + 1))], errors=Cosines(), cores=1).run())
        for n in (1, 8)
    ]
    assert found[0].log_z["bump"] == pytest.approx(found[1].log_z["bump"], abs=0.1)
    for (
        one
    ) in found:  # odds: Bayes factor times 0.5 for no gap over 0.2, half of what is left for listed ones
        factor = one.log_z[NULL] - one.log_z["bump"]
        odds = one.probability[NULL] / one.probability["bump"]
        assert math.log(odds) == pytest.approx(factor + math.log(0.5 / 0.2))
    left = 0.2 * (BUMP - WAVE * (WAVE @ BUMP) / (WAVE @ WAVE))
    for one in found:  # a cause may leave a tenth of the gap, beside the numerics' thousandth of the range
        gap = one.screened.gap["U"]
        assert gap == pytest.approx(math.sqrt(float(np.mean(left**2))), rel=0.35)
        assert one.screened.allowances["U"] == pytest.approx(
            math.hypot(0.1 * gap, 1e-3 * float(np.ptp(data.values)))
        )
    shares = [share for _, share in found[1].locations["bump"]]
    np.testing.assert_allclose(shares, 1 / 8, rtol=0.1)


@pytest.mark.parametrize("size", [0.0, 4.0])
def test_evidence_of_a_free_discrepancy_is_the_integral_over_its_prior(
    size: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half-normal in its size, log-normal in its length: the dense normal density, by quadrature."""
    data = measured(size * SIZE_PART * 2.0 * BUMP / math.sqrt(float(np.mean(BUMP**2))))
    monkeypatch.setattr(
        Cosines, "fit_noise", lambda self, part, q, start, **k: replace(start, sigma=NOISE, ratio=0.0)
    )
    screening = Screening(data, MODEL, [], errors=Cosines(), cores=1)
    fit = screening.fit_free(screening.fit_base(), NONPARAMETRIC)
    # beside a discrepancy the baseline has another mode, and the fit has gone there
    moved = float(abs(fit.u - screening.base.alone.u)[0] / fit.sd[0])
    assert abs(fit.mean - fit.u)[0] / fit.sd[0] < (0.1 * moved if size else 0.02)
    H, n = screening.errors, len(TIMES)
    unit = SIZE_PART * float(np.ptp(data.values))
    known = NOISE**2 * np.eye(n) + PRIOR_SD**2 * np.outer(WAVE, WAVE)
    # normal processes of the cosines' spectrum exp(-(omega length)^2/2), of mean 1
    omega = np.pi * np.arange(n) / (n * (TIMES[1] - TIMES[0]))
    basis = H.inverse(np.eye(n)[:, None])[:, 0]
    median, spread = H.length

    def density(delta: float, x: float) -> float:
        spectrum = np.exp(-0.5 * (omega * median * math.exp(spread * x)) ** 2)
        own = basis.T @ ((spectrum / spectrum.mean())[:, None] * basis)
        return float(multivariate_normal(WAVE, known + (delta * unit) ** 2 * own).logpdf(data.values[0]))

    x = np.linspace(-1.5, 1.5, 7)  # as far as lengths are tried
    d = np.linspace(0.0, 8.0, 121)
    table = np.array([[density(one, at) for one in d] for at in x]) + halfnorm.logpdf(d)
    terms = table.max() + np.log(np.trapezoid(np.exp(table - table.max()), d))
    weights = norm.logpdf(x) - logsumexp(norm.logpdf(x))
    noise = sum(H.noise_log_prior(e) for e in fit.errors.values())
    assert fit.log_z - noise == pytest.approx(float(logsumexp(weights + terms)), abs=0.35)


@pytest.mark.parametrize(("odds", "alike"), [(19.5, True), (20.5, False)])
def test_explanations_that_the_data_tell_apart_at_odds_of_twenty(odds: float, alike: bool) -> None:
    """Half the squared difference of two waves over the variance is the expected log of their odds."""
    S = np.full(40, 0.01)
    base, leader, other, change = np.random.default_rng(1).standard_normal((4, 40))
    other -= change * (other @ change) / (change @ change)
    other *= math.sqrt(2.0 * math.log(odds) / float(np.sum(other**2 / S)))

    def fit(computed: np.ndarray) -> SimpleNamespace:
        forward = SimpleNamespace(asked=0)
        return SimpleNamespace(computed=computed, jacobian=change[:, None], forward=forward)

    best = {"one": fit(leader), "other": fit(leader + other)}
    screened = SimpleNamespace(base=fit(base))
    found = _groups(screened, list(best), best, dict.fromkeys(best, 0.0), (), S)  # type: ignore[arg-type]
    assert (found["one"] == found["other"]) is alike


def test_the_removed_part_ends_where_a_fit_without_noise_would() -> None:
    """A gap of 2, of which this fit leaves 0.5 and one to data without noise 0.1: 75 % to 95 % are gone."""

    def left(rms: float, unabsorbed: float) -> FitDiscrepancy:
        still = np.zeros((1, 8))
        return FitDiscrepancy(still, still, np.full((50, 1), rms), np.full((50, 1), unabsorbed), still)

    found = left(0.5, 0.1).removed([0], left(2.0, 2.0))
    assert (found.mean, found.low, found.high) == pytest.approx((0.75, 0.75, 0.95))


def test_draws_within_bounds_have_the_truncated_normal_law() -> None:
    """Of two independent parameters SciPy has it; of two that go together above 0 the mean is known."""
    rng = np.random.default_rng(5)
    mean, sd = np.array([1.0, -2.0]), np.array([2.0, 0.5])
    low, high = np.array([2.0, -2.2]), np.array([7.0, -1.0])
    start = np.tile([3.0, -1.5], (2000, 1))
    draws = _truncated(start, mean, np.diag(sd**2), low, high, rng)
    for i in range(2):
        law = truncnorm((low[i] - mean[i]) / sd[i], (high[i] - mean[i]) / sd[i], mean[i], sd[i])
        assert kstest(draws[:, i], law.cdf).pvalue > 1e-3
    rho = 0.8
    draws = _truncated(
        np.full((2000, 2), 0.5), np.zeros(2), np.array([[1.0, rho], [rho, 1.0]]), np.zeros(2),
        np.full(2, np.inf), rng,
    )  # fmt: skip
    # E x of the quadrant where both are above 0 is (1 + rho) phi(0)/2 over its probability
    part = 0.25 + math.asin(rho) / (2 * math.pi)
    wanted = (1 + rho) / (2 * math.sqrt(2 * math.pi) * part)
    np.testing.assert_allclose(draws.mean(axis=0), wanted, rtol=0.06)


@pytest.mark.parametrize(("probability", "asked"), [(0.004, False), (0.02, True)])
def test_a_measurement_separates_only_what_is_in_doubt(probability: float, asked: bool) -> None:
    """Below a hundredth nothing is a rival; the gain is half the squared distance over the noise."""
    model = SimpleNamespace(outputs=Outputs(("one",), TIMES))
    data = SimpleNamespace(outputs=("one",))
    screening = SimpleNamespace(data=data, baseline=model)
    series = {"first": np.zeros((1, 64)), "second": np.full((1, 64), 0.1)}
    scored = SimpleNamespace(
        leader="first",
        names=("first", "second"),
        locations={"first": [], "second": []},
        probability={"first": 1.0 - probability, "second": probability},
        twins=lambda name: [],
        is_cause=lambda name: True,
        standing={"first": 1.0 - probability, "second": probability}.__getitem__,
        belongs={},
        best={
            name: SimpleNamespace(u=None, forward=SimpleNamespace(series=lambda u, wanted, y=y: y))
            for name, y in series.items()
        },
        screened=SimpleNamespace(screening=screening, noise={"U": SimpleNamespace(noise=NOISE)}),
    )
    hooks = Hooks(candidates=lambda data, model: [Candidate("other", {"vessel": 3}, "U")])
    found = next_measurement(scored, hooks)  # type: ignore[arg-type]
    gains = [] if found is None else [(found.separates, found.expected_log_odds)]
    wanted = (("first", "second"), pytest.approx(0.5 * 64 * 0.1**2 / NOISE**2))
    assert gains == ([wanted] if asked else [])
