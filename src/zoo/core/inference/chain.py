"""A chain, as a function of its task: steps and draws, the same wherever and however often it is run."""

from __future__ import annotations

import time
import warnings
from collections import Counter, OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cloudpickle  # type: ignore[import-untyped]
import numpy as np
from pymc.blocking import DictToArrayBijection, RaveledVars
from pymc.pytensorf import floatX

from zoo.core.arrays import Array
from zoo.core.inference.gradient_step import Nuts
from zoo.core.inference.logposterior import Point, SamplingError, count, counting_ops, outputs
from zoo.core.inference.memo import Found, Remembering, read_lines, to_line
from zoo.core.inference.spaces import Gaussian
from zoo.core.inference.steps import DEMetropolisZ

_SUMS = ("accept", "accepted", "solves", "solver_failures")
_OF_GRADIENTS = ("gradients", "diverging")
_LASTS = {"model_logp": "lp", "scaling": "scaling", "lambda": "lambda", "beta": "beta"}
_RUNS = 4
"""Runs whose chains a process keeps, to go on with them."""


@dataclass(frozen=True)
class Task:
    """Everything a chain follows from."""

    model: Any
    chain: int
    seed: int
    start: Array
    reference: Gaussian
    archive: Array
    step: str
    options: dict[str, Any]
    tune: int
    thin: int


class Chain:
    """One chain: its step method, and its draws so far.

    A stored draw stands for `thin` steps: values and log-posterior are those after the last of them, solves,
    failures, gradients and diverging trajectories are sums over them, accept and accepted are means.

    Parameters
    ----------
    task : Task
    known : mapping
        What the log-posterior gave in an earlier run of the same task: those steps are made again without it.
    owner : str
        Of the memo's lines.
    """

    def __init__(self, task: Task, known: Mapping[bytes, Found], owner: str = "") -> None:
        self.task, self._owner = task, owner
        self.lines: list[bytes] = []
        """Lines of the memo that were not handed out."""
        model = task.model
        posterior = model.initial_point()
        self.step = _make_step(task, posterior)
        template = DictToArrayBijection.map({v.name: np.asarray(posterior[v.name]) for v in self.step.vars})
        self.point: Point = self._point(task.start, template.point_map_info)
        names = [v.name for v in model.unobserved_value_vars]
        wanted = [v.name for v in (*model.free_RVs, *model.deterministics)]
        self.names, values = outputs(model, [name for name in names if name in set(wanted)])
        logp = Remembering(self.step._logp, known, self._note, alone=task.step != "nuts")
        self.step.replace_logp(logp)
        self._ops: list[Any] = [logp]
        self._values = values
        self._each_accepted = bool(ops := counting_ops(values.f))  # while the solve is still remembered
        if self._each_accepted:
            info = template.point_map_info
            solved = Remembering(
                lambda q: values(self._point(q, info)), known, self._note, b"values", ops, alone=False
            )
            self._values = lambda point: solved(DictToArrayBijection.map(point).data)
            self._ops.append(solved)
        self._current: list[np.ndarray] | None = None
        self.steps = 0
        self.draws: dict[str, list[np.ndarray]] = {name: [] for name in self.names}
        self.stats: dict[str, list[float]] = {}
        self._summed = _SUMS + _OF_GRADIENTS if isinstance(self.step, Nuts) else _SUMS
        self._sums = dict.fromkeys(self._summed, 0.0)
        self.accepted = 0.0
        self.seconds = 0.0
        self.step.tune = task.tune > 0
        if task.tune == 0:
            self.step.stop_tuning()

    def _point(self, q: Array, info: Any) -> Point:
        return dict(DictToArrayBijection.rmap(RaveledVars(floatX(q), info)))

    def _note(self, key: bytes, found: Found) -> None:
        self.lines.append(to_line(self._owner, key, found))

    @property
    def kept(self) -> int:
        """Stored draws so far."""
        return len(self.draws[self.names[0]])

    def run(self, until: int, seconds: float | None = None, at_least: int = 0) -> None:
        """Step until `until` draws are stored, or `seconds` have passed and there are `at_least` steps.

        How the steps are cut into calls has no influence on the draws.
        """
        began = now = time.monotonic()
        before = self.seconds
        while self.kept < until:
            self._one()
            now = time.monotonic()
            self.seconds = before + now - began
            if seconds is not None and now - began >= seconds and self.steps >= at_least:
                break

    def _one(self) -> None:
        if self.task.tune and self.steps == self.task.tune:
            self.step.stop_tuning()
        self.point, [stats] = self.step.step(self.point)
        self.steps += 1
        accepted = float(stats["accepted"])
        if self._each_accepted and (accepted or self._current is None):
            self._current = self._values(self.point)
        self.accepted += accepted
        if self.steps <= self.task.tune:
            return
        accept = float(stats["accept"])
        self._sums["accept"] += min(1.0, accept) if accept > 0 else 0.0
        for name in self._summed[1:]:
            self._sums[name] += float(stats[name])
        if (self.steps - self.task.tune) % self.task.thin == 0:
            self._keep(stats)

    def _keep(self, stats: Mapping[str, Any]) -> None:
        values = self._current if self._current is not None else self._values(self.point)
        for name, value in zip(self.names, values, strict=True):
            self.draws[name].append(np.array(value))
        for name in self._summed:
            total = self._sums[name]
            mean = name in ("accept", "accepted")
            self.stats.setdefault(name, []).append(total / self.task.thin if mean else total)
        for source, name in _LASTS.items():
            if source in stats:
                self.stats.setdefault(name, []).append(float(stats[source]))
        self._sums = dict.fromkeys(self._summed, 0.0)

    def report(self, first: int) -> Report:
        """How far it is, the draws from number `first` on, and new lines of the memo."""
        solves, failures = count(self._ops)
        lines, self.lines = b"".join(self.lines), []
        return Report(
            steps=self.steps,
            kept=self.kept,
            seconds=self.seconds,
            solves=solves,
            accepted=self.accepted,
            failures=failures,
            draws={name: np.array(rows[first:]) for name, rows in self.draws.items()},
            stats={name: np.array(rows[first:]) for name, rows in self.stats.items()},
            lines=lines,
        )


@dataclass(frozen=True)
class Report:
    """What a chain tells: steps, stored draws, seconds, solves and accepted steps so far, and what is new."""

    steps: int
    kept: int
    seconds: float
    solves: int
    accepted: float
    failures: Counter[str]
    draws: dict[str, np.ndarray]
    stats: dict[str, np.ndarray]
    lines: bytes


@dataclass(frozen=True)
class Order:
    """What a worker is asked for: to bring a chain of a run on, from `steps` steps and `kept` draws.

    With `tasks` (of all chains, pickled but for a worker in this process) and `lines` of the chain's memo a
    worker can begin it; without them it must have the chain.
    """

    run: str
    chain: int
    steps: int
    kept: int
    until: int
    seconds: float | None
    owner: str = ""
    tasks: bytes | Sequence[Task] | None = None
    lines: bytes = b""


_held: OrderedDict[str, tuple[Sequence[Task], dict[int, Chain]]] = OrderedDict()


def run_chain(order: Order) -> Report | None:
    """Bring a chain on; None if it is not here."""
    _, chains = _held.get(order.run, ((), {}))
    chain = chains.get(order.chain)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if chain is None or chain.steps != order.steps:
                if order.tasks is None:
                    return None
                chain = _begun(order)
            chain.run(order.until, order.seconds, order.steps)
        except Exception as error:
            failed = SamplingError(f"chain {order.chain}: {type(error).__name__}: {error}")
            raise failed from error
    return chain.report(order.kept)


def _begun(order: Order) -> Chain:
    if order.run not in _held:
        found = cloudpickle.loads(order.tasks) if isinstance(order.tasks, bytes) else order.tasks or ()
        _held[order.run] = found, {}
        while len(_held) > _RUNS:
            _held.popitem(last=False)
    tasks, chains = _held[order.run]
    known = read_lines(order.owner, order.lines, f"chain {order.chain}")
    chains[order.chain] = Chain(tasks[order.chain], known, order.owner)
    return chains[order.chain]


def forget(run: str) -> None:
    """Let the chains of a run go that this process holds."""
    _held.pop(run, None)


def _make_step(task: Task, point: Point) -> Any:
    kwargs: dict[str, Any] = {"model": task.model, "initial_point": point, "reference": task.reference}
    kwargs["rng"] = np.random.default_rng(np.random.SeedSequence(task.seed, spawn_key=(task.chain, 1)))
    if task.step == "nuts":
        return Nuts(**kwargs, **task.options)
    return DEMetropolisZ(archive=task.archive, **kwargs, **task.options)
