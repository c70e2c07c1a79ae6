"""The search for a mode: on data of the solver itself, and against differences."""

import contextlib
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from made import QUANTITY, SEARCH, THETA, baseline_of, made, search_model
from zoo import load_study
from zoo.blood.effects import CATALOGUE
from zoo.core.diagnosis.coordinates import SearchModel, coordinates
from zoo.core.diagnosis.search import Point, Search, SearchError
from zoo.core.effects import EVERYWHERE, Effect, EffectParameter
from zoo.core.errors.spectral import GroupErrors
from zoo.core.forward import Outputs
from zoo.core.parameters import InverseGamma, Normal, Parameter, Population, Uniform, log_prior

TRUE_VALUES = {
    "tangent-wall": (0.4,),
    "beat-jitter": (0.003,),
    "viscoelastic-wall": (0.0015,),
    "radius-dependent-stiffness": (1.0, 0.0164),
    "velocity-profile": (1.0,),
    "stenosis": (0.4,),
    "catheter-resonance": (0.012, 0.3),
    "side-branches": (0.3, 1.0),
    "structured-tree": (0.7,),
    "hydrostatic": (0.6,),
}


def true_values(effect: Effect) -> tuple[float, ...]:
    first = effect.parameters[0]
    return TRUE_VALUES.get(effect.name, (min(first.scale, 0.6 * first.high),))


HARDLY_SHOWN = {"radius-dependent-viscosity", "coarse-grid"}
"""Effects that move the demo study's waves by less than the errors of 0.01 mmHg that are assumed."""


def mode(search: Search, start: np.ndarray) -> Point:
    """Where a search from far away ends: with loose errors first, as a screening begins."""
    loose = Search(search.forward, search.data, 1e4 * search.S)
    point = search.resume(loose.descend(loose.at(start), 15, 1e-3))
    return search.refine(search.descend(point, 15, 1e-4), 6, 15, fine=True)


@pytest.mark.parametrize("name", [n for n, e in CATALOGUE.items() if e.apply is not None])
def test_effect_parameter_is_recovered_from_noise_free_data(name: str) -> None:
    """To 1 %, from the baseline's start and each of the effect's own, which know nothing of the truth."""
    baseline = baseline_of(load_study("demo"))
    effect = CATALOGUE[name].of(baseline)
    locations = effect.locations(baseline)
    location = locations[min(2, len(locations) - 1)]
    wanted = true_values(effect)
    study = made([(name, wanted, location)], noise=0.0)
    forward, base = search_model(study, ((name, location),)), search_model(study)
    S = forward.errors.variances({QUANTITY: GroupErrors(0.01)})
    data = forward.errors.flat(study.values)
    alone = mode(Search(base, data, S), base.start)
    if name in HARDLY_SHOWN:
        assert math.sqrt(float(np.mean((data - alone.computed) ** 2))) < 0.005
        return
    first, *shapes = effect.parameters
    starts = [np.array([*alone.u, a, *(p.centre for p in shapes)]) for a in first.starts]
    points = []
    for u in starts:
        with contextlib.suppress(SearchError):  # nothing solves there
            points.append(mode(Search(forward, data, S), u))
    found = min(points, key=lambda point: point.cost)
    assert forward.theta(found.u)[4] == pytest.approx(wanted[0], rel=0.01)


def test_search_stays_inside_the_bounds() -> None:
    study = made([])
    forward = search_model(study, (("beat-jitter", EVERYWHERE),))
    H = forward.errors
    search = Search(forward, H.flat(study.values), H.variances({QUANTITY: GroupErrors(0.05)}))
    start = [math.log(THETA[p]) for p in ("f3", "psi1", "psi2", "c")]
    point = search.descend(search.at(np.array([*start, 0.01])), 15)
    assert np.all(point.u >= forward.low)
    assert point.u[4] < 0.002


def test_a_step_to_a_bound_that_rounds_beyond_it_is_solved() -> None:
    """A conductance of -9e-21 is refused by the solver, and was 9 % of the solves of one diagnosis."""
    model = search_model(made([]), (("side-branches", EVERYWHERE),))
    u = model.start
    u[model.n_base] = -9e-21
    assert model(u) is not None
    np.testing.assert_array_equal(model(u), model(np.maximum(u, model.low)))


def test_a_search_without_a_solve_says_why() -> None:
    study = made([])
    forward = search_model(study, options=replace(SEARCH, max_beats=1))
    search = Search(forward, forward.errors.flat(study.values), np.ones(forward.errors.size))
    with pytest.raises(SearchError, match="periodic"):
        search.at(np.array([math.log(THETA[p]) for p in ("f3", "psi1", "psi2", "c")]))
    assert (forward.failures.total(), forward.solves) == (1, 1)


def test_priors_integrate_to_one_in_the_coordinates_of_a_search() -> None:
    """Each density over its bounds, in the parameter or in its logarithm."""
    for p in (
        Parameter("f3", Uniform(2e4, 1e5), log=True),
        Parameter("f2", Uniform(-3, 5)),
        Parameter("a", EffectParameter("a", "1", 0.7, 0.0, 2.0, (0.1,)).prior),
        Parameter("z", Normal(0.3, 0.2, 0.1, 1.5)),
        Parameter("v", InverseGamma(3, 7.78)),
    ):
        (c,) = coordinates([p])
        low, high = max(c.coordinate(c.low), -4.0), min(c.coordinate(c.high), 12.0)
        u = np.linspace(low, high, 20001)
        density = [math.exp(p.prior.log_density(c.value(x), {}) + (x if c.log else 0.0)) for x in u]
        assert np.trapezoid(density, u) == pytest.approx(1.0, rel=1e-4)


def bare(parameters: tuple[Parameter, ...]) -> SearchModel:
    outputs = Outputs(("y",), np.arange(8.0))
    model = SimpleNamespace(parameters=parameters, outputs=outputs, families=(), name="x")
    return SearchModel(model, (), None)  # type: ignore[arg-type]


def test_precision_and_pull_of_independent_priors_are_those_of_differences() -> None:
    """In the search's coordinates, of which some are logarithms; a density that is not concave has none."""
    parameters = (
        Parameter("v", InverseGamma(3, 7.78), log=True),
        Parameter("z", Normal(0.3, 0.2)),
        Parameter("k", Normal(2.0, 0.5), log=True),
    )
    forward = bare(parameters)
    u, h = np.array([math.log(2.5), 0.45, math.log(2.2)]), 1e-4
    precision, pull = forward.prior(u)
    for i, step in enumerate(h * np.eye(3)):
        below, at, above = (forward.log_prior(u + move) for move in (-step, 0.0 * step, step))
        assert pull[i] == pytest.approx(-(above - below) / (2 * h), rel=1e-5)
        assert precision[i] == pytest.approx(max(0.0, -(above - 2 * at + below) / h**2), rel=1e-4)
        assert precision[i] > 0.0


def test_slopes_and_curvatures_of_priors_are_those_of_differences() -> None:
    """Also of a population, whose density depends on its mean and variance."""
    parameters = (
        Parameter("m", Normal(6.0, 1.5)),
        Parameter("v", InverseGamma(3, 7.78), log=True),
        Parameter("chi", Population("m", "v", 2.0), dims="vessel", size=3, log=True),
        Parameter("psi", Uniform(0.05, 2.5), log=True),
    )
    forward = bare(parameters)
    u = np.array([6.5, math.log(2.0), math.log(8.0), math.log(6.0), math.log(7.0), math.log(0.4)])

    def value(u: np.ndarray) -> float:
        jacobian = float(np.sum(u[[1, 2, 3, 4, 5]]))
        return log_prior(parameters, forward.theta(u)) + jacobian

    total, (precision, pull) = forward.log_prior(u), forward.prior(u)
    assert total == pytest.approx(value(u), rel=1e-12)
    h, eye = 1e-4, np.eye(len(u))
    slope = [(value(u + h * e) - value(u - h * e)) / (2 * h) for e in eye]
    np.testing.assert_allclose(-pull, slope, rtol=1e-6, atol=1e-7)

    def mixed(a: np.ndarray, b: np.ndarray) -> float:
        both, one = h * (a + b), h * (a - b)
        return (value(u + both) - value(u + one) - value(u - one) + value(u - both)) / (4 * h * h)

    bend = -np.array([[mixed(a, b) for a in eye] for b in eye])
    assert np.linalg.eigvalsh(bend).min() > -1e-6  # where it is positive it is not changed
    np.testing.assert_allclose(precision, bend, rtol=1e-4, atol=1e-4)


def test_a_descent_inside_bounds_ends_at_their_least_squares() -> None:
    """Of linear problems with alike columns, beside scipy; one coordinate is held by equal bounds."""
    rng = np.random.default_rng(3)
    for _ in range(200):
        d = int(rng.integers(2, 6))
        A = rng.standard_normal((12, d)) @ (np.eye(d) + 2.0 * rng.standard_normal((d, d)))
        y = 3.0 * rng.standard_normal(12)
        low, high = -rng.uniform(0.1, 2.0, d), rng.uniform(0.1, 2.0, d)
        start = rng.uniform(low, high)
        low[0] = high[0] = start[0]
        forward = SimpleNamespace(
            low=low, high=high, units=np.ones(d), last_failure="",
            log_prior=lambda u: 0.0, prior=lambda u: (np.zeros(len(u)), np.zeros(len(u))),
        )  # fmt: skip
        linear = type("Linear", (SimpleNamespace,), {"__call__": lambda self, u, A=A: A @ u})(**vars(forward))
        search = Search(linear, y, np.ones(12))
        end = search.descend(search.at(start, A), 60, 1e-6)
        best = lsq_linear(A[:, 1:], y - A[:, 0] * start[0], (low[1:], high[1:]), tol=1e-12)
        assert end.u[0] == start[0]
        assert end.cost < best.cost + 0.05


class Helix:
    """Data tell at once that y = sin x and z = cos x, and only then what x is."""

    low, high, units, last_failure = np.full(3, -np.inf), np.full(3, np.inf), np.ones(3), ""
    data, start = np.array([2.0, 0.0, 0.0]), np.array([-1.0, np.sin(-1.0), np.cos(-1.0)])
    solves = 0

    def __call__(self, u: np.ndarray) -> np.ndarray:
        self.solves += 1
        x, y, z = u
        return np.array([x, 10.0 * (y - np.sin(x)), 10.0 * (z - np.cos(x))])

    def log_prior(self, u: np.ndarray) -> float:
        return -0.005 * float(u @ u)

    def prior(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.full(3, 0.01), 0.01 * u


def test_a_curved_valley_is_followed_with_no_more_solves_than_scipy_takes() -> None:
    forward, sd = Helix(), 0.1
    best = least_squares(
        lambda u: np.concatenate([(forward(u) - forward.data) / sd, 0.1 * u]), forward.start, method="lm"
    )
    taken, forward.solves = forward.solves, 0
    search = Search(forward, forward.data, np.full(3, sd**2))
    end = search.refine(search.at(forward.start), 6)
    assert end.cost == pytest.approx(best.cost, abs=0.02)
    assert forward.solves <= taken


def test_a_step_is_bent_along_a_curved_valley() -> None:
    """Straight steps leave the valley wherever they are long: 40 of them end 0.4 above the best cost."""
    forward = Helix()
    search = Search(forward, forward.data, np.full(3, 0.01))
    start = search.at(forward.start)
    assert search.descend(start, 40).cost == pytest.approx(search.refine(start, 6).cost, abs=0.02)
    forward.solves = 0
    search.descend(start, 40)
    assert forward.solves <= 20


def test_a_search_ends_with_derivatives_made_where_it_ends() -> None:
    """Secants of the way there are off by ten times as much."""
    forward = Helix()
    search = Search(forward, forward.data, np.full(3, 0.01))
    start = search.at(forward.start)
    for end, least, most in (search.refine(start, 2), 0.0, 0.2), (search.descend(start, 6), 7.0, 8.5):
        exact = 10.0 * np.array([-np.cos(end.u[0]), np.sin(end.u[0])])
        assert least <= np.max(np.abs(end.jacobian[1:, 0] - exact)) <= most
