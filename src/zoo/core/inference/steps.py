"""PyMC's DEMetropolisZ with one evaluation of the log-posterior a step, which counts solves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pymc as pm
from numpy.typing import ArrayLike
from pymc.blocking import RaveledVars
from pymc.pytensorf import floatX, make_shared_replacements
from pymc.step_methods.arraystep import metrop_select
from pymc.step_methods.metropolis import DEMetropolisZState
from pymc.step_methods.state import dataclass_state
from pymc.util import get_value_vars_from_user_vars
from pytensor.compile.mode import Mode as CompileMode

from zoo.core.arrays import Array
from zoo.core.inference.logposterior import Point, compile_logp, count, counting_ops
from zoo.core.inference.spaces import T_DOF, ConstrainedSpace, Gaussian

StepResult = tuple[RaveledVars, list[dict[str, Any]]]

_CN_ACCEPTANCE = 0.25
_FIRST_REFIT = 200
DEMETROPOLISZ: Mapping[str, Any] = {"crank_nicolson": 0.5, "constrained": 0.5, "tune_drop_fraction": 0.5}
"""Options of `DEMetropolisZ` that suit posteriors of costly models."""


@dataclass
class Walk:
    """A Crank-Nicolson walk: coordinates, the Gaussian it is around, its step, how often that was tuned."""

    space: ConstrainedSpace
    reference: Gaussian
    beta: float = 0.5
    tuned: int = 0


@dataclass_state
class _DEState(DEMetropolisZState):
    _memory: dict[bytes, float]
    _walks: list[Walk]
    _seen: int
    _next_refit: int


class DEMetropolisZ(pm.DEMetropolisZ):
    """PyMC's DEMetropolisZ with one evaluation of the log-posterior a step, and three optional additions.

    PyMC compiles logp(proposed) - logp(current), two evaluations a step. Here the log-posterior is compiled
    alone; its last values are kept by the bytes of the point and of the variables that other step methods
    own, so the current point is never evaluated again.

    With its defaults the draws equal those of `pm.DEMetropolisZ` for the same seed. `archive` starts the
    history that jumps are drawn from. A share `crank_nicolson` of the steps proposes

        u' = sqrt(1 - beta^2) u + beta sqrt(s) xi,   s = (nu + |u|^2) / chi^2_{nu + d},   xi ~ N(0, I),

    with u the point whitened by a Gaussian (`reference`), which leaves a t distribution with nu = 5 degrees
    of freedom around it invariant; acceptance corrects for the posterior over that t. The Gaussian is
    refitted to the history and beta adapted to an acceptance of 0.25 while tuning; both are fixed after it.
    A share `constrained` of either kind of steps is made in the constrained space: in the values x(q) of
    variables between two bounds,

        log alpha = log p(q') - log p(q) - log|dx/dq|(q') + log|dx/dq|(q) (+ log t(x) - log t(x')),

    where proposals beyond a bound are refused without a solve.

    Parameters
    ----------
    vars : list of variables, optional
        All continuous ones if absent.
    archive : array (n, n_dim), optional
        First history, unconstrained.
    reference : Gaussian, optional
        First reference; needed for Crank-Nicolson moves before the first 200 steps are done.
    crank_nicolson : float
        Share in [0, 1) of the Crank-Nicolson moves.
    constrained : float
        Share in [0, 1) of moves in the constrained space; the rest is in the unconstrained space.
    **kwargs
        As `pm.DEMetropolisZ`: S, proposal_dist, lamb, scaling, tune, tune_interval, tune_drop_fraction,
        model, initial_point, compile_kwargs, rng, blocked.

    Raises
    ------
    ValueError
        If `crank_nicolson` or `constrained` is not in [0, 1).

    References
    ----------
    ter Braak, Vrugt (2008), doi 10.1007/s11222-008-9104-9; Kamatani (2018), doi 10.1016/j.spa.2017.06.001;
    Cotter, Roberts, Stuart, White (2013), doi 10.1214/13-STS421.
    """

    name = "DEMetropolisZ"
    stats_dtypes_shapes: ClassVar[dict[str, Any]] = {
        **pm.DEMetropolisZ.stats_dtypes_shapes,
        "beta": (np.float64, []),
        "solves": (np.int64, []),
        "solver_failures": (np.int64, []),
        "model_logp": (np.float64, []),
    }
    _state_class = _DEState

    def __init__(
        self,
        vars: Any = None,
        *,
        archive: ArrayLike | None = None,
        reference: Gaussian | None = None,
        crank_nicolson: float = 0.0,
        constrained: float = 0.0,
        model: Any = None,
        initial_point: Point | None = None,
        compile_kwargs: Mapping[str, Any] | None = None,
        **kwargs: Any,
    ) -> None:
        for name, share in (("crank_nicolson", crank_nicolson), ("constrained", constrained)):
            if not 0 <= share < 1:
                raise ValueError(f"{name} = {share}: must be in [0, 1)")
        model = pm.modelcontext(model)
        point = model.initial_point() if initial_point is None else initial_point
        if (
            vars is not None
        ):  # PyMC sizes its defaults by all variables of the model, which fails for some of them
            size = sum(point[v.name].size for v in get_value_vars_from_user_vars(vars, model))
            kwargs["S"] = np.ones(size) if kwargs.get("S") is None else kwargs["S"]
            kwargs["lamb"] = 2.38 / np.sqrt(2 * size) if kwargs.get("lamb") is None else kwargs["lamb"]
        # PyMC compiles a function that is replaced here; without an optimizer that is quickly done
        quick = {"mode": CompileMode(linker="py", optimizer=None)}  # type: ignore[arg-type]
        super().__init__(vars, model=model, initial_point=point, compile_kwargs=quick, **kwargs)
        del self.delta_logp  # PyMC's own, in the instance; the method below takes its place
        shared = make_shared_replacements(point, self.vars, model)
        self.shared = {var.name: value for var, value in shared.items()}
        self._logp: Any = compile_logp(model, self.vars, point, shared, compile_kwargs)
        self._memory: dict[bytes, float] = {}
        self._ops: list[Any] | None = None
        self.crank_nicolson = crank_nicolson
        space = ConstrainedSpace.of(model, self.vars, point)
        self._spaces = [ConstrainedSpace(space.index[:0], space.lower[:0], space.width[:0])]
        if constrained and len(space.index):
            self._spaces.append(space)
        self.constrained = constrained
        self._first_archive = [] if archive is None else list(np.array(archive, dtype=float, ndmin=2))
        self._first_reference = reference
        self._set_untuned()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_ops": None}

    def replace_logp(self, function: Any) -> None:
        """Let a function of a vector (n_dim,) give the log-posterior."""
        self._logp, self._ops = function, None

    def logp(self, q: Array) -> float:
        """Log-posterior at q (n_dim,), from memory if q is one of the last two points."""
        key = q.tobytes() + b"".join(np.asarray(v.get_value()).tobytes() for v in self.shared.values())
        if key not in self._memory:
            value = float(self._logp(q))
            while len(self._memory) > 1:
                del self._memory[next(iter(self._memory))]
            self._memory[key] = value
        else:
            self._memory[key] = self._memory.pop(key)  # to the end: the next to go is the other one
        return self._memory[key]

    def delta_logp(self, q: Array, q0: Array) -> float:
        """Log-posterior at q minus that at q0."""
        current = self.logp(q0)
        return self.logp(q) - current

    def _set_untuned(self) -> None:
        self._history = list(self._first_archive)
        first = self._first_reference
        self._walks = [] if first is None else self._walks_around(first)
        self._seen = len(self._history)  # of the history, what is not this chain's own
        self._next_refit = _FIRST_REFIT

    def _walks_around(self, first: Gaussian) -> list[Walk]:
        return [Walk(space, _seen_in(space, first)) for space in self._spaces]

    def reset_tuning(self) -> None:
        """Forget the history and all that was tuned."""
        super().reset_tuning()
        self._set_untuned()

    def astep(self, q0: RaveledVars) -> StepResult:
        """One step from q0; returns the new point and its statistics."""
        if self._ops is None:
            self._ops = counting_ops(self._logp)
        before, failed_before = count(self._ops)
        q, stats = self._one_step(q0)
        after, failed_after = count(self._ops)
        stats[0]["solves"] = after - before
        stats[0]["solver_failures"] = (failed_after - failed_before).total()
        stats[0]["model_logp"] = self.logp(q.data)
        return q, stats

    def _one_step(self, q0: RaveledVars) -> StepResult:
        if self.crank_nicolson:
            if self.tune and len(self._history) - self._seen >= self._next_refit:
                self._refit()
                self._next_refit = int(1.5 * self._next_refit)
            if self._walks and self.rng.uniform() < self.crank_nicolson:
                return self._crank_nicolson(q0, self._walks[self._coordinates()])
        if len(self._history) > 1 and self._coordinates():
            return self._difference(q0, self._spaces[1])
        q, stats = super().astep(q0)
        stats[0]["beta"] = self._beta
        return q, stats

    @property
    def _beta(self) -> float:
        return self._walks[0].beta if self._walks else float("nan")

    def _coordinates(self) -> int:
        """Which coordinates the next move is made in: 0 unconstrained, 1 constrained."""
        return int(len(self._spaces) > 1 and self.rng.uniform() < self.constrained)

    def _difference(self, q0: RaveledVars, space: ConstrainedSpace) -> StepResult:
        """PyMC's jump along the difference of two past points, but in the constrained space."""
        pair = self.rng.choice(len(self._history), 2, replace=False)
        one, other = (space.values(self._history[i]) for i in pair)
        q = floatX(space.vector(space.values(q0.data) + self.lamb * (one - other)))
        return self._select(q0, q, space, 0.0)

    def _crank_nicolson(self, q0: RaveledVars, walk: Walk) -> StepResult:
        d = len(q0.data)
        u = walk.reference.whiten(walk.space.values(q0.data))
        scale = np.sqrt((T_DOF + u @ u) / self.rng.chisquare(T_DOF + d))
        new = np.sqrt(1.0 - walk.beta**2) * u + walk.beta * scale * self.rng.standard_normal(d)
        q = floatX(walk.space.vector(walk.reference.colour(new)))
        log_t = -0.5 * (T_DOF + d) * (np.log1p(u @ u / T_DOF) - np.log1p(new @ new / T_DOF))
        result = self._select(q0, q, walk.space, log_t)
        accept = result[1][0]["accept"]
        if self.tune:
            walk.tuned += 1
            gain = 2.0 / np.sqrt(walk.tuned)
            walk.beta = float(min(1.0, walk.beta * np.exp(gain * (min(1.0, accept) - _CN_ACCEPTANCE))))
        return result

    def _select(self, q0: RaveledVars, q: Array, space: ConstrainedSpace, log_proposals: float) -> StepResult:
        """Accept or refuse; `log_proposals` is the ratio of the proposals' densities in `space`."""
        log_accept = -np.inf
        if np.all(np.isfinite(q)):
            volumes = space.log_volume(q) - space.log_volume(q0.data)
            log_accept = self.delta_logp(q, q0.data) - volumes + log_proposals
        q_new, accepted = metrop_select(log_accept, q, q0.data, rng=self.rng)
        self._history.append(q_new)
        stats = {
            "scaling": float(np.mean(self.scaling)),
            "lambda": self.lamb,
            "beta": self._beta,
            "accept": 0.0 if np.isnan(log_accept) else float(np.exp(min(log_accept, 700.0))),
            "accepted": accepted,
        }
        return RaveledVars(q_new, q0.point_map_info), [stats]

    def _refit(self) -> None:
        past = self._history[self._seen :]
        past = past[len(past) // 3 :]
        if not past or len(past) < 10 * len(past[0]):
            return
        own = np.array(past)
        d = own.shape[1]
        if not self._walks:
            scatter = np.cov(own.T).reshape(d, d)
            first = Gaussian(own.mean(0), scatter + np.diag(1e-8 + 1e-3 * np.diag(scatter)))
            self._walks = self._walks_around(first)
            return
        for walk in self._walks:
            start = walk.reference
            if self._first_reference is not None:
                start = _seen_in(walk.space, self._first_reference)
            walk.reference = start.refit(walk.space.values(own))
            walk.tuned //= 2

    def stop_tuning(self) -> None:
        """Fix the references and betas, and drop the first part of the history."""
        if self.crank_nicolson:
            self._refit()
        super().stop_tuning()


def _seen_in(space: ConstrainedSpace, gaussian: Gaussian) -> Gaussian:
    """A Gaussian of the unconstrained space in other coordinates, to first order."""
    slopes = np.ones(len(gaussian.mean))
    slopes[space.index] = space.slopes(gaussian.mean)
    return Gaussian(space.values(gaussian.mean), gaussian.covariance * np.outer(slopes, slopes))
