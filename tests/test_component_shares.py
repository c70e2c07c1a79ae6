"""Shares of the gap by component: against dense normal densities, calibrated, and with known truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from linear_components import NOISE, Toy, a_function
from zoo.core.diagnosis.components.shares import Shares, pair_of, shares_of
from zoo.core.diagnosis.hypothesis import NONPARAMETRIC
from zoo.core.errors.spectral import GroupErrors


def two_functions(**given) -> Toy:
    functions = [a_function("one", "wall", lengths=(0.8, 3.0)), a_function("two", "inflow", 4, 0.5, ())]
    return Toy(functions, **given)


def test_scales_lengths_and_the_discrepancy_have_the_posterior_of_dense_normal_densities() -> None:
    """Draws of the prior, weighted by the density of the data in time, whose covariance is written out."""
    toy = two_functions(n_times=16, harmonics=2, seed=3, noise=GroupErrors(0.3))
    residual, _ = toy.drawn([0.6, 0.3], 0.3, shared=0.4)
    found = shares_of(toy.problem(residual), seed=1, sweeps=2000)
    r = toy.errors.unflat(residual).ravel()
    as_time = toy.errors.unflat(np.eye(toy.errors.size)).reshape(toy.errors.size, -1).T  # series after series
    J, X = as_time @ toy.jacobian, [as_time @ x for x in toy.columns]
    apart = np.abs(toy.times[:, None] - toy.times)
    rng = np.random.default_rng(0)
    kept, log_w = [], []
    lags = np.arange(-8, 9)
    for _ in range(6000):
        s = np.abs(rng.standard_normal(2)) * [1.0, 0.5]
        length = rng.choice([0.8, 3.0])
        delta = abs(rng.standard_normal()) * toy.delta_scale
        ell = rng.choice(toy.errors.length_grid, p=grid_weights(toy))
        rho = rng.choice(toy.errors.shared)
        # a squared-exponential covariance around the period, without the power that the grid cannot hold
        k = np.sum(np.exp(-0.5 * ((apart[..., None] + lags) / ell) ** 2), axis=-1)
        between = np.full((2, 2), rho) + (1.0 - rho) * np.eye(2)
        V = 0.09 * np.eye(32) + J @ J.T + delta**2 * np.kron(between, k / k[0, 0])
        for x, sd, f, at in zip(X, s, toy.functions, (length, None), strict=True):
            V = V + sd**2 * x @ f.correlation(at) @ x.T
        log_w.append(multivariate_normal.logpdf(r, cov=V))
        kept.append((*s, length, delta))
    w = np.exp(np.array(log_w) - max(log_w))
    w /= w.sum()
    assert 1.0 / np.sum(w**2) > 100  # enough to compare with
    wanted = w @ np.array(kept)
    spread = np.sqrt(w @ (np.array(kept) - wanted) ** 2)
    draws = [found.scales["one"], found.scales["two"], found.lengths["one"], found.free["y"]]
    for mean, sd, x in zip(wanted, spread, draws, strict=True):
        assert x.mean() == pytest.approx(mean, abs=0.3 * sd)
        assert x.std() == pytest.approx(sd, rel=0.3)


def grid_weights(toy: Toy) -> np.ndarray:
    w = np.exp([toy.errors.length_log_prior(x) for x in toy.errors.length_grid])
    return w / w.sum()


def calibration(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Ranks of true scales among their draws, and whether intervals hold the true shares, of n problems."""
    ranks, held = [], []
    for seed in range(n):
        toy = two_functions(seed=seed, noise=GroupErrors(0.1))
        rng = np.random.default_rng(seed + 10_000)
        s = np.abs(rng.standard_normal(2)) * [1.0, 0.5]
        delta = abs(rng.standard_normal()) * toy.delta_scale
        # the first length of two is the truth where the prior has one only
        toy.functions = [a_function("one", "wall", lengths=(0.8,)), toy.functions[1]]
        ell = rng.choice(toy.errors.length_grid, p=grid_weights(toy))
        rho = rng.choice(toy.errors.shared)
        residual, parts = toy.drawn(s, delta, ell, rho)
        found = shares_of(toy.problem(residual), seed=seed, sweeps=300)
        draws = [found.scales["one"], found.scales["two"], found.free["y"]]
        ranks.append([np.mean(x < true) for x, true in zip(draws, (*s, delta), strict=True)])
        left = [toy.without_parameters(x) for x in parts]
        gap = sum(left)
        for name, x in zip(found.names, left, strict=True):
            one = found.of(name)
            held.append(one.low <= float(x @ gap / (gap @ gap)) <= one.high)
    return np.array(ranks), np.array(held)


@pytest.mark.slow
def test_of_problems_drawn_from_the_prior_intervals_hold_their_part() -> None:
    ranks, held = calibration(60)
    # the mean of 60 uniform numbers, and of their squares' deviations, within three and a half sds
    assert np.all(np.abs(ranks.mean(axis=0) - 0.5) < 3.5 / np.sqrt(12 * 60))
    assert np.all(np.abs(ranks.var(axis=0) - 1 / 12) < 3.5 * np.sqrt(1 / 180 / 60))
    assert 0.88 <= held.mean() <= 1.0


def four_functions(**given) -> Toy:
    names = ("wall", "inflow", "outlets", "fluid")
    return Toy([a_function(f"of {name}", name) for name in names], n_series=3, n_times=64, **given)


def told(found: Shares) -> dict[str, float]:
    return {name: found.of(name).mean for name in found.names}


def test_shares_are_the_true_ones_and_add_up_to_one() -> None:
    toy = four_functions()
    residual, parts = toy.drawn([0.0, 0.4, 0.4, 0.0], 0.0)
    found = shares_of(toy.problem(residual), sweeps=200)
    np.testing.assert_allclose(found.draws.sum(axis=1), 1.0)
    left = [toy.without_parameters(x) for x in parts]
    gap = sum(left)
    for name, x in zip(found.names, left, strict=True):
        assert told(found)[name] == pytest.approx(float(x @ gap / (gap @ gap)), abs=0.02)
    assert found.size.mean() == pytest.approx(np.sqrt(np.mean(gap**2)) / np.ptp(toy.base[0]), rel=0.05)
    assert shares_of(toy.problem(residual), group="y", sweeps=20).size.mean() == pytest.approx(
        np.sqrt(np.mean(gap**2)), rel=0.05
    )
    assert set(pair_of(found)) == {"inflow", "outlets"}
    np.testing.assert_allclose(found.signals.sum(axis=0), gap, atol=8 * NOISE)


def test_what_no_component_holds_is_unlisted() -> None:
    toy = four_functions(harmonics=2, seed=1)
    residual, _ = toy.drawn([0.0] * 4, 1.0, length=0.03)
    found = shares_of(toy.problem(residual), sweeps=200)
    assert told(found)[NONPARAMETRIC] > 0.8
    assert pair_of(found) == ()


def test_components_that_look_alike_exchange_their_shares_and_are_no_pair() -> None:
    toy = four_functions()
    toy.columns[1] = toy.columns[0]
    residual, _ = toy.drawn([1.0, 0.0, 0.0, 0.0], 0.0)
    found = shares_of(toy.problem(residual), sweeps=400)
    assert found.correlation[0, 1] < -0.95
    assert found.of("wall").low < 0.1
    assert found.of("wall").high > 0.9
    assert pair_of(found) == ()


def test_what_the_parameters_absorb_is_no_part_of_the_gap() -> None:
    """A function whose response is the parameters' own beside what only it does."""
    toy = four_functions()
    own = toy.columns[0].copy()
    toy.columns[0] = own + 30.0 * toy.jacobian[:, [0]]
    residual, parts = toy.drawn([1.0, 0.0, 0.0, 0.0], 0.0)
    found = shares_of(toy.problem(residual), group="y", sweeps=100)
    left = toy.without_parameters(parts[0])
    assert found.size.mean() == pytest.approx(np.sqrt(np.mean(left**2)), rel=0.05)
    assert np.sqrt(np.mean(left**2)) < 0.5 * np.sqrt(np.mean(parts[0] ** 2))


def test_of_cross_terms_either_has_half() -> None:
    """Two signals that nearly cancel: a share below 0 and one above 1."""
    toy = four_functions(harmonics=3)
    toy.columns[1] = -0.7 * toy.columns[0] + 0.3 * toy.smooth(6)
    residual, _ = toy.drawn([0.0] * 4, 0.0)
    z = np.ones(6)
    x, y = (toy.columns[i] @ z for i in (0, 1))
    found = shares_of(toy.problem(residual + x + y), sweeps=200)
    x, y = toy.without_parameters(x), toy.without_parameters(y)
    wanted = float(x @ x + x @ y) / float((x + y) @ (x + y))
    assert told(found)["wall"] == pytest.approx(wanted, abs=0.15 * abs(wanted))


def test_a_pair_needs_the_whole_of_both_intervals() -> None:
    def made(low: float) -> Shares:
        rng = np.random.default_rng(0)
        one = norm.rvs(0.4, 0.01, 500, random_state=rng)
        two = np.linspace(low, 0.5, 500)
        draws = np.stack([one, two, 1.0 - one - two], axis=1)
        empty: dict[str, np.ndarray] = {}
        return Shares(("wall", "fluid", NONPARAMETRIC), draws, one, empty, empty, empty, np.zeros((3, 1)))

    assert pair_of(made(0.15)) == ("wall", "fluid")
    assert pair_of(made(0.05)) == ("wall",)
