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
from zoo.core.surrogate.coordinates import Coordinates
from zoo.core.surrogate.kriging import Kriging, matern
from zoo.core.surrogate.library import Library
from zoo.core.surrogate.polynomial import Polynomial
from zoo.core.surrogate.waveform import Surrogate

LINE = Parameter("x", Uniform(-5.0, 5.0))


def beneath(x, values):
    return Polynomial.fit(x, values, np.zeros(x.shape[1]), np.eye(x.shape[1]))


def step(x):
    """No polynomial: a smooth step across a slanted line, and a plane."""
    return np.stack([np.tanh(2.0 * (x[:, 0] + 0.5 * x[:, 1])), x[:, 0] - x[:, 2]], axis=1)


@pytest.fixture(scope="module")
def fitted():
    x = np.random.default_rng(1).standard_normal((120, 3))
    return x, Kriging.beside(beneath(x, step(x)), x, step(x))


def test_left_out_errors_are_those_of_fits_without_the_point(fitted):
    x, made = fitted
    for i in (0, 17, 119):
        others = np.delete(np.arange(len(x)), i)
        again = Kriging._of(made, made.terms, made.points[others], step(x[others]), made.length, made.nugget)
        np.testing.assert_allclose(
            made.residuals[i], step(x[i : i + 1])[0] - again(x[i : i + 1])[0], atol=1e-7
        )


def test_what_is_no_polynomial_is_nearer_to_a_process(fitted):
    x, made = fitted
    new = 0.8 * np.random.default_rng(2).standard_normal((300, 3))
    error = np.sqrt(np.mean(np.square(made(new) - step(new)).sum(1)))
    other = np.sqrt(np.mean(np.square(beneath(x, step(x))(new) - step(new)).sum(1)))
    assert error < 0.6 * other


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


def test_the_variance_is_that_of_draws_of_a_process():
    """Errors at new points, over the sd that is told, of functions drawn from a process of one length."""
    rng = np.random.default_rng(3)
    x = rng.standard_normal((330, 2))
    distance = np.linalg.norm(x[:, None] - x[None], axis=-1)
    drawn = np.linalg.cholesky(matern(distance, 2.0) + 1e-8 * np.eye(330)) @ rng.standard_normal((330, 40))
    made = Kriging.beside(beneath(x[:80], drawn[:80]), x[:80], drawn[:80])
    assert made.length in (1.0, 2.0, 4.0)
    told = np.sqrt((1.0 + made.leverage(x[80:])) * made.left_out)
    found = np.linalg.norm(made(x[80:]) - drawn[80:], axis=1)
    assert 0.6 < np.sqrt(np.mean((found / told) ** 2)) < 1.5
    far = np.array([[30.0, 30.0]])
    assert np.sqrt((1.0 + made.leverage(far))[0] * made.left_out) > 30 * np.median(told)
    assert made.leverage(2 * far) > 8 * made.leverage(far)  # by the trend, whose weights are not known


@pytest.mark.parametrize("degree", [None, 2])
def test_the_least_known_points_are_where_nothing_was_solved(degree):
    """Each given those before: not two beside each other, none of those that were solved since."""
    x = np.random.default_rng(7).uniform(-1.0, 0.0, (40, 1))
    values = np.sin(3.0 * x) if degree is None else x**degree
    map_ = beneath(x, values) if degree else Kriging.beside(beneath(x, values), x, values)
    surrogate = Surrogate(
        Coordinates((LINE,)), np.zeros((1, 2)), np.zeros((1, 1, 2)), map_, np.eye(1), 0, 1, 1
    )
    there = np.linspace(-1.0, 3.0, 41)[:, None]
    chosen = surrogate.least_known(there, 4)
    assert chosen[0] == 40
    assert len(set(chosen)) == 4
    if degree is None:  # a polynomial of so few terms is known once its ends are
        assert np.diff(np.sort(there[chosen, 0])).min() > 0.3
        assert there[chosen, 0].min() > 0.0
    again = surrogate.least_known(there, 4, [40, 20])
    assert not {20, 40} & set(again)
    assert abs(there[again[0], 0] - 3.0) > 0.3 or degree
    assert len(surrogate.least_known(there[:3], 9, [1])) == 2


def test_a_function_with_noise_is_not_drawn_through_it():
    rng = np.random.default_rng(4)
    x = rng.standard_normal((200, 2))
    clean = np.tanh(2.0 * x[:, :1])
    noisy = clean + 0.05 * rng.standard_normal((200, 1))
    made = Kriging.beside(beneath(x, noisy), x, noisy)
    assert made.nugget > min(kriging.NUGGETS)
    assert np.sqrt(np.mean((made(x) - clean) ** 2)) < 0.04


def test_of_more_points_than_are_allowed_as_many_are_taken_evenly(monkeypatch):
    monkeypatch.setattr(kriging, "MOST_POINTS", 60)
    x = np.random.default_rng(5).standard_normal((300, 2))
    made = Kriging.beside(beneath(x, step(np.pad(x, ((0, 0), (0, 1))))), x, step(np.pad(x, ((0, 0), (0, 1)))))
    assert len(made.points) == len(made.residuals) == 60
    v, some = (x - made.centre) @ made.rotation.T, np.linspace(0, 299, 60).round().astype(int)
    np.testing.assert_allclose(made.points, v[some])


def test_points_in_too_few_directions_leave_the_polynomial():
    x = np.random.default_rng(8).standard_normal((30, 1)) * np.ones((1, 2))
    assert Kriging.beside(beneath(x, x), x, x) is None


@pytest.mark.parametrize(("steep", "expected"), [(False, Polynomial), (True, Kriging)])
def test_a_surrogate_takes_which_is_nearer_at_points_left_out(steep, expected):
    times = np.linspace(0.0, 1.0, 20)

    def series(configuration, times):
        rate = configuration["rate"]
        return (np.tanh(8.0 * (rate - 1.0)) if steep else rate**2) * times

    rate = Parameter("rate", Uniform(0.1, 3.0), start=1.0, power=1.0)
    library = Library(FunctionModel(series, (rate,), Outputs(("y0",), times), name=expected.__name__))
    theta = np.random.default_rng(6).uniform(0.2, 2.5, (60, 1))
    library.add(theta, library.solve(theta))
    errors = Independent(Uniform(0.001, 0.01)).bind(Data(times, np.zeros(20), units=["mmHg"]))
    surrogate = Surrogate.fit(library, errors, {"sigma2": 0.05**2})
    assert isinstance(surrogate.map, expected)
    library.add(theta, library.solve(theta))
    again = Surrogate.fit(library, errors, {"sigma2": 0.05**2})
    assert len(again.map.residuals) == 60  # a point that was solved twice tells nothing of the error
    new = library.solve(np.array([[0.93], [2.1]]))
    np.testing.assert_allclose(surrogate.series(np.array([[0.93], [2.1]])), new, atol=0.01)
