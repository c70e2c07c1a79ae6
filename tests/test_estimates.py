"""Sizes of effects: their posteriors against quadrature, sampling, and truths on another grid."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, truncnorm

from zoo.core.data import Data
from zoo.core.diagnosis.estimates import INTERVAL, Scan, _mixture, linearised, posteriors_of
from zoo.core.diagnosis.evidence import Fit
from zoo.core.diagnosis.hypothesis import Hypothesis
from zoo.core.diagnosis.screening import Screening
from zoo.core.effects import Effect, EffectParameter, Location, effect
from zoo.core.errors.spectral import GroupErrors, Harmonics
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.parameters import Normal, Parameter

N, NOISE = 64, 0.05
TIMES = np.arange(N) / N
WAVES = np.stack([np.sin(2 * np.pi * TIMES), np.cos(4 * np.pi * TIMES + 0.3)])


class Gridded(FunctionModel):
    """level w1(t) + f(s) w2(t) whose grid of cells h adds a part h^2 to f: a scheme of second order."""

    h = 0.0

    def refined(self) -> Gridded | None:
        if not self.h:
            return None
        return gridded(0.5 * self.h)


def narrowed(s: float) -> float:
    """What a narrowing by a part s of the radius adds to a resistance."""
    return 0.05 * ((1.0 - s) ** -4 - 1.0)


def gridded(h: float) -> Gridded:
    def solve(configuration, times):  # type: ignore[no-untyped-def]
        size = narrowed(configuration.get("s", 0.0)) * (1.0 + h * h * (1.0 + 0.3 * h))
        return (configuration["level"] * WAVES[0] + size * WAVES[1])[None]

    made = Gridded(solve, (Parameter("level", Normal(1.0, 1.0)),), Outputs(("y",), TIMES), "gridded")
    object.__setattr__(made, "h", h)
    return made


@effect("throat", parameters=[EffectParameter("s", "1", 0.3, 0.0, 0.85, (0.5, 0.25))])
def throat(configuration, values, location):  # type: ignore[no-untyped-def]
    """A narrowing."""
    return {**configuration, "s": values[0]}


def fitted(s: float, h: float = 0.0, seed: int = 1, noise: float = NOISE) -> tuple[Screening, Fit]:
    """The throat fitted on a grid to data of none."""
    values = WAVES[:1] + narrowed(s) * WAVES[1] + noise * np.random.default_rng(seed).standard_normal((1, N))
    data = Data(TIMES, values, labels=["y"], units=["K"], groups=["y"], period=1.0, name="toy")
    screening = Screening(data, gridded(h), [throat], errors=Harmonics(), cores=1)
    noises, allowances = {"y": GroupErrors(noise)}, {"y": 0.1 * noise}
    S = screening.beside(noises, allowances)
    fit = screening.fit_effect(Hypothesis((throat.at(),)), screening.fit_base(), S, allowances)
    assert fit is not None
    return screening, fit


def known_noise(scan: Scan, noise: float = NOISE) -> Scan:
    """The scan with white noise of a known size and no allowance."""
    scan.S, scan.log_weights = np.full((1, N), noise**2), np.zeros(1)
    return scan


def test_a_skewed_posterior_is_that_of_quadrature() -> None:
    """A size that the data tell badly, near its lower bound: mean, sd and interval, to a tenth of the sd."""
    screening, fit = fitted(0.08, noise=0.2)
    found = known_noise(Scan(screening, fit), 0.2).posteriors()[0]
    level, s = np.linspace(0.0, 2.0, 401)[:, None], np.linspace(0.0, 0.85, 3001)
    y = screening.data.values[0]
    parts = [float(y @ y), WAVES @ y, WAVES @ WAVES.T]
    size = np.array([narrowed(x) for x in s])
    square = parts[0] - 2 * level * parts[1][0] - 2 * size * parts[1][1]
    square = square + level**2 * parts[2][0, 0] + 2 * level * size * parts[2][0, 1] + size**2 * parts[2][1, 1]
    log_p = -0.5 * square / 0.2**2 - 0.5 * (level - 1.0) ** 2 - 0.5 * (s / 0.3) ** 2
    p = np.exp(log_p - log_p.max()).sum(axis=0)
    p /= p.sum()
    mean = float(p @ s)
    sd = math.sqrt(float(p @ (s - mean) ** 2))
    low, high = np.interp(INTERVAL, np.cumsum(p), s)
    assert [found.mean, found.sd, found.low, found.high] == pytest.approx([mean, sd, low, high], abs=0.1 * sd)
    assert (high - mean) / sd < 1.7 or (mean - low) / sd < 1.7  # it is far from normal
    plain = linearised(replace(fit, covariance=fit.covariance))[0]
    assert abs(plain.low - low) + abs(plain.high - high) > 0.2 * sd


def test_the_error_of_the_grid_is_taken_off_and_doubted() -> None:
    """On a grid that moves a size by 10 standard deviations the interval holds the truth all the same."""
    old, new, inside, total = [], [], 0, 30
    for seed in range(total):
        screening, fit = fitted(0.4, h=0.3, seed=seed, noise=0.01)
        coarse = linearised(fit)[0]
        size = posteriors_of(screening, fit)[0]
        old.append((coarse.mean - 0.4) / coarse.sd)
        new.append((size.mean - 0.4) / size.sd)
        inside += size.low <= 0.4 <= size.high
    assert max(old) < -5.0
    assert max(map(abs, new)) < 3.0
    assert binom.cdf(inside, total, 0.95) > 0.01, f"{inside} of {total}"


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """Sizes drawn from their prior: 95 % of the intervals hold them, no fewer and no more."""
    rng, inside, total, z, widths = np.random.default_rng(3), 0, 100, [], []
    for seed in range(total):
        s = float(truncnorm.rvs(0.0, 0.85 / 0.3, 0.0, 0.3, random_state=rng))
        size = posteriors_of(*fitted(s, seed=seed))[0]
        inside += size.low <= s <= size.high
        z.append((size.mean - s) / size.sd)
        widths.append((size.high - size.low) / 0.3)
    assert 0.005 < binom.cdf(inside, total, 0.95), f"{inside} of {total}"
    assert binom.sf(inside - 1, total, 0.95) > 0.001, f"{inside} of {total}"
    assert 0.8 < float(np.std(z)) < 1.2
    assert abs(float(np.mean(z))) < 0.3
    assert float(np.median(widths)) < 0.5


@pytest.mark.parametrize(("m", "s"), [(0.5, 0.1), (-3.0, 0.2), (1.1, 0.4)])
def test_a_linearised_posterior_ends_at_the_bounds(m: float, s: float) -> None:
    """As `scipy.stats.truncnorm`, also where all of it lies beyond a bound."""
    found = _mixture(np.array([m]), np.array([s]), 0.0, 1.0)
    wanted = truncnorm((0.0 - m) / s, (1.0 - m) / s, m, s)
    assert found.mean == pytest.approx(wanted.mean(), rel=0.02)
    assert found.sd == pytest.approx(wanted.std(), rel=0.1)
    assert (found.low, found.high) == pytest.approx(tuple(wanted.ppf(INTERVAL)), abs=0.1 * wanted.std())


def test_an_effect_of_the_grid_has_no_finer_one() -> None:
    coarser = Effect("coarse", throat.parameters, throat.apply, family="numerics")
    screening, fit = fitted(0.3, h=0.2)
    assert fit.forward.refined() is not None
    hypothesis = Hypothesis((coarser.at(Location()),))
    assert screening.forward(hypothesis).refined() is None
