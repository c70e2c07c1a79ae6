"""The posterior over sets of causes beside direct integrals, and under changes that must not matter."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from benchmarks.causes import RANGE, LinearToy
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from zoo.core.causes import Cause, CauseError, CausePriors, Problem, weigh_causes
from zoo.core.causes.evidence import SetEvidence, SetModel, SizePriors, _combinations, hermite
from zoo.core.causes.family import COLOURED, NOISE_SPREAD, SIZES
from zoo.core.causes.problem import without_doubles
from zoo.core.causes.reference import Reference
from zoo.core.causes.truncated import truncate
from zoo.core.priors import log_normal_mass


@pytest.fixture(scope="module")
def toy() -> LinearToy:
    return LinearToy(n_series=2, n_times=16)


def marginal_normal(problem: Problem, causes, scales, V: np.ndarray) -> np.ndarray:
    """log N(r; 0, V + J P^-1 J' + sum s^2 R R') for each V, of parameters with a proper normal prior."""
    shared = problem.jacobian @ np.linalg.inv(problem.P) @ problem.jacobian.T
    for one, s in zip(causes, scales, strict=True):
        shared = shared + s**2 * one.columns @ one.columns.T
    L = np.linalg.cholesky(shared + V[..., None] * np.eye(V.shape[-1]))
    white = np.linalg.solve(L, np.broadcast_to(problem.residual[:, None], (*L.shape[:-1], 1)))[..., 0]
    return norm.logpdf(white).sum(axis=-1) - np.log(np.diagonal(L, axis1=-2, axis2=-1)).sum(axis=-1)


def direct(toy: LinearToy, problem: Problem, causes, sizes: SizePriors, found: SetEvidence) -> float:
    """The evidence of a set by plain sums over fine grids of noise, sizes and functions' sizes."""
    f = found.family
    x = np.linspace(-3.5, 3.5, 57)
    log_noise = f.noise_centre[0] + NOISE_SPREAD * x
    log_w = norm.logpdf(x) + math.log(x[1] - x[0])
    free = [one for one in causes if one.free]
    s_grid = np.geomspace(0.003, 4.0, 48) if free else np.ones(1)
    log_s = np.log(np.gradient(s_grid)) + math.log(2) + norm.logpdf(s_grid) if free else np.zeros(1)
    d_grid = np.concatenate([[0.0], np.geomspace(1e-4, 0.6, 30)])
    edges = np.concatenate([[0.0], np.sqrt(d_grid[1:-1] * d_grid[2:]), [np.inf]])
    edges = np.concatenate([[0.0, 0.5e-4], edges[1:]])
    log_d, log_like = (
        np.log(np.maximum(sum(w * 2 * np.diff(norm.cdf(edges / k)) for k, w in scales.items()), 1e-300))
        for scales in sizes.scales(found.signal)
    )
    terms = []
    for s, ls in zip(s_grid, log_s, strict=True):
        scales = [s if one.free else 1.0 for one in causes]
        C = problem.jacobian @ np.linalg.inv(problem.P) @ problem.jacobian.T
        C = C + sum(k**2 * one.columns @ one.columns.T for one, k in zip(causes, scales, strict=True))

        def log_density(V: np.ndarray, C: np.ndarray = C) -> np.ndarray:
            K = C + V[:, :, None] * np.eye(V.shape[1])
            L = np.linalg.cholesky(K)
            y = np.linalg.solve(L, np.broadcast_to(problem.residual, V.shape)[..., None])[..., 0]
            logdet = 2 * np.log(np.einsum("nii->ni", L)).sum(axis=1)
            return -0.5 * np.sum(y**2, axis=1) - 0.5 * logdet - 0.5 * V.shape[1] * math.log(2 * math.pi)

        noise = np.exp(2 * log_noise)
        for shape, ratio in enumerate(f.log_colours):
            V = noise[:, None] * f.of(np.array([1 + shape]))[0][0]
            terms.append(logsumexp(log_density(V) + log_w) + ratio + ls + math.log(COLOURED))
        spectra = [(f.discrepancies[i], log + log_d) for i, log in enumerate(f.log_shapes)]
        if f.own is not None:
            spectra.append((f.own, log_like))
        for h, log in spectra:
            for d, ld in zip(d_grid, log, strict=True):
                V = noise[:, None] + d**2 * h
                own = ld + ls + math.log(1 - COLOURED)
                if own > -25:
                    terms.append(logsumexp(log_density(V) + log_w) + own)
    return float(logsumexp(terms))


@pytest.mark.parametrize("seed", [1, 4])
def test_the_evidence_of_nothing_is_that_of_plain_sums(toy, seed):
    rng = np.random.default_rng(seed)
    problem = toy.problem(toy.drawn(rng)[1])
    found = SetModel(problem, (), toy.family).evidence(np.arange(toy.family.n_kinds), toy.family.noise_start)
    assert found.total(toy.sizes) == pytest.approx(direct(toy, problem, (), toy.sizes, found), abs=0.35)


def test_the_evidence_of_a_function_is_that_of_plain_sums():
    toy = LinearToy(n_series=1, n_times=24, n_components=2, n_causes=6)
    one = next(c for c in toy.causes if c.free)
    problem = toy.problem(toy.drawn(np.random.default_rng(3))[1])
    found = SetModel(problem, [one], toy.family).evidence(
        np.arange(toy.family.n_kinds), toy.family.noise_start
    )
    alone = SetModel(problem, (), toy.family).evidence(np.arange(toy.family.n_kinds), toy.family.noise_start)
    gained = found.total(toy.sizes) - alone.total(toy.sizes)
    beside = direct(toy, problem, [one], toy.sizes, found) - direct(toy, problem, (), toy.sizes, alone)
    assert gained == pytest.approx(beside, abs=0.35)


def test_values_of_a_function_that_do_nearly_the_same_are_weighed_without_rounding():
    """Large smooth columns, of which ten are told by few: beside sums over the logarithm of the noise."""
    toy, rng = LinearToy(n_series=1, n_times=64), np.random.default_rng(4)
    f, n = toy.family, len(toy.jacobian)
    at, knots = np.linspace(0.0, 1.0, n)[:, None], np.linspace(0.0, 1.0, 10)
    columns = 30.0 * RANGE * np.exp(-0.5 * ((at - knots) / 0.4) ** 2)
    function = Cause("curve", "c0", columns, free=True)
    noise = 3e-5 * RANGE
    residual = toy.jacobian @ rng.standard_normal(toy.jacobian.shape[1]) + columns @ rng.normal(0.0, 0.5, 10)
    problem = toy.problem(residual + noise * rng.standard_normal(n))
    found = SetModel(problem, [function], f).given(np.array([0]), np.log([noise]))
    assert math.exp(found.log_noise[0, 0]) == pytest.approx(noise, rel=0.3)
    scales, masses = _combinations((True,))
    x = math.log(noise) + np.linspace(-1.0, 1.0, 81)
    gains = [[exact_normal(problem, function, s[0], math.exp(one)) for s in scales] for one in x]
    each = logsumexp(np.array(gains) + masses, axis=1) + norm.logpdf(x, f.noise_centre[0], NOISE_SPREAD)
    assert found.log_z[0] == pytest.approx(logsumexp(each) + math.log(x[1] - x[0]), abs=0.2)


@pytest.mark.parametrize("start", [-3.5, -9.2])
def test_weights_that_do_nearly_the_same_do_not_hold_the_noise_at_its_least(start):
    """The inverse of their information has no correct figure where the noise is tiny."""
    toy, rng = LinearToy(n_series=1, n_times=64), np.random.default_rng(4)
    f, n = toy.family, len(toy.jacobian)
    at, knots = np.linspace(0.0, 1.0, n)[:, None], np.linspace(0.0, 1.0, 20)
    causes = [
        Cause(f"curve {i}", f"c{i}", 30.0 * RANGE * np.exp(-0.5 * ((at - knots) / w) ** 2), free=True)
        for i, w in enumerate((0.40, 0.41, 0.42))
    ]
    noise = 3e-3 * RANGE
    problem = toy.problem(noise * rng.standard_normal(n))
    found = SetModel(problem, causes, f).given(np.array([0]), np.array([start]))
    assert math.exp(found.log_noise[0, 0]) == pytest.approx(noise, rel=0.3)
    scales, masses = _combinations((True,) * 3)
    x = math.log(noise) + np.linspace(-1.0, 1.0, 41)
    scaled = [np.concatenate([k * c.columns for k, c in zip(s, causes, strict=True)], axis=1) for s in scales]
    together = [Cause("all", "c0", columns, free=True) for columns in scaled]
    gains = [[exact_normal(problem, one, 1.0, math.exp(at)) for one in together] for at in x]
    each = logsumexp(np.array(gains) + masses, axis=1) + norm.logpdf(x, f.noise_centre[0], NOISE_SPREAD)
    assert found.log_z[0] == pytest.approx(logsumexp(each) + math.log(x[1] - x[0]), abs=0.3)


@pytest.mark.parametrize(("last", "slope"), [(-50.0, -2e3), (-50.0, -30.0), (50.0, 2e3)])
def test_interpolation_stays_between_its_ends_where_one_slope_is_zero(last, slope):
    found = hermite(np.array([0.0, 1.0]), np.array([[0.0, last]]), np.array([[0.0, slope]]))
    assert np.all(np.diff(found[0]) * np.sign(last) >= 0.0)


def exact_normal(problem: Problem, function: Cause, s: float, noise: float) -> float:
    """log N(r; 0, V + J P^-1 J' + s^2 R R') by an orthogonal factorisation of the stacked equations."""
    A = np.concatenate([problem.jacobian, function.columns], axis=1) / noise
    k, p = problem.jacobian.shape[1], A.shape[1]
    prior = np.zeros((p, p))
    prior[:k, :k] = np.linalg.cholesky(problem.P).T
    prior[k:, k:] = np.eye(p - k) / s
    Q, R = np.linalg.qr(np.concatenate([A, prior]))
    white = np.concatenate([problem.residual / noise, np.zeros(p)])
    left = white - Q @ (Q.T @ white)
    logdet = 2.0 * np.sum(np.log(np.abs(np.diag(R)) / np.append(np.diag(prior)[:k], np.full(p - k, 1.0 / s))))
    n = len(problem.residual)
    return float(-0.5 * left @ left - 0.5 * logdet - n * math.log(noise * math.sqrt(2.0 * math.pi)))


@pytest.mark.parametrize("white", [0.1, 1e-5], ids=["free", "least"])
def test_the_noise_is_integrated_where_weights_are_many(white):
    """Beside quadrature over its logarithm: 20 weights of a small function take up a third of the record."""
    toy, rng = LinearToy(), np.random.default_rng(2)
    f, n = toy.family, len(toy.jacobian)
    function = Cause("w", "c0", rng.standard_normal((n, 20)) * 0.3, free=True)
    residual = toy.jacobian @ rng.standard_normal(3) + white * rng.standard_normal(n)
    first = 1 + len(f.colours)
    errors = np.array([0, 5, *range(first, first + len(SIZES))])
    x = np.linspace(f.least_noise[0], f.noise_centre[0] + NOISE_SPREAD, 1001)
    log_w = norm.logpdf(x, f.noise_centre[0], NOISE_SPREAD) + math.log(x[1] - x[0])
    log_w[0] -= math.log(2.0)
    for causes in ((), (function,)):
        model = SetModel(toy.problem(residual), causes, f)
        found = model.evidence(np.arange(f.n_kinds), f.noise_start).log_z[errors]
        scales, masses = _combinations(tuple(one.free for one in causes))
        for error, log_z in zip(errors, found, strict=True):
            V = np.exp(2 * x)[:, None] * f.of(np.array([error]))[0][0] + f.of(np.array([error]))[1][0]
            gains = [marginal_normal(model.problem, causes, s, V) for s in scales]
            each = logsumexp(np.stack(gains, axis=1) + masses, axis=1) + log_w
            assert log_z == pytest.approx(logsumexp(each), abs=0.2), error


def test_the_slope_in_the_size_is_that_of_differences(toy):
    """With the noise known, larger ranges are larger discrepancies and nothing else."""
    problem = toy.problem(toy.drawn(np.random.default_rng(3))[1])
    kinds = np.arange(toy.family.n_kinds)
    h, found = 1e-4, []
    for range_ in (RANGE, RANGE * math.exp(-h), RANGE * math.exp(h)):
        family = replace(toy.family, ranges={"y": range_}, known={"y": 0.1})
        found.append(SetModel(problem, toy.causes[1:2], family).evidence(kinds, family.noise_start))
    assert found[0].slope == pytest.approx((found[2].log_z - found[1].log_z) / (2 * h), abs=1e-5)


def test_sets_beside_one_error_are_those_of_the_joint_normal_distribution(toy):
    listed = [i for i, one in enumerate(toy.causes) if not one.free and math.isinf(one.low)]
    free = [i for i, one in enumerate(toy.causes) if one.free]
    problem = toy.problem(toy.drawn(np.random.default_rng(5))[1])
    V = np.full(len(problem.residual), 0.5**2)
    reference = Reference(problem, toy.causes, V)
    first, second = listed[0], listed[1]
    alone = reference.further((), ())[0][first]
    both = alone + reference.further((first,), (1.0,))[0][second]
    nothing = marginal_normal(problem, (), (), V)
    pair = marginal_normal(problem, [toy.causes[first], toy.causes[second]], (1.0, 1.0), V)
    assert both == pytest.approx(pair - nothing, rel=1e-8)
    gained, scale = (x[free[0]] for x in reference.further((first,), (1.0,)))
    values = np.linspace(0.01, 5.0, 800)
    each = [marginal_normal(problem, [toy.causes[first], toy.causes[free[0]]], (1.0, s), V) for s in values]
    one = marginal_normal(problem, [toy.causes[first]], (1.0,), V)
    direct_gain = (
        logsumexp(np.array(each) + norm.logpdf(values) + math.log(2 * (values[1] - values[0]))) - one
    )
    assert gained == pytest.approx(direct_gain, abs=0.1)
    assert scale == pytest.approx(values[np.argmax(np.array(each) - 0.5 * values**2)], rel=0.6)


def test_a_bounded_amplitude_has_the_mass_inside(toy):
    i = next(i for i, one in enumerate(toy.causes) if one.low == 0.0)
    problem = toy.problem(toy.drawn(np.random.default_rng(6))[1])
    V = np.full(len(problem.residual), 0.3**2)
    values = np.linspace(0.0, 4.0, 4001)
    each = [
        marginal_normal(
            replace(problem, residual=problem.residual - toy.causes[i].columns[:, 0] * w), (), (), V
        )
        for w in values
    ]
    prior = norm.logpdf(values) - math.log(norm.cdf(4) - 0.5)
    expected = logsumexp(np.array(each) + prior + math.log(1e-3)) - marginal_normal(problem, (), (), V)
    assert Reference(problem, toy.causes, V).further((), ())[0][i] == pytest.approx(expected, abs=0.01)


def test_a_bounded_parameter_that_the_data_do_not_tell_changes_no_evidence(toy):
    """Of density exp(-d) above 0, its response far below the noise: unbounded it would be a million away."""
    problem = toy.problem(toy.drawn(np.random.default_rng(6))[1])
    k, kinds = problem.jacobian.shape[1], np.arange(toy.family.n_kinds)
    column = 1e-5 * np.random.default_rng(1).standard_normal((len(problem.residual), 1))
    beside = replace(
        problem,
        jacobian=np.concatenate([problem.jacobian, column], axis=1),
        precision=np.pad(problem.P, (0, 1)),
        pull=np.append(problem.pull, 1.0),
        low=np.append(np.full(k, -np.inf), 0.0),
        high=np.full(k + 1, np.inf),
    )
    alone, found = (
        SetModel(one, (), toy.family).given(kinds, toy.family.noise_start) for one in (problem, beside)
    )
    np.testing.assert_allclose(found.log_z, alone.log_z, atol=0.01)


def test_amplitudes_that_were_there_may_leave_their_bounds_when_a_cause_is_added(toy):
    """Two alike responses, of which the second makes the first negative; masses are those of each alone."""
    i, j = (k for k, one in enumerate(toy.causes[:9]) if one.low == 0.0 and k in (0, 3))
    rng = np.random.default_rng(8)
    first = toy.causes[i]
    beside = replace(toy.causes[j], columns=first.columns + 0.3 * toy.causes[j].columns)
    residual = (
        1.5 * beside.columns[:, 0] - 0.8 * first.columns[:, 0] + 0.3 * rng.standard_normal(len(first.columns))
    )
    problem, V = toy.problem(residual), np.full(len(residual), 0.3**2)
    reference = Reference(problem, [first, beside], V)
    found = reference.further((), ())[0][0] + reference.further((0,), (1.0,))[0][1]
    expected = marginal_normal(problem, (first, beside), (1.0, 1.0), V) - marginal_normal(problem, (), (), V)
    A = np.concatenate([problem.jacobian, first.columns, beside.columns], axis=1)
    P = np.zeros((A.shape[1],) * 2)
    P[:-2, :-2], P[-2:, -2:] = problem.P, np.eye(2)
    C = np.linalg.inv((A.T / V) @ A + P)
    mean = C @ ((A.T / V) @ residual - np.append(problem.pull, [0.0, 0.0]))
    assert mean[-2] < 0.0 < mean[-1]
    for m, sd in zip(mean[-2:], np.sqrt(np.diag(C))[-2:], strict=True):
        expected += norm.logcdf(m / sd) - math.log(0.5)
    assert found == pytest.approx(expected, abs=1e-3)


def with_a_cause(toy: LinearToy, i: int, noise: float = 0.1) -> np.ndarray:
    rng = np.random.default_rng(2)
    return 2.0 * toy.causes[i].columns[:, 0] + noise * rng.standard_normal(len(toy.jacobian))


def test_a_cause_that_is_there_is_found_and_a_probability_is_a_sum(toy):
    found = weigh_causes(toy.problem(with_a_cause(toy, 4)), toy.causes, toy.family)
    assert found.components["c4"] > 0.99
    assert next(iter(found.probability)) == (4,)
    log = np.array([row.log_prior + row.evidence.total(found.sizes) for row in found.rows])
    guesses = np.array(list(found.guessed.values()))
    total = logsumexp(np.concatenate([log, guesses]))
    for name in found.priors.names:
        inside = [any(found.causes[i].component == name for i in row.which) for row in found.rows]
        guessed = [any(found.causes[i].component == name for i in which) for which in found.guessed]
        expected = np.exp(log - total)[inside].sum() + np.exp(guesses - total)[guessed].sum()
        assert found.components[name] == pytest.approx(expected, rel=1e-9, abs=1e-300)
    assert found.number.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("change", ["given twice", "renamed", "other unit"])
def test_totals_of_components_do_not_change(toy, change):
    residual = with_a_cause(toy, 4)
    before = weigh_causes(toy.problem(residual), toy.causes, toy.family)
    causes, problem, family = list(toy.causes), toy.problem(residual), toy.family
    if change == "given twice":
        causes = without_doubles([*causes, replace(causes[4], name="again")])
        assert len(causes) == len(toy.causes)
    elif change == "renamed":
        causes[4] = replace(causes[4], name="z")
    else:
        causes = [replace(one, columns=7.5 * one.columns) for one in causes]
        family = replace(family, ranges={"y": 7.5 * RANGE})
        problem = replace(problem, residual=7.5 * residual, jacobian=7.5 * problem.jacobian)
    after = weigh_causes(problem, causes, family)
    assert after.components == pytest.approx(before.components, rel=1e-5, abs=1e-8)


@pytest.mark.parametrize("coloured", [False, True])
def test_noise_alone_is_no_gap(toy, coloured):
    rng = np.random.default_rng(8)
    kind = 1 + toy.family.colours.index((1.0, 0.03))
    V = 0.1**2 * toy.family.of(np.array([kind]))[0][0] if coloured else 0.1**2
    residual = np.sqrt(V) * rng.standard_normal(len(toy.jacobian))
    found = weigh_causes(toy.problem(residual), toy.causes, toy.family)
    assert max(found.components.values()) < 0.2
    assert found.no_gap(0.01, 1e-3) > 0.4


def test_prior_probabilities_sum_to_one_and_give_a_component_its_odds(toy):
    sets = {(): toy.priors.log_prior(())}
    order = list(range(len(toy.causes)))
    for size in range(1, 5):
        for which in combinations(order, size):
            if len({toy.causes[i].component for i in which}) == size:
                sets[which] = toy.priors.log_prior(which)
    assert logsumexp(list(sets.values())) == pytest.approx(0.0, abs=1e-9)
    own = sum(math.exp(x) for w, x in sets.items() if any(toy.causes[i].component == "c2" for i in w))
    assert own == pytest.approx(toy.priors.inclusion()["c2"], rel=1e-9)
    assert own == pytest.approx(1 / 11, rel=0.01)


def test_responses_that_do_not_fit_are_named(toy):
    with pytest.raises(CauseError, match=r"odd: columns: 3 coefficients, the data have 32"):
        weigh_causes(toy.problem(with_a_cause(toy, 4)), [Cause("odd", "c0", np.ones((3, 1)))], toy.family)
    with pytest.raises(CauseError, match=r"odd: bounds \[1, 1\]: low must be below high"):
        Cause("odd", "c0", np.ones((3, 1)), low=1.0, high=1.0)


def test_other_odds_need_no_new_evidence(toy):
    found = weigh_causes(toy.problem(with_a_cause(toy, 4, noise=1.0)), toy.causes, toy.family)
    doubled = found.under(odds=0.2)
    first = next(w for w in found.probability if len(w) == 1)
    ratio = [p.probability[first] / p.probability[()] for p in (found, doubled)]
    assert ratio[1] == pytest.approx(2.0 * ratio[0])
    assert CausePriors(toy.causes, odds=0.2).log_prior(first) == pytest.approx(
        doubled.priors.log_prior(first)
    )


def scaled(one: Cause, factor: float) -> Cause:
    """The same cause with a prior sd times a factor."""
    return replace(one, columns=factor * one.columns, low=one.low / factor, high=one.high / factor)


@pytest.mark.parametrize("power", [0.5, 0.125])
def test_a_power_of_the_likelihood_is_that_of_plain_sums(toy, power):
    problem, f, effect = toy.problem(with_a_cause(toy, 1, noise=0.5)), toy.family, toy.causes[1]
    assert math.isinf(effect.low)
    x = f.noise_centre[0] + NOISE_SPREAD * np.linspace(-3.4, 3.5, 700)
    log_w = norm.logpdf((x - f.noise_centre[0]) / NOISE_SPREAD) + math.log((x[1] - x[0]) / NOISE_SPREAD)
    n = len(problem.residual)
    for causes in ((), (effect,)):
        terms = []
        for log_noise, w in zip(x, log_w, strict=True):
            V = np.full(n, math.exp(2 * log_noise))
            tempered = marginal_normal(problem, causes, [1.0] * len(causes), V / power)
            # N(r; A w, V)^power = N(r; A w, V / power) times this
            constant = 0.5 * (1 - power) * np.sum(np.log(2 * math.pi * V)) - 0.5 * n * math.log(power)
            terms.append(tempered + w + constant)
        model = SetModel(problem, causes, f)
        found = model.given(np.arange(f.n_kinds), f.noise_start, power).log_z[0]
        assert found == pytest.approx(logsumexp(terms), abs=0.15)


def no_set_is_right(toy: LinearToy) -> np.ndarray:
    """A response that no cause has, at a noise of a ten-thousandth of the range."""
    rng = np.random.default_rng(0)
    weights = rng.standard_normal((1, toy.n_series, len(toy.waves))) / 5
    residual = toy.errors.flat(weights @ toy.waves).T[:, 0]
    return np.asarray(residual + 1e-3 * rng.standard_normal(len(residual)))


def test_the_mass_inside_bounds_is_that_of_a_normal_distribution() -> None:
    """Of coordinates that are correlated, one of them far outside: beside SciPy's integral, and draws."""
    sd, rho = np.array([0.05, 0.5, 1.0]), np.array([[1.0, 0.7, -0.5], [0.7, 1.0, 0.0], [-0.5, 0.0, 1.0]])
    mean, C = np.array([1.1, 0.1, -0.4]), rho * np.outer(sd, sd)
    low, high, at = np.array([-np.inf, 0.0]), np.array([1.0, np.inf]), np.array([0, 1])
    log_mass, m, lost = truncate(mean[None], C[None, :, at], at, low, high)
    V = C - lost @ lost.swapaxes(1, 2)
    exact = multivariate_normal(mean[:2], C[:2, :2]).cdf([1.0, np.inf], lower_limit=[-np.inf, 0.0])
    assert log_mass[0] == pytest.approx(math.log(exact), abs=0.1)
    alone = log_normal_mass((low - mean[:2]) / sd[:2], (high - mean[:2]) / sd[:2])
    assert abs(np.sum(alone) - math.log(exact)) > 0.7  # as if they were independent
    draws = np.random.default_rng(1).multivariate_normal(mean, C, 2_000_000)
    inside = draws[(draws[:, 0] < 1.0) & (draws[:, 1] > 0.0)]
    np.testing.assert_allclose(m[0], inside.mean(axis=0), atol=0.1 * sd.max())
    np.testing.assert_allclose(np.sqrt(np.diag(V[0]))[1:], inside.std(axis=0)[1:], rtol=0.1)


def test_certainty_about_a_set_that_is_wrong_is_undone_where_less_is_believed():
    toy = LinearToy()
    found = weigh_causes(toy.problem(no_set_is_right(toy)), toy.causes, toy.family)
    table = found.coarsening((1.0, 0.03))
    assert table.drop(columns="nothing").max(axis=1).tolist() == [
        pytest.approx(1.0, abs=0.01),
        pytest.approx(0.15, abs=0.15),
    ]
    prior = found.coarsened(1e-6)
    assert prior.components == pytest.approx(toy.priors.inclusion(), abs=0.06)


def test_what_solves_gained_is_coarsened_in_proportion(toy):
    found = weigh_causes(toy.problem(with_a_cause(toy, 4, noise=1.0)), toy.causes, toy.family)
    first, *others = found.rows
    raised = replace(first, evidence=replace(first.evidence, log_z=first.evidence.log_z + 3.0))
    shifted = replace(found, rows=(raised, *(replace(row, shift=2.0) for row in others)))
    a, b = found.coarsened(0.5).log_joint, shifted.coarsened(0.5).log_joint
    assert b[first.which] - a[first.which] == pytest.approx(1.5)
    assert b[others[0].which] - a[others[0].which] == pytest.approx(1.0)


def test_a_guess_moves_as_the_weighed_set_most_like_it(toy):
    found = weigh_causes(toy.problem(with_a_cause(toy, 4, noise=1.0)), toy.causes, toy.family)
    guessed = next(row for row in found.rows if len(row.which) == 1)
    rows = tuple(row for row in found.rows if row is not guessed)
    less = replace(found, rows=rows, guessed={guessed.which: found.log_joint[guessed.which]})
    i = guessed.which[0]
    sort = toy.causes[i].component, toy.causes[i].free
    more = [row.which for row in rows if i in row.which]
    alike = [w for w in [row.which for row in rows if len(row.which) == 1]
             if (toy.causes[w[0]].component, toy.causes[w[0]].free) == sort]  # fmt: skip
    expected = min(more, key=len) if more else (alike or [()])[0]
    sizes = replace(toy.sizes, effects=0.5, functions=0.5, unexplained=0.2)
    after = less.under(sizes, odds=0.2)
    moved = [after.log_joint[w] - after.priors.log_prior(w) - less.log_joint[w] + less.priors.log_prior(w)
             for w in (guessed.which, expected)]  # fmt: skip
    assert moved[0] == pytest.approx(moved[1])
    assert moved[0] != pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_other_sizes_of_causes_are_those_of_new_evidence(toy, factor):
    problem = toy.problem(with_a_cause(toy, 0, noise=1.0))
    effects, function = [toy.causes[0], toy.causes[1]], toy.causes[-1]  # the first is bounded
    assert effects[0].low == 0.0
    assert function.free
    kinds = np.arange(toy.family.n_kinds)

    def evidence(problem, causes, signal=None):
        return SetModel(problem, causes, toy.family).evidence(kinds, toy.family.noise_start, signal)

    stated = evidence(problem, [*effects, function])
    larger = [scaled(one, factor) for one in effects], scaled(function, factor)
    cases = {
        "effects": evidence(problem, [*larger[0], function]),
        "functions": evidence(problem, [*effects, larger[1]]),
    }
    for name, new in cases.items():
        sizes, new = replace(toy.sizes, **{name: factor}), replace(new, signal=stated.signal)
        assert stated.total(sizes) == pytest.approx(
            new.total(toy.sizes), abs=0.03 if name == "effects" else 0.1
        )
    # an amplitude among the parameters, as around a set's own mode
    k, w = problem.jacobian.shape[1], 0.7
    J = np.concatenate([problem.jacobian, effects[0].columns], axis=1)
    around = replace(
        problem, residual=problem.residual - w * effects[0].columns[:, 0], jacobian=J,
        precision=np.ones(k + 1),
        pull=np.append(np.zeros(k), w), low=np.append(np.full(k, -np.inf), -w),
        high=np.append(np.full(k, np.inf), 4.0 - w), amplitudes=(k,),
    )  # fmt: skip
    sizes = replace(toy.sizes, effects=factor)
    signal = lambda V: w * effects[0].columns[:, 0]  # noqa: E731
    inside, beside = evidence(around, [function], signal), evidence(problem, [effects[0], function], signal)
    assert inside.total(sizes) - inside.total(toy.sizes) == pytest.approx(
        beside.total(sizes) - beside.total(toy.sizes), abs=1e-6
    )


def test_causes_are_as_probable_as_they_are_frequent():
    """Calibration under the prior of all: sets, sizes and errors; `benchmarks/causes.py` has more."""
    toy = LinearToy(n_times=16, n_causes=10, n_components=5)
    rng = np.random.default_rng(11)
    stated, true = [], []
    for _ in range(40):
        which, residual = toy.drawn(rng)
        found = weigh_causes(toy.problem(residual), toy.causes, toy.family, priors=toy.priors, cores=1)
        p = found.included(lambda one: one.name)
        stated.append([p.get(one.name, 0.0) for one in toy.causes])
        true.append([i in which for i in range(len(toy.causes))])
    p, there = np.array(stated), np.array(true, dtype=float)
    sd = math.sqrt(float(np.sum(p * (1 - p))))
    assert abs(p.sum() - there.sum()) < 3.5 * sd
    high = p > 0.5
    assert abs(p[high].sum() - there[high].sum()) < 3.5 * math.sqrt(float(np.sum((p * (1 - p))[high])) + 0.05)
    score = np.mean(there * np.log(np.maximum(p, 1e-300)) + (1 - there) * np.log(np.maximum(1 - p, 1e-300)))
    rate = there.mean()
    assert score > rate * math.log(rate) + (1 - rate) * math.log(1 - rate) + 0.05


@pytest.mark.parametrize("between", [0.25, 0.5])
def test_likely_errors_are_those_drawn_where_no_size_of_the_grid_is_near(between):
    """Of 512 coefficients, so that the size is known to a few percent."""
    toy, rng = LinearToy(n_series=4, n_times=128), np.random.default_rng(5)
    f, size = toy.family, SIZES[7] ** (1 - between) * SIZES[8] ** between
    shared = max(range(len(f.shapes)), key=lambda i: f.shapes[i][2])  # by series, as no noise is
    V = 0.01**2 + size**2 * f.discrepancies[shared]
    residual = np.sqrt(V) * rng.standard_normal(len(V)) + toy.jacobian @ rng.standard_normal(3)
    one = SetModel(toy.problem(residual), (), f).evidence(np.arange(f.n_kinds), f.noise_start)
    loud = V > 10 * 0.01**2
    assert np.median(one.likely_variances(toy.sizes)[loud] / V[loud]) == pytest.approx(1.0, abs=0.2)
    noise = one.likely_variances(toy.sizes, alone=True)
    assert noise == pytest.approx(np.full(len(V), noise[0]))
    assert 0.003 < np.sqrt(noise[0]) < 0.05


def test_the_model_error_of_causes_has_their_power_by_harmonic(toy):
    """Whatever the phase of a harmonic and whichever difference of the series has it."""
    f, rng = toy.family, np.random.default_rng(2)
    signal = rng.standard_normal(toy.errors.size).reshape(toy.n_series, -1)
    signal[:, np.asarray(toy.errors.omega) > 2 * np.pi * 5.5] = 0.0
    own = f.beside(signal.reshape(-1)).own.reshape(signal.shape)
    assert own.mean() == pytest.approx(f.ranges["y"] ** 2)
    first = np.rint(np.asarray(toy.errors.omega) / (2 * np.pi)) == 1
    ratio = np.mean(signal[0, first] ** 2) / np.mean(signal**2)
    assert own[0, first] / own.mean() == pytest.approx(ratio)
    assert np.all(own[signal == 0.0] == 0.0)


def test_a_cause_that_is_not_quite_as_listed_calls_for_no_other(toy):
    """Its response is off by a tenth at a noise of a hundredth; `benchmarks/causes.py` has more."""
    rng = np.random.default_rng(7)
    others = []
    for k in (2, 5, 9, 12):
        signal = toy.causes[k].columns[:, 0] * 1.2
        beside = toy.responses(1, 1.0)[:, 0]
        signal = signal + 0.1 * np.linalg.norm(signal) / np.linalg.norm(beside) * beside
        noise = 0.01 * np.sqrt(np.mean(signal**2))
        found = weigh_causes(
            toy.problem(signal + noise * rng.standard_normal(len(signal))), toy.causes, toy.family
        ).components
        assert found.pop(toy.causes[k].component) > 0.9
        others.append(max(found.values()))
    assert sum(p > 0.5 for p in others) <= 1
