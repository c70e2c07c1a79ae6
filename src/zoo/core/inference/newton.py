"""Ways uphill by differences: Gauss-Newton on whitened residuals, Newton on a fitted quadratic."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from pymc.pytensorf import join_nonshared_inputs

from zoo.core.arrays import Array
from zoo.core.derivatives import has_jacobian, jacobian
from zoo.core.forward import SolveError
from zoo.core.in_numba import with_memory
from zoo.core.inference.logposterior import LogPosterior

FOLLOWED = 6
"""Starts from which least squares are followed; a pulse wave has lesser fits, such as of stiff vessels."""
LARGE_NOISE = 0.03
"""Noise of least squares in parts of the range of a group's series, so that no misfit is absurd."""
STEP = 0.02
"""Of differences: far above a solver's tolerance."""
GRADIENT = 10
"""Solves that a solve with its derivatives counts as, measured with 24 of them."""


class Residuals:
    """Whitened residuals, log-prior and error parameters of one of zoo's models."""

    def __init__(self, logp: LogPosterior) -> None:
        import pytensor
        import pytensor.tensor as pt

        model, record = logp.model, logp.model.zoo
        self.logp, self.record = logp, record
        outputs = model.replace_rvs_by_values(
            [record.mean, record.ok, *(model[name] for name in record.error_parameters)]
        )
        values, joined = join_nonshared_inputs(logp.initial, list(outputs), logp.variables, {})
        self._mean = pytensor.function([joined], values, mode=with_memory())
        prior = model.logp(vars=model.free_RVs)
        [prior], joined = join_nonshared_inputs(logp.initial, [prior], logp.variables, {})
        self._slope = pytensor.function([joined], pytensor.grad(prior, joined))
        self.log_prior = pytensor.function([joined], prior)
        errors = {model.rvs_to_values[model[name]].name for name in record.error_parameters}
        own = [np.full(np.size(logp.initial[v.name]), v.name in errors) for v in logp.variables]
        self.of_errors = np.concatenate(own)
        self._theta: Any = None
        if has_jacobian(record.forward):
            graphs = model.replace_rvs_by_values([model[name] for name in record.forward_parameters])
            flat = pt.concatenate([pt.flatten(graph) if graph.ndim else graph[None] for graph in graphs])
            [flat, total], joined = join_nonshared_inputs(
                logp.initial, [flat, pt.sum(flat)], logp.variables, {}
            )
            by_q: Any = pytensor.grad(total, joined)
            self._theta = pytensor.function([joined], [flat, by_q])

    def slopes(self, q: Array) -> Array | None:
        """Derivatives (n, n_series, n_times) of the series by all but the errors' elements, or None."""
        if self._theta is None:
            return None
        theta, by_q = self._theta(q)
        self.logp.evaluations += GRADIENT
        try:
            found = jacobian(self.record.forward, theta)
        except SolveError:
            return None
        return None if found is None else found.slopes * by_q[~self.of_errors][:, None, None]

    def mean(self, q: Array) -> tuple[Array | None, dict[str, Any]]:
        """The solver's series, None where it fails, and the error parameters."""
        self.logp.evaluations += 1
        mean, ok, *errors = self._mean(q)
        return (mean if ok else None), dict(zip(self.record.errors.parameter_names, errors, strict=True))

    def whiten(self, residuals: Array, errors: Mapping[str, Any]) -> Array | None:
        """Residuals as independent standard normal numbers; None where there is no law."""
        found: Array | None = self.record.errors.whiten(residuals, errors)
        return found

    def prior(self, q: Array) -> tuple[Array, Array]:
        """Gradient of the log-prior (n_dim,), and its negative second derivatives without negative ones."""
        slope, h = np.asarray(self._slope(q)), 1e-4
        columns = [(self._slope(q + h * e) - self._slope(q - h * e)) / (2 * h) for e in np.eye(len(q))]
        curvature = -np.array(columns)
        eigenvalues, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
        return slope, vectors @ (np.maximum(eigenvalues, 0.0)[:, None] * vectors.T)


def least_squares(logp: LogPosterior, starts: Sequence[Array]) -> Array:
    """Where a search begins without the model's errors, (n_dim,): least squares with white noise.

    Residuals are counted in `LARGE_NOISE` of the range of their group, a parameter's distance from the first
    start in standard deviations of its prior. From the best few of `starts` (n_dim,) they are followed;
    the end with the least sum over groups of n_g/2 log(sum of squares) counts.
    """
    from scipy import optimize

    model, data = Residuals(logp), logp.model.zoo.data
    theta, q = np.flatnonzero(~model.of_errors), starts[0]
    curvature = np.diag(model.prior(q)[1])[theta]
    width = 1.0 / np.sqrt(np.where(curvature > 0, curvature, 1.0))
    size = np.empty((data.n_series, 1))
    for rows in data.rows.values():
        size[rows] = LARGE_NOISE * (max(np.ptp(data.samples(i)) for i in rows) or 1.0)

    def residuals(x: Array) -> Array:
        moved = q.copy()
        moved[theta] = x
        mean, _ = model.mean(moved)
        z = np.full(data.values.shape, 1e3) if mean is None else data.filled(data.values - mean) / size
        return np.concatenate([z.ravel(), (x - q[theta]) / width])

    def slopes(x: Array) -> Array:
        here = residuals(x)
        return np.stack([(residuals(x + STEP * e) - here) / STEP for e in np.eye(len(x))], axis=1)

    def misfit(x: Array) -> float:
        z = residuals(x)[: data.values.size].reshape(data.values.shape)
        squares = [z[rows] ** 2 for rows in data.rows.values()]
        return float(sum(0.5 * part.size * np.log(part.mean() + 1e-12) for part in squares))

    ends = [
        optimize.least_squares(residuals, begin, slopes, x_scale=width, max_nfev=30, xtol=1e-3, ftol=1e-4).x
        for begin in sorted((point[theta] for point in starts), key=misfit)[:FOLLOWED]
    ]
    best = q.copy()
    best[theta] = min(ends, key=misfit)
    return best


def gauss_newton(
    logp: LogPosterior,
    q: Array,
    value: float,
    *,
    limit: int,
    step: float = STEP,
    model: Residuals | None = None,
) -> tuple[Array, float, Array]:
    """Damped Gauss-Newton steps on the whitened residuals, for models with many parameters.

    With z the whitened residuals and J their derivatives, those of the forward model where it has them, else
    by differences, the step solves
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
    model : Residuals, optional
        Of `logp`, kept from another search.

    Returns
    -------
    q : array (n_dim,)
    value : float
    frame : array (n_dim, n_dim)
        Columns: directions about a standard deviation long.
    """
    from scipy.optimize import minimize

    model = Residuals(logp) if model is None else model
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
        if eta.size:
            found = minimize(cost, q[eta], method="Nelder-Mead", options={"maxfev": 80, "xatol": 1e-2})
            logp.evaluations = spent  # the solver remembers the point
            if -found.fun > value:
                value, q = -float(found.fun), q.copy()
                q[eta] = found.x
        mean, errors = model.mean(q)
        if mean is None or (z := model.whiten(data - mean, errors)) is None:
            break
        columns = []
        slopes = model.slopes(q)
        for i, k in enumerate(theta):
            if slopes is not None:
                h = step * scale[k]
                moved_z = model.whiten(data - mean - h * slopes[i], errors)
                columns.append(np.zeros_like(z) if moved_z is None else (moved_z - z) / h)
                continue
            for h in (step * scale[k], -step * scale[k]):
                moved = q.copy()
                moved[k] += h
                there, _ = model.mean(moved)
                moved_z = None if there is None else model.whiten(data - there, errors)
                if moved_z is not None:  # differences of what is whitened: it need not be linear
                    columns.append((moved_z - z) / h)
                    break
            else:
                columns.append(np.zeros_like(z))
        J = np.reshape(columns, (len(theta), -1)).T
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
) -> tuple[Array, float, Array, bool]:
    """Newton steps on wide differences: mode (n_dim,), its log-posterior, covariance (n_dim, n_dim), settled.

    Columns of `frame` are directions, each about a standard deviation long after the first pass. Settled is
    whether a further step would gain less than 0.05.
    """
    d, settled = len(q), False
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
        settled = gain < 0.05 and moved < 0.05
        if turn >= 1 and settled:
            break
    return q, value, frame @ frame.T, settled


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
