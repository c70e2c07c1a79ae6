"""Components weighed on simulators of a few lines, where the answer is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp

from toys import (
    EFFECTS,
    FUNCTIONS,
    KNOTS,
    LAW,
    MODEL,
    NOISE,
    OWN,
    PUSH,
    TIMES,
    TWIN,
    N,
    data_of,
    hooks,
    kick,
    of,
)  # fmt: skip
from zoo.core.diagnosis import Hooks, diagnose
from zoo.core.diagnosis.components.response import linearise
from zoo.core.diagnosis.components.weighing import SIZES, _taken, allowance, weigh
from zoo.core.diagnosis.screening import DELTA_GRID, Screening
from zoo.core.effects import Effect
from zoo.core.errors.spectral import GroupErrors, Harmonics


def test_the_evidence_is_that_of_a_normal_distribution_integrated_over_sizes_and_lengths() -> None:
    """r ~ N(J m, S + J P^-1 J' + s^2 X R X'), each cell by a dense covariance."""
    screening = Screening(data_of({"push": 0.1 * np.sin(4 * np.pi * TIMES)}), MODEL, [], errors=Harmonics())
    fit = screening.base.fit
    linear = linearise(screening, fit, [LAW], fit.errors)
    noise = {"y": GroupErrors(NOISE)}
    found = weigh(linear, linear.blocks[0], fit.forward, fit.u, noise, allowance({"y": 0.03}), turns=1)
    J, X = linear.jacobian, linear.blocks[0].columns
    prior_sd, centre = 0.3, (1.0 - fit.values[0])
    terms = []
    sizes = SIZES * np.exp(-0.5 * SIZES**2)
    factors = np.exp(-0.5 * DELTA_GRID**2)
    for factor, w in zip(DELTA_GRID, factors / factors.sum(), strict=True):
        beside = {"y": GroupErrors(NOISE, delta=factor * 0.03, length=screening.errors.typical_length)}
        S = np.diag(screening.errors.variances(beside)) + prior_sd**2 * J @ J.T
        for length in LAW.lengths:
            R = X @ LAW.correlation(length) @ X.T
            for size, v in zip(SIZES, sizes / sizes.sum(), strict=True):
                C = S + (0.2 * size) ** 2 * R
                r = linear.residual - J[:, 0] * centre
                dense = -0.5 * (r @ np.linalg.solve(C, r) + np.linalg.slogdet(2 * np.pi * C)[1])
                terms.append(np.log(w * v / len(LAW.lengths)) + dense)
    wanted = logsumexp(terms) + screening.errors.noise_log_prior(noise["y"])
    assert found.log_z == pytest.approx(wanted, abs=1e-4)


def test_a_function_that_the_parameters_absorb_does_not_make_noise() -> None:
    """What it and the parameters cannot be told by is taken from the noise once, and not by each."""
    screening = Screening(data_of({"push": 0.3 * np.sin(4 * np.pi * TIMES)}), MODEL, [], errors=Harmonics())
    fit = screening.base.fit
    linear = linearise(screening, fit, [PUSH], fit.errors)
    alike = replace(PUSH, size=5.0, lengths=())
    block = replace(linear.blocks[0], function=alike, columns=np.tile(linear.jacobian, (1, N)) / N)
    found = weigh(
        linear, block, fit.forward, fit.u, {"y": GroupErrors(NOISE)}, allowance({"y": 0.0}), turns=1
    )
    J, X = linear.jacobian, block.columns
    A = np.hstack([J, X @ alike.root(None)])
    S = screening.errors.variances(found.best.errors)
    prior = np.concatenate([np.atleast_1d(linear.precision), np.full(A.shape[1] - 1, found.best.sd**-2)])
    dense = np.diag(A @ np.linalg.inv(A.T @ (A / S[:, None]) + np.diag(prior)) @ A.T)
    np.testing.assert_allclose(_taken(linear, block, found.best), dense, atol=1e-9)
    alone = np.einsum("np,pq,nq->n", X, found.best.covariance, X)
    assert np.sum(alone) > 10 * np.sum(dense)
    again = weigh(
        linear, linear.blocks[0], fit.forward, fit.u, {"y": GroupErrors(NOISE)}, allowance({"y": 0.0})
    )
    assert again.noise["y"].noise == pytest.approx(NOISE, rel=0.25)


def test_a_free_function_that_was_added_is_found_with_a_band_that_covers_it() -> None:
    true = 0.25 * np.tanh(2.0 * KNOTS) * KNOTS - 0.1
    found = diagnose(data_of({"law": true}), MODEL, [kick], hooks=hooks(FUNCTIONS))
    assert found.cause == ["wall"]
    assert found.file.components[0].name == "wall"
    assert found.file.components[0].probability > 0.95
    assert found.file.components[0].refined
    assert "wall" in found.file.verdict
    law = found.file.components[0].functions[0]
    visited = (KNOTS > -0.9) & (KNOTS < 1.6)

    x = np.linspace(-0.9, 1.6, 50)
    assert np.abs(np.interp(x, KNOTS, law.mean) - np.interp(x, KNOTS, true)).max() < 0.1
    inside = []
    others = [diagnose(data_of({"law": true}, seed=s), MODEL, [kick], hooks=hooks(FUNCTIONS)) for s in (2, 3)]
    for one in (found, *others):
        band = one.file.components[0].functions[0]
        inside.append(((np.array(band.low) <= true) & (true <= np.array(band.high)))[visited])
    assert np.mean(inside) >= 0.85
    width = (np.array(law.high) - np.array(law.low)) / (2 * 1.96 * np.array(law.prior_sd))
    assert width[visited].min() < 0.5  # told by the data
    assert law.narrowed
    outside = KNOTS > 1.9  # nothing was measured there
    assert width[outside].min() > 3.0 * width[visited].min()
    assert found.file.gap.after < 0.2 * found.file.gap.before


def test_a_listed_effect_that_is_the_truth_still_leads() -> None:
    found = diagnose(data_of({"kick": 0.3}), MODEL, EFFECTS, hooks=hooks(FUNCTIONS))
    assert found.cause == ["kick"]
    leader = found.file.hypotheses[0]
    assert leader.probability > 0.9
    assert of(found, "inflow").probability > 0.95
    assert of(found, "inflow").nearest_effects[0].name == "kick"
    assert of(found, "inflow").nearest_effects[0].share > 0.8
    assert not any("together" in w for w in found.file.warnings)


def test_no_effect_that_leaves_a_third_of_the_gap_is_sure() -> None:
    """Two thirds of the discrepancy are the listed effect's, the rest is another harmonic's."""
    rest = 0.15 * np.cos(10 * np.pi * TIMES)
    for functions in (None, FUNCTIONS):
        given = Hooks() if functions is None else hooks(functions)
        found = diagnose(data_of({"kick": 0.3, "push": rest}), MODEL, [kick], hooks=given, max_effects=1)
        told = next(h for h in found.file.hypotheses if h.name == "kick")
        assert told.gap_after > 0.3 * found.file.gap.before
        assert told.probability < 0.9
        if functions is None:
            assert told.and_more > 0.9
            assert found.cause[0] == "kick"
            assert "something else" in found.file.verdict
            total = sum(h.probability + (h.and_more or 0.0) for h in found.file.hypotheses)
            assert total == pytest.approx(1.0)


def test_components_with_the_same_responses_are_one_group() -> None:
    push = 0.15 * np.exp(-0.5 * ((TIMES - 0.6) / 0.06) ** 2)
    found = diagnose(data_of({"push": push}), MODEL, [], hooks=hooks([LAW, PUSH, TWIN, OWN]))
    assert set(found.cause) == {"inflow", "outlets"}
    assert of(found, "inflow").group == of(found, "outlets").group == 0
    assert of(found, "wall").group != 0
    assert of(found, "sensor").group != 0  # it would be seen by one sensor only
    assert of(found, "inflow").angles["outlets"][1] == pytest.approx(0.0, abs=1.0)
    assert of(found, "inflow").angles["sensor"][1] > 20.0
    assert of(found, "inflow").probability == pytest.approx(of(found, "outlets").probability, abs=0.02)


def test_without_a_gap_there_is_no_component() -> None:
    found = diagnose(data_of({}), MODEL, EFFECTS, hooks=hooks(FUNCTIONS))
    assert found.cause == ["no-gap"]
    assert max(c.probability for c in found.file.components) < 0.2
    total = sum(c.probability for c in found.file.components)
    others = [h for h in found.file.hypotheses if h.name in ("no-gap", "correlated-noise")]
    assert total + sum(h.probability for h in others) == pytest.approx(1.0)


def test_an_effect_of_the_other_sign_is_named_as_such() -> None:
    """The law is bent downwards; the catalogue has it bent upwards only."""
    found = diagnose(data_of({"law": -0.12 * KNOTS**2}), MODEL, EFFECTS, hooks=hooks(FUNCTIONS))
    assert found.cause == ["wall"]
    near = {n.name: n for n in of(found, "wall").nearest_effects}
    assert near["bulge"].opposite_sign
    assert near["bulge"].share > 0.8


def test_what_is_larger_than_expected_is_called_implausible() -> None:
    small = replace(LAW, size=0.02, why="laws are known to 0.02 K")
    true = 0.25 * np.tanh(2.0 * KNOTS) * KNOTS - 0.1
    found = diagnose(data_of({"law": true}), MODEL, [], hooks=hooks([small, PUSH, OWN]))
    told = of(found, "wall").plausible
    assert not told.value
    assert "laws are known to 0.02 K" in told.why
    assert of(found, "inflow").plausible.value == (of(found, "inflow").functions[0].size < 1.0)


def test_a_component_with_the_name_of_an_effect_is_refused() -> None:
    clash = Effect("wall", kick.parameters, kick.apply)
    with pytest.raises(ValueError, match="component wall"):
        diagnose(data_of({}), MODEL, [clash], hooks=hooks(FUNCTIONS))
