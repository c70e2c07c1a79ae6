"""How much of the gap each component holds: all of them together, each free function with a scale of its own.

The scales' posterior is sampled from the marginal likelihood, which is closed-form: given all others, that of
one scale is a sum over the eigenvalues of a small matrix, so that it and its length are drawn exactly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from zoo.core.diagnosis.components.response import Block, Linearised
from zoo.core.diagnosis.discrepancy import SIZE_PART
from zoo.core.diagnosis.estimates import INTERVAL
from zoo.core.diagnosis.file import Interval
from zoo.core.diagnosis.hypothesis import NONPARAMETRIC, ranges
from zoo.core.diagnosis.search import as_matrix
from zoo.core.errors.spectral import GroupErrors

Array = NDArray[np.float64]

LARGEST_SCALE, SMALLEST_SCALE = 4.0, 1e-3
"""Limits of a function's scale, in units of its prior's: a half-normal one is hardly ever outside."""
LATTICE = (0.1, 0.3)
"""Distance between the logarithms of the scales among which one is drawn; a new one is taken every time."""
UNSEEN = 0.1
"""Size, in sds of the noise, below which a direction of a function at its largest scale is left out."""
SILENT = 1e-4
"""Part of the noise's variance below which the largest discrepancy leaves a coefficient as it is."""
SWEEPS, SETTLING = 240, 60
"""Sweeps over all scales that are kept, and those before."""
MOVES, STRIDES = 3, (-1.5, 0.5)
"""Steps of the free discrepancy's size, length and correlation in each sweep, for each group; the decadic
logarithms between which the sd of a step of the size's logarithm is drawn."""
FIRST_FREE = 0.3
"""Sd of the free discrepancy from which a chain starts, in its prior's scale."""
PART_OF_A_PAIR = 0.1
"""Share of the gap above which the whole interval of a component has to lie for it to be one of several."""


@dataclass(frozen=True, eq=False)
class Shares:
    """Posterior of the components' shares of the gap's energy.

    The gap is the sum of all signals, each without what the baseline's parameters can absorb. A component's
    share is the part of its energy that the component's signal x_i projects on the whole,
    x_i'(sum_j x_j)/|sum_j x_j|^2: of each cross term 2 x_i'x_j either has half, as Shapley's value of the
    energy has it. Shares add up to 1; where signals cancel, one may be negative and another more than 1.

    Parameters
    ----------
    names : tuple of str
        Components, and last `unlisted`, the additive free discrepancy of the sensors.
    draws : array (n_draws, n_names)
        Shares.
    size : array (n_draws,)
        Rms of the gap, in the unit of the group asked about, or in parts of the ranges.
    scales : mapping of function to array (n_draws,)
        Their sds, in their units.
    lengths : mapping of function to array (n_draws,)
        Their correlation lengths; nan where a function has none.
    free : mapping of group to array (n_draws,)
        Sd of the free discrepancy, in the group's unit.
    signals : array (n_names, n)
        Posterior means of the signals as flat coefficients, without what the parameters can absorb.
    """

    names: tuple[str, ...]
    draws: Array = field(repr=False)
    size: Array = field(repr=False)
    scales: Mapping[str, Array] = field(repr=False)
    lengths: Mapping[str, Array] = field(repr=False)
    free: Mapping[str, Array] = field(repr=False)
    signals: Array = field(repr=False)

    def of(self, name: str) -> Interval:
        """A component's share."""
        draws = self.draws[:, self.names.index(name)]
        low, high = np.quantile(draws, INTERVAL)
        return Interval(mean=float(draws.mean()), low=float(low), high=float(high))

    @property
    def correlation(self) -> Array:
        """Of the shares, (n_names, n_names); near -1 where the data tell only the sum of two."""
        moved = self.draws - self.draws.mean(axis=0)
        sd = np.maximum(moved.std(axis=0), 1e-12)
        return np.asarray(moved.T @ moved / len(moved) / np.outer(sd, sd))


def pair_of(shares: Shares) -> tuple[str, ...]:
    """The components that each hold part of the gap for certain, largest share first; none or one mostly.

    Each has all of its share's interval above `PART_OF_A_PAIR`. Two that the data cannot tell apart exchange
    their shares from draw to draw, so that the interval of neither does, and no pair is made of one cause.
    What nothing listed explains is no component.
    """
    found = [(shares.of(name), name) for name in shares.names if name != NONPARAMETRIC]
    certain = [(one.mean, name) for one, name in found if one.low > PART_OF_A_PAIR]
    return tuple(name for _, name in sorted(certain, reverse=True))


def visible(block: Block, length: float | None, S: Array) -> Array:
    """Responses (n, m) to the weights of a function of sd 1, of those that may rise above the noise."""
    response = block.columns @ block.function.root(length)
    seen = LARGEST_SCALE * block.function.size * response / np.sqrt(S)[:, None]
    _, sizes, directions = np.linalg.svd(seen, full_matrices=False)
    return np.asarray(response @ directions[sizes > UNSEEN].T)


class _Function:
    """The responses to a function's visible weights, standard normal ones times its scale, by length."""

    def __init__(self, block: Block, S: Array) -> None:
        function = block.function
        self.name, self.component, self.size = function.name, function.component, function.size
        self.lengths = function.lengths or (None,)
        self.responses = [visible(block, length, S) for length in self.lengths]
        self.log_scale, self.at = math.log(self.size), 0

    @property
    def scale(self) -> float:
        return math.exp(self.log_scale)

    def lattice(self, rng: np.random.Generator) -> Array:
        """Scales (m,), the present one among them; from each of them the same are made."""
        step = rng.uniform(*LATTICE)
        low, high = (math.log(part * self.size) - self.log_scale for part in (SMALLEST_SCALE, LARGEST_SCALE))
        steps = np.arange(math.ceil(low / step), math.floor(high / step) + 1)
        return np.asarray(np.exp(self.log_scale + step * steps))


class _Sampler:
    """The linear model of all functions together, and the state of the chain."""

    def __init__(self, problem: Linearised, rng: np.random.Generator) -> None:
        self.problem, self.rng = problem, rng
        self.errors, self.r = problem.errors, problem.residual
        self.groups = self.errors.groups
        self.noise = {q: replace(e, delta=0.0, rough=False) for q, e in problem.noise.items()}
        self.S_noise = self.errors.variances(self.noise)
        self.functions = [_Function(b, self.S_noise) for b in problem.blocks]
        norms = np.sqrt(np.sum(problem.jacobian**2 / self.S_noise[:, None], axis=0))
        self.unit = 1.0 / np.maximum(norms, 1e-300)
        self.J = problem.jacobian * self.unit
        self.P = as_matrix(problem.precision) * np.outer(self.unit, self.unit)
        self.pull = problem.pull * self.unit
        self.n_base = self.J.shape[1]
        pieces, self.columns, start = [self.J], [], self.n_base
        for f in self.functions:
            slices = []
            for response in f.responses:
                pieces.append(response)
                slices.append(np.arange(start, start + response.shape[1]))
                start += response.shape[1]
            self.columns.append(slices)
        self.X = np.concatenate(pieces, axis=1)
        self._free_priors()
        self.S = self.S_noise.copy()
        self.S[self.loud] += self._own(self.state)
        self._renew()

    # -- the free discrepancy of the sensors -----------------------------------------------------

    def _free_priors(self) -> None:
        spans = ranges(self.errors.on)
        self.delta_scale = {q: SIZE_PART * spans[q] for q in self.groups}
        self.grid = self.errors.length_grid
        self.log_lengths = np.array([self.errors.length_log_prior(x) for x in self.grid])
        self.correlations = {
            q: self.errors.shared if len(rows) > 1 else (0.0,) for q, rows in self.errors.rows.items()
        }
        middle = len(self.grid) // 2
        self.state = {q: (math.log(FIRST_FREE * self.delta_scale[q]), middle, 0) for q in self.groups}
        largest = {q: (math.log(LARGEST_SCALE * self.delta_scale[q]), 0, 0) for q in self.groups}
        self.loud = np.arange(self.errors.size)
        self.loud = np.flatnonzero(self._own(largest) > SILENT * self.S_noise)
        quiet = np.setdiff1d(np.arange(self.errors.size), self.loud)
        scaled = self.X[quiet] / self.S_noise[quiet, None]
        self.G_quiet, self.b_quiet = scaled.T @ self.X[quiet], scaled.T @ self.r[quiet]

    def _errors_at(self, state: Mapping[str, tuple[float, int, int]]) -> dict[str, GroupErrors]:
        return {
            q: replace(
                self.noise[q],
                delta=math.exp(log_delta),
                length=float(self.grid[length]),
                shared=self.correlations[q][shared],
            )
            for q, (log_delta, length, shared) in state.items()
        }

    def _own(self, state: Mapping[str, tuple[float, int, int]]) -> Array:
        """Variances of the discrepancy's coefficients that are not silent."""
        return self.errors.variances(self._errors_at(state), noise=False)[self.loud]

    def _log_prior(self, q: str, state: tuple[float, int, int]) -> float:
        x = math.exp(state[0]) / self.delta_scale[q]
        return math.log(x) - 0.5 * x * x + float(self.log_lengths[state[1]])

    def _free(self) -> None:
        """Metropolis steps of size, length and correlation between series, of all scales at once."""
        on = self._on()
        scale = self._scale_of(on)
        X = self.X[np.ix_(self.loud, on)]
        r = self.r[self.loud]

        def log_z(S: Array) -> float:
            weighted = X / S[:, None]
            G = (weighted.T @ X + self.G_quiet[np.ix_(on, on)]) * np.outer(scale, scale)
            b = (weighted.T @ r + self.b_quiet[on]) * scale
            factor, b = self._with_priors(G, b)
            root = solve_triangular(factor, b, lower=True, check_finite=False)
            own = -0.5 * float(np.sum(r * r / S + np.log(S)))
            return own + 0.5 * float(root @ root) - float(np.sum(np.log(np.diag(factor))))

        S = self.S[self.loud]
        now = log_z(S)
        rng, moved = self.rng, False
        for q in self.groups:
            for _ in range(MOVES):
                old = self.state[q]
                new = (
                    old[0] + 10.0 ** rng.uniform(*STRIDES) * rng.standard_normal(),
                    old[1] + int(rng.integers(-1, 2)),
                    old[2] + int(rng.integers(-1, 2)),
                )
                x = new[0] - math.log(self.delta_scale[q])
                inside = 0 <= new[1] < len(self.grid) and 0 <= new[2] < len(self.correlations[q])
                if not inside or not math.log(SMALLEST_SCALE) < x < math.log(LARGEST_SCALE):
                    continue
                state = {**self.state, q: new}
                S_new = self.S_noise[self.loud] + self._own(state)
                then = log_z(S_new)
                gain = then - now + self._log_prior(q, new) - self._log_prior(q, old)
                if math.log(rng.uniform()) < gain:
                    self.state, S, now, moved = state, S_new, then, True
        if moved:
            self.S[self.loud] = S
            self._renew()

    def _renew(self) -> None:
        """Products of all responses with each other and with the residual, beside the present errors."""
        X = self.X[self.loud]
        scaled = X / self.S[self.loud, None]
        self.G = self.G_quiet + scaled.T @ X
        self.b = self.b_quiet + scaled.T @ self.r[self.loud]

    # -- the functions ---------------------------------------------------------------------------

    def _on(self, without: int = -1) -> NDArray[np.int_]:
        """Columns of the parameters, and of the functions at their present lengths."""
        parts = [self.columns[i][f.at] for i, f in enumerate(self.functions) if i != without]
        return np.concatenate([np.arange(self.n_base), *parts])

    def _scale_of(self, on: NDArray[np.int_], without: int = -1) -> Array:
        parts = [
            np.full(len(self.columns[i][f.at]), f.scale) for i, f in enumerate(self.functions) if i != without
        ]
        return np.concatenate([np.ones(self.n_base), *parts])

    def _with_priors(self, G: Array, b: Array) -> tuple[Array, Array]:
        """Cholesky factor of the precision of all weights, and what their mean is made of."""
        n = self.n_base
        H = G + np.diag(np.r_[np.zeros(n), np.ones(len(G) - n)])
        H[:n, :n] += self.P
        return np.linalg.cholesky(H), np.r_[b[:n] - self.pull, b[n:]]

    def _scale(self, i: int) -> None:
        """A function's scale and length together, given all other scales; the weights are integrated out."""
        f = self.functions[i]
        on = self._on(i)
        scale = self._scale_of(on, i)
        factor, b = self._with_priors(self.G[np.ix_(on, on)] * np.outer(scale, scale), self.b[on] * scale)
        own = np.concatenate(self.columns[i])
        beside = solve_triangular(
            factor, np.c_[self.G[np.ix_(on, own)] * scale[:, None], b], lower=True, check_finite=False
        )
        s2 = f.lattice(self.rng) ** 2
        log_p = np.empty((len(f.lengths), len(s2)))
        start = 0
        for k, columns in enumerate(self.columns[i]):
            part = beside[:, start : start + len(columns)]
            start += len(columns)
            A = self.G[np.ix_(columns, columns)] - part.T @ part
            q = self.b[columns] - part.T @ beside[:, -1]
            eigenvalues, vectors = np.linalg.eigh(A)
            more = 1.0 + s2[:, None] * np.maximum(eigenvalues, 0.0)
            power = s2[:, None] * (vectors.T @ q) ** 2
            log_p[k] = 0.5 * np.sum(power / more - np.log(more), axis=1)
        log_p += 0.5 * np.log(s2) - 0.5 * s2 / f.size**2  # of the logarithm of a half-normal scale
        p = np.exp(log_p - log_p.max())
        chosen = int(np.searchsorted(np.cumsum(p), self.rng.uniform() * p.sum()))
        f.at, at = divmod(min(chosen, p.size - 1), len(s2))
        f.log_scale = 0.5 * math.log(s2[at])

    def sweep(self) -> None:
        """Every scale once, then the free discrepancy."""
        for i in range(len(self.functions)):
            self._scale(i)
        self._free()

    def signals(self, names: Sequence[str]) -> Array:
        """A draw of the components' signals and of the free discrepancy, (n_names, n)."""
        on = self._on()
        scale = self._scale_of(on)
        factor, b = self._with_priors(self.G[np.ix_(on, on)] * np.outer(scale, scale), self.b[on] * scale)
        mean = cho_solve((factor, True), b, check_finite=False)
        z = mean + solve_triangular(factor, self.rng.standard_normal(len(mean)), lower=True, trans="T")
        weights = z * scale
        found = np.zeros((len(names), self.errors.size))
        start = self.n_base
        left = self.r - self.J @ weights[:start]
        for i, f in enumerate(self.functions):
            columns = self.columns[i][f.at]
            signal = self.X[:, columns] @ weights[start : start + len(columns)]
            start += len(columns)
            found[names.index(f.component)] += signal
            left = left - signal
        own = self.S[self.loud] - self.S_noise[self.loud]
        gain = own / self.S[self.loud]
        spread = np.sqrt(own * (1.0 - gain)) * self.rng.standard_normal(len(own))
        found[-1, self.loud] = gain * left[self.loud] + spread
        return found


def shares_of(
    problem: Linearised,
    *,
    group: str | None = None,
    seed: int = 0,
    sweeps: int = SWEEPS,
) -> Shares:
    """Sample how much of the gap each component holds, all of them and the free discrepancy together.

    r = J d + sum_b s_b X_b L(l_b) z_b + delta + e: z_b standard normal, s_b half-normal with the size of its
    function, l_b one of its lengths, delta a smooth discrepancy for each group as for the evidence of
    `unlisted`, e the noise that was given. Scales, lengths and the discrepancy's kind are drawn with d, z_b
    and delta integrated out; then these are drawn given them.

    Parameters
    ----------
    problem : Linearised
    group : str, optional
        Whose series' energy is shared out; all groups, each in parts of its range, if absent.
    seed : int
    sweeps : int
        Draws that are kept.

    Returns
    -------
    Shares

    References
    ----------
    Owen and Prieur 2017, doi 10.1137/16M1097717: Shapley's value of a variance with dependent parts.
    """
    sampler = _Sampler(problem, np.random.default_rng(seed))
    errors = problem.errors
    spans = ranges(errors.on)
    weight = np.zeros((errors.on.n_series, errors.n))
    for q, rows in errors.rows.items():
        if group is None:
            weight[rows] = 1.0 / spans[q] ** 2
        elif q == group:
            weight[rows] = 1.0
    counted = float(np.count_nonzero(weight))
    flat_weight = weight.reshape(errors.size)
    scaled = sampler.J / sampler.S_noise[:, None]
    absorbed = np.linalg.solve(scaled.T @ sampler.J + sampler.P, scaled.T)
    names = (*problem.components, NONPARAMETRIC)
    shares, size, total = (
        np.empty((sweeps, len(names))),
        np.empty(sweeps),
        np.zeros((len(names), errors.size)),
    )
    scales = {f.name: np.empty(sweeps) for f in sampler.functions}
    lengths = {f.name: np.full(sweeps, math.nan) for f in sampler.functions}
    free = {q: np.empty(sweeps) for q in errors.groups}
    with threadpool_limits(1, user_api="blas"):  # threads cost more than such small matrices gain
        for _ in range(SETTLING):
            sampler.sweep()
        for i in range(sweeps):
            sampler.sweep()
            signals = sampler.signals(names)
            signals -= (signals @ absorbed.T) @ sampler.J.T
            gap = signals.sum(axis=0)
            energy = float(np.sum(gap**2 * flat_weight))
            shares[i] = signals @ (gap * flat_weight) / max(energy, 1e-300)
            size[i] = math.sqrt(energy / counted)
            total += signals
            for f in sampler.functions:
                scales[f.name][i] = f.scale
                length = f.lengths[f.at]
                if length is not None:
                    lengths[f.name][i] = length
            for q in errors.groups:
                free[q][i] = math.exp(sampler.state[q][0])
    return Shares(names, shares, size, scales, lengths, free, total / sweeps)
