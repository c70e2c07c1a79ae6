"""Several listed effects at once: dense densities, a pair that explains only together, the other sign."""

from __future__ import annotations

import math
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from zoo.core.data import Data
from zoo.core.diagnosis import diagnose
from zoo.core.diagnosis.components.subsets import (
    Several,
    _Linear,
    several_effects,
    signatures_of,
    weigh_subsets,
)
from zoo.core.diagnosis.screening import DELTA_GRID, Screened, Screening
from zoo.core.effects import Effect, EffectParameter, Location, effect
from zoo.core.errors.spectral import Harmonics
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.parameters import Normal, Parameter

N, NOISE = 64, 0.01
TIMES = np.arange(N) / N
PARTS = ("one", "two", "three")


def wave(k: int, phase: float = 0.0) -> np.ndarray:
    return np.cos(2 * np.pi * k * TIMES + phase)


def solve(configuration, times):  # type: ignore[no-untyped-def]
    return (configuration["level"] * wave(1) + configuration.get("more", 0.0))[None]


MODEL = FunctionModel(solve, (Parameter("level", Normal(3.0, 1.0)),), Outputs(("y",), TIMES), "toy")


def adds(name: str, signature, *, low: float = -5.0, high: float = 5.0, places=None) -> Effect:  # type: ignore[no-untyped-def]
    """An effect that adds its size times a wave, which may depend on its place."""
    starts = (0.2,) if low >= 0.0 else (-0.2,) if high <= 0.0 else (0.2, -0.2)
    where = {} if places is None else {"locations": lambda model: tuple(Location(p) for p in places)}

    @effect(name, parameters=[EffectParameter("size", "K", 1.0, low, high, starts)], **where)
    def made(configuration, values, location):  # type: ignore[no-untyped-def]
        """A wave more."""
        drawn = signature if places is None else signature[location.part]
        return {**configuration, "more": configuration.get("more", 0.0) + values[0] * drawn}

    return made


def data_of(more: np.ndarray, seed: int = 1) -> Data:
    noisy = solve({"level": 3.0, "more": more}, TIMES) + NOISE * np.random.default_rng(seed).standard_normal(
        N
    )
    return Data(TIMES, noisy, labels=["y"], units=["K"], period=1.0, name="toy")


ASKED = 0.5 * wave(3) + 0.4 * wave(5, 1.0)
HIDDEN = 3.0 * wave(7, 0.3) + 2.0 * wave(1)  # part of which the level can draw
CATALOGUE = [
    # each alone makes what the data do not have, both together what they have
    adds("first", ASKED + HIDDEN, low=0.0),
    adds("second", -HIDDEN, low=0.0),
    adds("decoy", wave(3), low=0.0),
    adds("other", {p: wave(9 + i) + 0.7 * wave(1) for i, p in enumerate(PARTS)}, places=PARTS),
]


@cache
def screened(sign: float = 1.0) -> Screened:
    return Screening(data_of(sign * 0.8 * ASKED), MODEL, CATALOGUE, errors=Harmonics()).run()


@cache
def several() -> Several:
    return several_effects(screened())


def test_of_subsets_the_evidence_is_that_of_dense_normal_densities() -> None:
    """Of two-sided effects, whose posteriors are far inside their bounds; over the grid of the allowance."""
    found = screened()
    wide = [s for s in signatures_of(found) if s.name == "other"]
    linear = _Linear(found, wide)
    screening, base = found.screening, found.screening.base.fit
    _, precision, pull = base.forward.prior(base.u)
    assert pull == pytest.approx(0.0, abs=30.0)
    J, r = base.jacobian, base.residual
    weights = np.exp(-0.5 * DELTA_GRID**2)
    for subset in [(), *combinations(range(3), 2)]:
        total, nothing = 0.0, 0.0
        for factor, weight in zip(DELTA_GRID, weights / weights.sum(), strict=True):
            S = screening.beside(found.noise, {q: factor * x for q, x in found.allowances.items()})
            V = np.diag(S) + J @ J.T / precision[0]
            mean = -J @ (pull / precision)
            at = [multivariate_normal.logpdf(r, mean, V)]
            for i in subset:
                V = V + np.outer(wide[i].change, wide[i].change)
            at.append(multivariate_normal.logpdf(r, mean, V))
            nothing += weight * math.exp(at[0] - 150.0)
            total += weight * math.exp(at[1] - 150.0)
        if subset:
            # a normal prior of sd 1 within 5 has all but 6e-7 of its mass there
            assert linear.log_z(np.array([subset]))[0] == pytest.approx(math.log(total / nothing), abs=1e-4)


def test_two_that_only_together_explain_are_found_where_one_after_the_other_fails() -> None:
    d = diagnose(data_of(0.8 * ASKED), MODEL, CATALOGUE, max_effects=3)
    added = {step.name for step in d.file.steps} | {d.file.cause[0]}
    assert not {"first", "second"} <= added
    assert any("together are more probable than any effect alone" in w for w in d.file.warnings)
    found = several()
    assert set(found.names) == {"first", "second"}
    assert found.gain > 5.0
    assert found.log_bayes_factor > found.gain  # the second effect has to pay
    fit = found.fits[0]
    sizes = fit.values[1:]
    np.testing.assert_allclose(sizes, 0.8, atol=0.02)
    assert math.sqrt(np.mean(fit.residual**2)) < 1.3 * NOISE
    assert found.subsets.leader == ("first", "second")
    assert found.subsets.over_single > 5.0


def test_the_probability_that_an_effect_is_there_is_that_of_the_sets_it_is_in() -> None:
    found = several().subsets
    assert sum(found.probability.values()) == pytest.approx(1.0)
    assert found.inclusion["first"] > 0.9
    assert found.inclusion["second"] > 0.9
    assert found.inclusion["other"] < 0.1
    # sets of one to four of four effects, one of which has three places
    singles, places = 3, 3
    wanted = sum(math.comb(singles, k) + places * math.comb(singles, k - 1) for k in (1, 2, 3, 4))
    assert found.weighed == wanted


def test_a_further_effect_pays_its_prior_odds() -> None:
    cheap, dear = (weigh_subsets(screened(), price=p) for p in (0.5, 0.5e-3))
    pair = ("first", "second")

    def odds(found) -> float:  # type: ignore[no-untyped-def]
        return math.log(found.probability[pair] / found.probability[("decoy",)])

    assert odds(cheap) - odds(dear) == pytest.approx(math.log(1e3))


def test_without_a_gap_no_effect_is_there() -> None:
    none = Screening(data_of(np.zeros(N)), MODEL, CATALOGUE, errors=Harmonics()).run()
    found = several_effects(none)
    assert found.subsets.leader == ()
    assert max(found.subsets.inclusion.values()) < 0.3
    assert found.names == ()


def test_the_sign_that_an_effect_cannot_have_is_asked_too() -> None:
    """Of the decoy, which may only add, in data from which its wave was taken away."""
    wrong, right = (weigh_subsets(screened(sign)) for sign in (-1.0, 1.0))
    assert wrong.opposite_sign("decoy")
    assert not right.opposite_sign("decoy")
    both = Screening(data_of(0.8 * ASKED), MODEL, [adds("both", wave(3))], errors=Harmonics()).run()
    assert not weigh_subsets(both).opposite_sign("both")  # it may have either
    assert wrong.leader == ()
    assert wrong.inclusion["decoy"] < 0.01
    assert right.probability[("decoy",)] > 1e3 * right.probability[()]
