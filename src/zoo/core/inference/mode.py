"""The mode of a posterior without gradients, the Gaussian around it, and where chains start."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pymc as pm
from numpy.typing import ArrayLike
from pymc.blocking import DictToArrayBijection, RaveledVars
from pymc.pytensorf import floatX, join_nonshared_inputs

from zoo.core.inference.steps import T_DOF, Array, Gaussian, Point, compile_logp, counting_ops

LARGE = 100.0
"""Size of an unconstrained coordinate from which it is scaled for the search."""
MANY = 12
"""Dimensions above which the search for the mode uses the structure of zoo's models."""
STARTS = 16
"""Prior draws that the search starts from with many parameters; lesser modes are common there."""
FOLLOWED = 4
"""Different modes that are followed to their end."""
KICK = -2.3
"""What is added to one element of a vector in the unconstrained space to leave a lesser mode: a tenth."""


class SamplingError(RuntimeError):
    """Sampling cannot start or go on; its text says why and what to change."""


class LogPosterior:
    """Log-posterior of a model as a function of one unconstrained vector."""

    def __init__(self, model: Any) -> None:
        self.model = model
        self.variables = list(model.continuous_value_vars)
        if not self.variables:
            raise SamplingError(f"model {model_name(model)} has no continuous free variable to sample")
        if len(self.variables) != len(model.value_vars):
            names = [v.name for v in model.value_vars if v not in self.variables]
            raise SamplingError(f"variable {names[0]!r} is discrete: only continuous ones can be sampled")
        self.initial = model.initial_point()
        self.template = self._ravel(self.initial)
        self._function = compile_logp(model, self.variables, self.initial, {})
        self.ops = counting_ops(self._function)
        self.evaluations = 0

    def _ravel(self, point: Mapping[str, Any]) -> RaveledVars:
        return DictToArrayBijection.map({v.name: np.asarray(point[v.name]) for v in self.variables})

    def __call__(self, q: Array) -> float:
        self.evaluations += 1
        value = float(self._function(np.ascontiguousarray(q, dtype=self.template.data.dtype)))
        return value if np.isfinite(value) else -np.inf

    def vector(self, point: Mapping[str, Any]) -> Array:
        """Point of the model -> vector (n_dim,)."""
        return np.asarray(self._ravel(point).data, dtype=float)

    def point(self, q: Array) -> Point:
        """Vector (n_dim,) -> point of the model."""
        return dict(DictToArrayBijection.rmap(RaveledVars(floatX(q), self.template.point_map_info)))

    def from_values(self, values: Mapping[str, ArrayLike]) -> Array:
        """Values of free variables in their own units -> vector; others keep the initial value."""
        from pymc.initial_point import make_initial_point_fn

        known = {rv.name: rv for rv in self.model.free_RVs}
        for name in values:
            if name not in known:
                raise SamplingError(f"start: no variable {name!r} in the model; it has {', '.join(known)}")
        overrides = {}
        for name, value in values.items():
            array, rv = np.asarray(value, dtype=float), known[name]
            if array.ndim == 0 and rv.ndim > 0:  # one value for all elements
                array = np.full(rv.shape.eval(), float(array))
            overrides[rv] = array
        return self.vector(make_initial_point_fn(model=self.model, overrides=overrides)(0))

    def from_draws(self, draws: Mapping[str, ArrayLike]) -> Array:
        """Draws of every free variable in its own unit, name -> (n, ...), to vectors (n, n_dim)."""
        import pytensor

        inputs, outputs = [], []
        for rv in self.model.free_RVs:
            value = rv.type()
            transform = self.model.rvs_to_transforms[rv]
            inputs.append(value)
            outputs.append(value if transform is None else transform.forward(value, *rv.owner.inputs))
        function = pytensor.function(inputs, outputs)
        values = [self.model.rvs_to_values[rv].name for rv in self.model.free_RVs]
        columns = [np.asarray(draws[rv.name], dtype=float) for rv in self.model.free_RVs]
        rows = [
            self.vector(dict(zip(values, function(*row), strict=True))) for row in zip(*columns, strict=True)
        ]
        return np.array(rows)

    def to_values(self, q: Array) -> dict[str, np.ndarray]:
        """Vector (n_dim,) -> free variables in their own units."""
        names, function = outputs(self.model, [rv.name for rv in self.model.free_RVs])
        return dict(zip(names, function(self.point(q)), strict=True))


def outputs(model: Any, names: Sequence[str]) -> tuple[list[str], Any]:
    """Names and a function of a point: free variables in their own units, and deterministic ones."""
    graphs = {v.name: v for v in model.unobserved_value_vars}
    return list(names), model.compile_fn([graphs[name] for name in names], on_unused_input="ignore")


def model_name(model: Any) -> str:
    record = getattr(model, "zoo", None)
    return str(getattr(record, "name", "") or model.name or "without a name")


@dataclass(frozen=True)
class Mode:
    """Mode of a posterior in the unconstrained space, with the Gaussian that fits around it.

    Parameters
    ----------
    vector : array (n_dim,)
        The mode, unconstrained; the density includes the Jacobian of the transformations.
    values : dict
        The same point, each free variable in its own unit.
    logp : float
        Log-posterior density there.
    covariance : array (n_dim, n_dim)
        Inverse of the negative second derivatives, from differences over one to two standard deviations.
    evaluations : int
        Evaluations of the log-posterior that the search took.
    """

    vector: Array
    values: dict[str, np.ndarray]
    logp: float
    covariance: Array
    evaluations: int


def find_mode(
    model: Any,
    *,
    start: Mapping[str, ArrayLike] | None = None,
    max_evaluations: int | None = None,
    seed: int = 0,
) -> Mode:
    """Find the mode of a model's posterior without gradients, and the Gaussian around it.

    A derivative-free trust-region search (COBYQA) from the best of the model's initial point and its
    suggested values; if a model of zoo's has more than 12 parameters, Gauss-Newton steps from there and from
    16 draws of the prior, since such posteriors have lesser modes, the best 4 followed to their end, and from
    these ends with each element of a vector lowered in turn. Then Newton steps on a quadratic fitted over
    steps wide enough to lower the log-posterior by about one, so that rounding and the tolerance of a solver
    do not matter.

    Parameters
    ----------
    model : pymc.Model
        With continuous free variables only.
    start : mapping, optional
        Free variable -> value in its own unit, instead of the suggested values.
    max_evaluations : int, optional
        Limit of the trust-region search; 300 + 60 n_dim if absent.
    seed : int
        Of the random points that are tried if neither start has a finite log-posterior.

    Returns
    -------
    Mode

    Raises
    ------
    SamplingError
        If no point with a finite log-posterior is found, or `start` names an unknown variable.

    References
    ----------
    Ragonneau, Zhang: COBYQA, https://www.cobyqa.com (doi 10.5281/zenodo.10048050).
    """
    return search_mode(LogPosterior(model), start, max_evaluations, seed)


def search_mode(
    logp: LogPosterior,
    start: Mapping[str, ArrayLike] | None = None,
    max_evaluations: int | None = None,
    seed: int = 0,
) -> Mode:
    from scipy.optimize import minimize

    before = logp.evaluations
    q, best = _first_point(logp, start, seed)
    d = len(q)
    worst = [best]

    def cost(x: Array) -> float:
        value = logp(x)
        if not np.isfinite(value):
            return -worst[0] + 10.0 * (
                1.0 + abs(worst[0])
            )  # a wall, finite for the sake of the quadratic model
        worst[0] = min(worst[0], value)
        nonlocal q, best
        if value > best:
            q, best = np.array(x), value
        return -value

    limit = 300 + 60 * d if max_evaluations is None else max_evaluations
    frame = None
    if d > MANY and hasattr(getattr(logp.model, "zoo", None), "errors"):
        begin = [(q, best)] if start is not None else _prior_points(logp, q, seed)
        q, best, frame = _highest(logp, begin, limit)
    elif limit > 2 * d + 1:
        # variables without bounds are in their own units
        scale = np.where(np.abs(q) > LARGE, np.abs(q), 1.0)
        options = {"initial_tr_radius": 0.5, "final_tr_radius": 0.02, "maxfev": limit}
        minimize(lambda x: cost(x * scale), q / scale, method="COBYQA", options=options)
    q, best, covariance = newton(logp, q, best, passes=8 if d <= MANY else 3, frame=frame)
    return Mode(q, logp.to_values(q), best, covariance, logp.evaluations - before)


def _first_point(logp: LogPosterior, start: Mapping[str, ArrayLike] | None, seed: int) -> tuple[Array, float]:
    candidates = [logp.vector(logp.initial)]
    if start is not None:
        candidates = [logp.from_values(start)]
    else:
        suggested = _suggested(logp.model)
        if suggested:
            candidates.append(logp.from_values(suggested))
    values = [logp(q) for q in candidates]
    rng = np.random.default_rng(seed)
    tries = 0
    while not np.isfinite(max(values)):
        if tries == 300:
            raise SamplingError(
                f"model {model_name(logp.model)}: no point with a finite log-posterior among {len(values)} "
                "around the initial point; pass start={name: value} with values that the solver can solve"
            )
        tries += 1
        base = candidates[0]
        candidates.append(base + rng.uniform(-1, 1, len(base)) * (0.2 + 2.0 * tries / 300))
        values.append(logp(candidates[-1]))
    index = int(np.argmax(values))
    return candidates[index], values[index]


def _prior_points(logp: LogPosterior, q: Array, seed: int) -> list[tuple[Array, float]]:
    """q (n_dim,) and `STARTS` prior draws with its error parameters, each with its log-posterior."""
    model = logp.model
    values = logp.to_values(q)
    drawn = [rv for rv in model.free_RVs if rv.name not in model.zoo.error_parameters]
    n = 8 * STARTS
    draws = {name: np.broadcast_to(value, (n, *np.shape(value))) for name, value in values.items()}
    for rv, column in zip(drawn, pm.draw(drawn, draws=n, random_seed=seed), strict=True):
        draws[rv.name] = np.reshape(column, draws[rv.name].shape)
    found = [(q, logp(q))]
    with np.errstate(invalid="ignore"):
        points = logp.from_draws(draws)
    for point in points[np.isfinite(points).all(1)]:
        if len(found) > STARTS:
            break
        value = logp(point)
        if np.isfinite(value):
            found.append((point, value))
    return found


def _highest(
    logp: LogPosterior, begin: Sequence[tuple[Array, float]], limit: int
) -> tuple[Array, float, Array]:
    """The highest end of Gauss-Newton searches from several points, and from changes of their ends.

    All searches are begun; the best that lead to different modes are finished. Then each element of the
    vectors, such as a vessel's stiffness, is lowered to a tenth, and the search goes on from there; that is
    repeated at the highest end while it leads higher.
    """
    if len(begin) == 1:
        [(q, value)] = begin
        return gauss_newton(logp, q, value, limit=limit)
    short = [gauss_newton(logp, q, value, limit=limit // 3)[:2] for q, value in begin]
    ends = _different(logp, short, limit, FOLLOWED)
    elements = np.flatnonzero(
        np.concatenate(
            [
                np.full(np.size(logp.initial[v.name]), np.ndim(logp.initial[v.name]) > 0)
                for v in logp.variables
            ]
        )
    )
    best, changed = ends[0], ends
    while changed:
        lower = []
        for q, *_ in changed:
            for k in elements:
                moved = q.copy()
                moved[k] += KICK
                if np.isfinite(value := logp(moved)):
                    lower.append(gauss_newton(logp, moved, value, limit=limit // 8)[:2])
        found = _different(logp, lower, limit, 2) if lower else []
        changed = [end for end in found if end[1] > best[1] + 1.0][:1]
        best = max(best, *found, key=lambda end: end[1])
    return best


def _different(
    logp: LogPosterior, short: Sequence[tuple[Array, float]], limit: int, most: int
) -> list[tuple[Array, float, Array]]:
    """Ends of the best searches that lead to different modes, highest first."""
    ends: list[tuple[Array, float, Array]] = []
    for q, value in sorted(short, key=lambda end: -end[1])[: 2 * most]:
        end = gauss_newton(logp, q, value, limit=limit)
        if all(abs(end[1] - other[1]) > 1.0 for other in ends):
            ends.append(end)
        if len(ends) == most:
            break
    return sorted(ends, key=lambda end: -end[1])


def _suggested(model: Any) -> dict[str, Any]:
    """Suggested values that belong to free variables of the model."""
    record = getattr(model, "zoo", None)
    values = getattr(record, "suggested", None) or {}
    free = {rv.name for rv in model.free_RVs}
    return {name: value for name, value in dict(values).items() if name in free}


class _Residuals:
    """Whitened residuals, log-prior and error parameters of one of zoo's models."""

    def __init__(self, logp: LogPosterior) -> None:
        import pytensor

        model, record = logp.model, logp.model.zoo
        self.logp, self.record = logp, record
        outputs = model.replace_rvs_by_values(
            [record.mean, record.ok, *(model[name] for name in record.error_parameters)]
        )
        values, joined = join_nonshared_inputs(logp.initial, list(outputs), logp.variables, {})
        self._mean = pytensor.function([joined], values)
        prior = model.logp(vars=model.free_RVs)
        [prior], joined = join_nonshared_inputs(logp.initial, [prior], logp.variables, {})
        self._slope = pytensor.function([joined], pytensor.grad(prior, joined))
        errors = {model.rvs_to_values[model[name]].name for name in record.error_parameters}
        own = [np.full(np.size(logp.initial[v.name]), v.name in errors) for v in logp.variables]
        self.of_errors = np.concatenate(own)

    def mean(self, q: Array) -> tuple[Array | None, dict[str, Any]]:
        """The solver's series, None where it fails, and the error parameters."""
        self.logp.evaluations += 1
        mean, ok, *errors = self._mean(q)
        return (mean if ok else None), dict(zip(self.record.errors.parameter_names, errors, strict=True))

    def whiten(self, residuals: Array, errors: Mapping[str, Any]) -> Array | None:
        found: Array | None = self.record.errors.whiten(residuals, errors)
        return found

    def prior(self, q: Array) -> tuple[Array, Array]:
        """Gradient of the log-prior (n_dim,), and its negative second derivatives without negative ones."""
        slope, h = np.asarray(self._slope(q)), 1e-4
        columns = [(self._slope(q + h * e) - self._slope(q - h * e)) / (2 * h) for e in np.eye(len(q))]
        curvature = -np.array(columns)
        eigenvalues, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
        return slope, vectors @ (np.maximum(eigenvalues, 0.0)[:, None] * vectors.T)


def gauss_newton(
    logp: LogPosterior, q: Array, value: float, *, limit: int, step: float = 0.02
) -> tuple[Array, float, Array]:
    """Damped Gauss-Newton steps on the whitened residuals, for models with many parameters.

    With z the whitened residuals and J their derivatives by differences, the step solves
    (J'J + P + lambda D) s = -J'z + grad log p, P the curvature of the prior and D the diagonal. The
    parameters of the errors are moved in between, which needs no solve.

    Parameters
    ----------
    logp : LogPosterior
        Of a model with a record.
    q : array (n_dim,)
        Start, with log-posterior `value`.
    limit : int
        Solves after which no new step is begun.
    step : float
        Of the differences, in standard deviations of the prior: far above the solver's tolerance.

    Returns
    -------
    q : array (n_dim,)
    value : float
    frame : array (n_dim, n_dim)
        Columns: directions about a standard deviation long.
    """
    from scipy.optimize import minimize

    model = _Residuals(logp)
    data, before = logp.model.zoo.data.values, logp.evaluations
    theta, eta = np.flatnonzero(~model.of_errors), np.flatnonzero(model.of_errors)
    curvature = np.diag(model.prior(logp.vector(logp.initial))[1])
    scale = 1.0 / np.sqrt(np.where(curvature > 0, curvature, 1.0))  # prior standard deviations
    damping, frame = 1e-3, 0.1 * np.diag(scale)
    idle = 0
    while logp.evaluations - before < limit and idle < 3:
        first = value

        def cost(x: Array, q: Array = q) -> float:
            moved = q.copy()
            moved[eta] = x
            found = logp(moved)
            return -found if np.isfinite(found) else 1e300

        spent = logp.evaluations
        found = minimize(cost, q[eta], method="Nelder-Mead", options={"maxfev": 80, "xatol": 1e-2})
        logp.evaluations = spent  # the solver remembers the point
        if -found.fun > value:
            value, q = -float(found.fun), q.copy()
            q[eta] = found.x
        mean, errors = model.mean(q)
        if mean is None or (z := model.whiten(data - mean, errors)) is None:
            break
        columns = []
        for k in theta:
            for h in (step * scale[k], -step * scale[k]):
                moved = q.copy()
                moved[k] += h
                there, _ = model.mean(moved)
                if there is not None:
                    columns.append((mean - there) / h)
                    break
            else:
                columns.append(np.zeros_like(mean))
        whitened = model.whiten(np.array(columns), errors)
        if whitened is None:
            break
        J = whitened.reshape(len(theta), -1).T
        slope, curvature = model.prior(q)
        gradient = slope[theta] - J.T @ z.ravel()
        H = J.T @ J + curvature[np.ix_(theta, theta)]
        eigenvalues, vectors = np.linalg.eigh(H * np.outer(scale[theta], scale[theta]))
        axes = scale[theta, None] * vectors / np.sqrt(np.maximum(eigenvalues, 1e-2))
        frame[np.ix_(theta, theta)] = axes
        D = np.diag(np.maximum(np.diag(H), 1e-6 / scale[theta] ** 2))
        for _ in range(10):
            s = np.linalg.solve(H + damping * D, gradient)
            moved = q.copy()
            moved[theta] += s * min(1.0, 1.0 / float(np.max(np.abs(s / scale[theta]))))
            there_value = logp(moved)
            if there_value > value:
                q, value, damping = moved, there_value, max(damping / 5, 1e-9)
                break
            damping *= 4
        idle = idle + 1 if value - first < 0.02 else 0
    return q, value, frame


def newton(
    logp: Callable[[Array], float], q: Array, value: float, *, passes: int, frame: Array | None = None
) -> tuple[Array, float, Array]:
    """Newton steps on wide differences: mode (n_dim,), its log-posterior, covariance (n_dim, n_dim).

    Columns of `frame` are directions, each about a standard deviation long after the first pass.
    """
    d = len(q)
    frame = 0.1 * np.eye(d) if frame is None else frame
    for turn in range(passes):
        seen: list[tuple[float, Array]] = []

        def probe(x: Array, seen: list[tuple[float, Array]] = seen) -> float:
            result = logp(x)
            seen.append((result, x))
            return result

        gradient, precision, steps = _quadratic(probe, q, value, frame)
        scaled = precision * np.outer(steps, steps)
        eigenvalues, vectors = np.linalg.eigh(scaled)
        eigenvalues = np.abs(eigenvalues)
        eigenvalues = np.maximum(eigenvalues, max(0.02, 2e-5 * float(eigenvalues.max())))
        axes = frame @ (steps[:, None] * vectors) / np.sqrt(eigenvalues)
        slope = (vectors.T @ (gradient * steps)) / np.sqrt(eigenvalues)  # of the log-posterior along the axes
        gain = 0.5 * float(slope @ slope)
        length = float(np.linalg.norm(slope))
        move = axes @ (slope * min(1.0, 3.0 / length)) if length > 0 else np.zeros(d)
        new, new_value = q, value
        if gain > 0.02:
            for share in (1.0, 0.5, 0.25, 0.1):
                probe(q + share * move)
                if seen[-1][0] > value:
                    break
        top = max(seen, key=lambda item: item[0])
        if top[0] > value:
            new_value, new = top
        moved = new_value - value
        q, value, frame = new, new_value, axes
        if turn >= 1 and gain < 0.05 and moved < 0.05:
            break
    return q, value, frame @ frame.T


def _quadratic(
    logp: Callable[[Array], float], q: Array, value: float, frame: Array
) -> tuple[Array, Array, Array]:
    """Gradient (n_dim,), negative second derivatives (n_dim, n_dim) in the frame, and steps (n_dim,)."""
    d = len(q)
    steps = np.ones(d)
    up, down = np.empty(d), np.empty(d)
    for i in range(d):
        for _ in range(14):
            up[i] = logp(q + steps[i] * frame[:, i])
            down[i] = logp(q - steps[i] * frame[:, i])
            if not (np.isfinite(up[i]) and np.isfinite(down[i])):
                steps[i] *= 0.3
                continue
            size = max(
                abs(value - 0.5 * (up[i] + down[i])), 0.25 * abs(up[i] - value), 0.25 * abs(down[i] - value)
            )
            if 0.15 <= size <= 2.5 or (size < 0.15 and steps[i] > 100):
                break
            steps[i] *= float(np.clip(np.sqrt(0.6 / max(size, 1e-12)), 0.2, 5.0))
        else:
            up[i] = down[i] = value - 0.5  # nothing learnt in this direction: keep the last scale
    gradient = (up - down) / (2 * steps)
    precision = np.diag((2 * value - up - down) / steps**2)
    for i in range(d):
        for j in range(i):
            a, b = steps[i] * frame[:, i], steps[j] * frame[:, j]
            both = logp(q + a + b) + logp(q - a - b)
            cross = -(both - up[i] - down[i] - up[j] - down[j] + 2 * value) / (2 * steps[i] * steps[j])
            precision[i, j] = precision[j, i] = cross if np.isfinite(cross) else 0.0
    return gradient, precision, steps


@dataclass(frozen=True)
class Start:
    """Where chains begin: starts (n_chains, n_dim), the Gaussian, the first archive (n, n_dim), the mode."""

    starts: Array
    reference: Gaussian
    archive: Array
    mode: Mode


def disperse(logp: LogPosterior, mode: Mode, chains: int, seed: int) -> Start:
    """Starts from a t distribution twice as wide as the Gaussian at the mode, failed solves rejected."""
    d = len(mode.vector)
    reference = Gaussian(mode.vector, mode.covariance)
    starts = []
    for chain in range(chains):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(chain, 0)))
        for _ in range(20):
            u = 2.0 * rng.standard_normal(d) * np.sqrt(T_DOF / rng.chisquare(T_DOF))
            lowest = mode.logp - 10.0 * d - 2.0 * float(u @ u)
            for _ in range(12):
                q = reference.colour(u)
                if logp(q) >= lowest:
                    break
                u = 0.7 * u
            else:
                continue
            break
        else:
            q = mode.vector
        starts.append(q)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1 << 30,)))
    archive = reference.colour(rng.standard_normal((10 * d, d)))
    return Start(np.array(starts), reference, archive, mode)
