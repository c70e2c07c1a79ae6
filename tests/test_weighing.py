"""What explanations weigh: priors over places and sizes, what is visible, what the prior alone makes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from zoo.core.data import Data
from zoo.core.diagnosis import diagnose
from zoo.core.diagnosis.answer import FitDiscrepancy
from zoo.core.diagnosis.hypothesis import CORRELATED, NONPARAMETRIC, NULL
from zoo.core.diagnosis.scoring import prior_shares, score
from zoo.core.diagnosis.screening import PRIOR_NONPARAMETRIC, Screening
from zoo.core.effects import Effect, EffectParameter, Location, effect
from zoo.core.errors.spectral import Harmonics
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.parameters import Normal, Parameter

N, NOISE = 64, 0.05
TIMES = np.arange(N) / N
PARTS = ("one", "two", "three", "four", "five")


def solve(configuration, times):  # type: ignore[no-untyped-def]
    """level sin(2 pi t), and a part of each higher harmonic."""
    more = sum(
        size * np.cos(2 * np.pi * (k + 2) * times) for k, size in enumerate(configuration.get("parts", ()))
    )
    return (configuration["level"] * np.sin(2 * np.pi * times) + more)[None]


MODEL = FunctionModel(solve, (Parameter("level", Normal(1.0, 1.0)),), Outputs(("y",), TIMES), "toy")


def data_of(values: np.ndarray, noise: float = NOISE, seed: int = 1) -> Data:
    noisy = values + noise * np.random.default_rng(seed).standard_normal(N)
    return Data(TIMES, noisy[None], labels=["y"], units=["K"], groups=["y"], period=1.0, name="toy")


def somewhere(n: int) -> Effect:
    """A part of one harmonic, which of n is its place."""

    @effect(
        "somewhere",
        parameters=[EffectParameter("size", "K", 0.3, -2.0, 2.0, (0.2, -0.2))],
        locations=lambda model: tuple(Location(part, noun="part") for part in PARTS[:n]),
    )
    def made(configuration, values, location):  # type: ignore[no-untyped-def]
        """One harmonic more."""
        parts = [values[0] * (location.part == part) for part in PARTS[:n]]
        return {**configuration, "parts": parts}

    return made


def test_places_share_the_prior_of_an_effect() -> None:
    """That four more places could be, where nothing is, costs log 5 of log evidence."""
    data = data_of(solve({"level": 1.0, "parts": [0.3]}, TIMES)[0])
    found = [score(Screening(data, MODEL, [somewhere(n)], errors=Harmonics()).run()) for n in (1, 5)]
    assert found[0].log_z[NULL] == pytest.approx(found[1].log_z[NULL], abs=0.05)
    assert found[0].log_z["somewhere"] - found[1].log_z["somewhere"] == pytest.approx(math.log(5), abs=0.05)
    assert found[1].locations["somewhere"][0][1] > 0.99


@pytest.mark.parametrize(("ratio", "visible"), [(1.2, False), (8.0, True), (40.0, True)])
def test_an_effect_is_visible_where_it_would_be_noticed(ratio: float, visible: bool) -> None:
    """Twice its prior's scale raises the log-likelihood by this much; the data do not ask for it."""
    scale = 0.5 * math.sqrt(2.0 * ratio / (0.5 * N)) * NOISE  # ratio = (2 scale)^2 N/2/(2 noise^2)
    small = replace(
        somewhere(1),
        name="small",
        parameters=(EffectParameter("size", "K", scale, -50 * scale, 50 * scale, (scale, -scale)),),
    )
    found = score(
        Screening(data_of(solve({"level": 1.0}, TIMES)[0]), MODEL, [small], errors=Harmonics()).run()
    )
    assert ("small" not in found.invisible) is visible
    assert (found.probability["small"] > 0.0) is visible


def discrepancy(rms: float, unabsorbed: float, seed: int = 1) -> FitDiscrepancy:
    rng = np.random.default_rng(seed)
    draws = (x * (1 + 0.02 * rng.standard_normal((400, 2))) for x in (rms, unabsorbed))
    return FitDiscrepancy(np.zeros((2, 3)), np.zeros((2, 3)), *draws, np.zeros((2, 3)))


@pytest.mark.parametrize("unabsorbed", [0.1, 0.3, 0.4])
def test_an_interval_holds_its_estimate(unabsorbed: float) -> None:
    """Also where a fit without noise, weighted by correlated noise, leaves more than this one."""
    found = discrepancy(0.3, unabsorbed)
    size = found.interval([0, 1])
    assert size.low < size.mean < size.high
    assert size.low == pytest.approx(min(0.3, unabsorbed), rel=0.05)
    assert size.high == pytest.approx(0.3, rel=0.05)
    removed = found.removed([0, 1], discrepancy(1.0, 1.0, seed=2))
    assert removed.low < removed.mean < removed.high


def test_what_the_prior_alone_makes_of_equal_evidence() -> None:
    half = math.log(0.5)
    prior = {"a": 0.1, "b": 0.1 / 7.5, "c": 0.4, "far": 0.4}
    kinds = {
        "a": [(0.0, 100.0)],
        "b": [(half, 100.2), (half, 60.0)],
        "c": [(0.0, 98.0)],
        "far": [(0.0, 50.0)],
    }
    found = prior_shares(prior, kinds)
    assert found["a"] == pytest.approx(15 / 16)
    assert found["b"] == pytest.approx(1 / 16)
    assert found["c"] is None  # two units of log evidence behind: the data have spoken
    assert found["far"] is None


def test_a_probability_that_the_prior_made_is_said_first() -> None:
    """In one series a smooth discrepancy and smooth correlated noise are the same, and the prior decides."""
    smooth = 0.4 * np.exp(-0.5 * ((TIMES - 0.4) / 0.05) ** 2)
    found = diagnose(data_of(solve({"level": 1.0}, TIMES)[0] + smooth, 0.01), MODEL, [somewhere(1)])
    first, second = found.file.hypotheses[:2]
    assert (first.name, second.name) == (NONPARAMETRIC, CORRELATED)
    listed = (
        1.0 - 0.5 - PRIOR_NONPARAMETRIC
    ) / 2  # correlated noise and one effect, half of the first smooth
    assert first.prior_probability == pytest.approx(0.1 / (0.1 + 0.5 * listed))
    assert first.probability == pytest.approx(first.prior_probability, abs=0.01)
    assert first.prior_made
    assert second.prior_made
    said = f"{first.probability:.0%} is the prior's own 1/2; none of the listed effects"
    assert found.file.verdict.startswith(f"these data do not tell unlisted from correlated-noise: {said}")
    assert first.log10_bayes_factor_to_best == 0.0
    ahead = (first.log_evidence - second.log_evidence) / math.log(10.0)
    assert second.log10_bayes_factor_to_best == pytest.approx(-ahead)
    null = next(h for h in found.file.hypotheses if h.name == NULL)
    assert null.log10_bayes_factor == 0.0
    assert first.log10_bayes_factor == pytest.approx(
        (first.log_evidence - null.log_evidence) / math.log(10.0)
    )
    assert all(h.searched_twice for h in found.file.hypotheses)  # nothing listed leads


def test_what_the_data_told_is_not_the_priors() -> None:
    found = diagnose(data_of(solve({"level": 1.0, "parts": [0.3]}, TIMES)[0]), MODEL, [somewhere(1)])
    first = found.file.hypotheses[0]
    assert first.name == "somewhere"
    assert (first.prior_probability, first.prior_made) == (None, False)
    assert not found.file.verdict.startswith("these data do not tell")
