"""Kriging of coefficients: against fits without a point, draws of a process, its own graph."""

from __future__ import annotations

import numpy as np
import pytensor
import pytensor.tensor as pt
import pytest

import zoo.core.surrogate.kriging as kriging
from zoo.core.data import Data
from zoo.core.errors.independent import Independent
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.parameters import Parameter, Uniform
from zoo.core.surrogate.kriging import FewDirectionsError, Kriging
from zoo.core.surrogate.library import Library
from zoo.core.surrogate.waveform import Surrogate


def kriging_of(x, values):
    return Kriging.fit(x, values, np.zeros(x.shape[1]), np.eye(x.shape[1]))


def step(x):
    """No polynomial: a smooth step across a slanted line, and a plane."""
    return np.stack([np.tanh(2.0 * (x[:, 0] + 0.5 * x[:, 1])), x[:, 0] - x[:, 2]], axis=1)


@pytest.fixture(scope="module")
def fitted():
    x = np.random.default_rng(1).standard_normal((120, 3))
    return x, kriging_of(x, step(x))


def test_left_out_errors_are_those_of_fits_without_the_point(fitted):
    x, made = fitted
    for i in (0, 17, 119):
        others = np.delete(np.arange(len(x)), i)
        again = Kriging._of(
            made.centre, made.whitening, True, x[others], step(x[others]), made.length, made.nugget
        )
        np.testing.assert_allclose(
            made.residuals[i], step(x[i : i + 1])[0] - again(x[i : i + 1])[0], atol=1e-7
        )


def test_what_is_no_polynomial_is_nearer_to_a_process(fitted):
    x, made = fitted
    new = 0.8 * np.random.default_rng(2).standard_normal((300, 3))
    error = np.sqrt(np.mean(np.square(made(new) - step(new)).sum(1)))
    beta = np.linalg.lstsq(kriging.trend(x, True), step(x))[0]
    other = np.sqrt(np.mean(np.square(kriging.trend(new, True) @ beta - step(new)).sum(1)))
    assert error < 0.6 * other


def test_a_quadratic_is_found_again_and_a_plane_where_points_are_few():
    rng = np.random.default_rng(1)
    x, new = rng.standard_normal((60, 3)), 3.0 * rng.standard_normal((50, 3))

    def truth(x):
        return np.stack([1 + x[:, 0] - 2 * x[:, 1] * x[:, 2], 3 * x[:, 0] ** 2 - x[:, 2]], axis=1)

    centre, cholesky = np.array([0.3, -0.2, 0.1]), np.linalg.cholesky(np.eye(3) + 0.5)
    np.testing.assert_allclose(Kriging.fit(x, truth(x), centre, cholesky)(new), truth(new), atol=1e-4)
    assert Kriging.fit(x, truth(x), centre, cholesky).quadratic
    assert not Kriging.fit(x[:19], truth(x[:19]), centre, cholesky).quadratic


def test_its_graph_is_its_array_and_the_gradient_that_of_differences(fitted):
    x, made = fitted
    v = pt.dvector()
    some = made.symbolic(v)
    function = pytensor.function([v], [some, pytensor.grad(some[0], v)])
    for at in (np.array([0.3, -0.2, 0.9]), x[5]):
        values, slope = function(at)
        np.testing.assert_allclose(values, made(at[None])[0], rtol=1e-8, atol=1e-8)
        h = 1e-5 * np.eye(3)
        np.testing.assert_allclose(slope, (made(at + h) - made(at - h))[:, 0] / 2e-5, atol=1e-5)


def test_a_function_with_noise_is_not_drawn_through_it():
    rng = np.random.default_rng(4)
    x = rng.standard_normal((200, 2))
    clean = np.tanh(2.0 * x[:, :1])
    noisy = clean + 0.05 * rng.standard_normal((200, 1))
    made = kriging_of(x, noisy)
    assert made.nugget > min(kriging.NUGGETS)
    assert np.sqrt(np.mean((made(x) - clean) ** 2)) < 0.04


def test_of_more_points_than_are_allowed_as_many_are_taken_evenly(monkeypatch):
    monkeypatch.setattr(kriging, "MOST_POINTS", 60)
    x = np.random.default_rng(5).standard_normal((300, 2))
    made = kriging_of(x, step(np.pad(x, ((0, 0), (0, 1)))))
    assert len(made.points) == len(made.residuals) == 60
    np.testing.assert_allclose(made.points, x[np.linspace(0, 299, 60).round().astype(int)])


def test_points_in_too_few_directions_are_refused():
    x = np.random.default_rng(8).standard_normal((30, 1)) * np.ones((1, 2))
    with pytest.raises(FewDirectionsError, match="30 points are too near to each other, or in less than 2"):
        kriging_of(x, x)


def test_a_point_that_was_solved_twice_counts_once():
    times = np.linspace(0.0, 1.0, 20)

    def series(configuration, times):
        return np.tanh(8.0 * (configuration["rate"] - 1.0)) * times

    rate = Parameter("rate", Uniform(0.1, 3.0), start=1.0, power=1.0)
    library = Library(FunctionModel(series, (rate,), Outputs(("y0",), times), name="steep"))
    theta = np.random.default_rng(6).uniform(0.2, 2.5, (60, 1))
    for _ in range(2):
        library.add(theta, library.solve(theta))
    errors = Independent(Uniform(0.001, 0.01)).bind(Data(times, np.zeros(20), units=["mmHg"]))
    surrogate = Surrogate.fit(library, errors, {"sigma2": 0.05**2})
    assert len(surrogate.map.residuals) == 60
    new = np.array([[0.93], [2.1]])
    np.testing.assert_allclose(surrogate.series(new), library.solve(new), atol=0.01)
