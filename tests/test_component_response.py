"""Responses of a simulator to free functions, against derivatives that are known."""

from __future__ import annotations

import numpy as np
import pytest

from zoo.core.components import FreeFunction
from zoo.core.data import Data
from zoo.core.diagnosis.components.response import linearise
from zoo.core.diagnosis.screening import Screening
from zoo.core.errors.spectral import Harmonics
from zoo.core.forward import FunctionModel, Outputs, SolveError
from zoo.core.parameters import Normal, Parameter

N, NOISE = 64, 0.02
TIMES = np.arange(N) / N
KNOTS = np.linspace(-2.0, 2.0, 17)


def state(configuration, times):  # type: ignore[no-untyped-def]
    return configuration["level"] * np.sin(2 * np.pi * times)


def solve(configuration, times):  # type: ignore[no-untyped-def]
    """y = x + law(x) + push(t) + bend push^2, x = level sin(2 pi t)."""
    x = state(configuration, times)
    y = x + np.interp(x, KNOTS, configuration.get("law", np.zeros(len(KNOTS))))
    push = configuration.get("push", np.zeros(N))
    if np.abs(push).max() > configuration.get("most", 10.0):
        raise SolveError("pushed too hard")
    return (y + push + configuration.get("bend", 0.0) * push**2)[None]


MODEL = FunctionModel(solve, (Parameter("level", Normal(1.0, 1.0)),), Outputs(("y",), TIMES), "toy")
LAW = FreeFunction("law", "wall", KNOTS, 0.2, lambda c, v: {**c, "law": v}, lengths=(0.5, 1.0))
PUSH = FreeFunction(
    "push", "inflow", TIMES, 0.3, lambda c, v: {**c, "push": v}, lengths=(0.1, 0.2), period=1.0
)
PLACES = FreeFunction(
    "places", "geometry", np.arange(4.0), 0.1, lambda c, v: {**c, "push": np.repeat(v, N // 4)}
)


def screening_of(values: np.ndarray, model: FunctionModel = MODEL, seed: int = 1) -> Screening:
    noisy = values + NOISE * np.random.default_rng(seed).standard_normal(values.shape)
    data = Data(TIMES, noisy, labels=["y"], units=["K"], groups=["y"], period=1.0, name="toy")
    return Screening(data, model, [], errors=Harmonics())


def linearised(functions, model=MODEL, **more):  # type: ignore[no-untyped-def]
    screening = screening_of(solve({"level": 1.2}, TIMES), model)
    fit = screening.base.fit
    return screening, fit, linearise(screening, fit, functions, fit.errors, **more)


def test_columns_are_the_derivatives_along_what_the_prior_allows() -> None:
    screening, fit, found = linearised([LAW, PUSH, PLACES])
    level = float(fit.values[0])
    x = level * np.sin(2 * np.pi * TIMES)
    hats = np.stack([np.interp(x, KNOTS, e) for e in np.eye(len(KNOTS))])
    exact = {"law": hats, "push": np.eye(N), "places": np.repeat(np.eye(4), N // 4, axis=1)}
    for name, series in exact.items():
        block = found.block(name)
        wanted = screening.errors.flat(series[:, None, :]).T
        root = block.function.root(block.function.lengths[-1] if block.function.lengths else None)
        size = np.abs(wanted @ root).max()
        np.testing.assert_allclose(block.columns @ root, wanted @ root, atol=5e-3 * size)
        assert block.bent < 1e-6
        assert block.failed == 0
    np.testing.assert_allclose(
        found.jacobian[:, 0], screening.errors.flat(np.sin(2 * np.pi * TIMES)[None]), atol=1e-6
    )
    np.testing.assert_allclose(found.residual, fit.residual)
    assert list(found.components) == ["wall", "inflow", "geometry"]


def test_what_is_not_straight_is_differenced_from_both_sides() -> None:
    bent = FreeFunction(
        "bent", "inflow", TIMES, 0.3, lambda c, v: {**c, "push": v + 8.0 * v**2}, lengths=(0.1,), period=1.0
    )
    screening, _, found = linearised([bent])
    root = bent.root(0.1)
    wanted = screening.errors.flat(root.T[:, None, :]).T
    np.testing.assert_allclose(found.blocks[0].columns @ root, wanted, atol=0.01 * np.abs(wanted).max())
    assert found.blocks[0].bent > 1.0


@pytest.mark.parametrize(("most", "failed"), [(0.004, 0), (1e-9, 4)])
def test_directions_that_cannot_be_solved_are_counted(most: float, failed: int) -> None:
    brittle = FreeFunction(
        "brittle", "geometry", np.arange(4.0), 0.1,
        lambda c, v: {**c, "push": np.repeat(v, N // 4), "most": most},
    )  # fmt: skip
    _, _, found = linearised([brittle])
    assert found.blocks[0].failed == failed
    assert np.all(found.blocks[0].columns == 0.0) == bool(failed)
