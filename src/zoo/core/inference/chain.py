"""One chain: its step method, its draws so far, and its checkpoint."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from pymc.blocking import DictToArrayBijection, RaveledVars
from pymc.pytensorf import floatX

from zoo.core.inference.gradient_step import Nuts
from zoo.core.inference.logposterior import Array, Point, count, counting_ops, outputs
from zoo.core.inference.spaces import Gaussian
from zoo.core.inference.states import of_chain, read_state, write_state
from zoo.core.inference.steps import DEMetropolisZ, Metropolis


@dataclass(frozen=True)
class Task:
    """Everything a chain needs, sent to its process; its checkpoint belongs to `run`."""

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
    checkpoint: Path | None
    checkpoint_seconds: float
    run: str = ""


_SUMS = ("accept", "accepted", "solves", "solver_failures")
_OF_GRADIENTS = ("gradients", "diverging")
_LASTS = {"model_logp": "lp", "scaling": "scaling", "lambda": "lambda", "beta": "beta"}


class Chain:
    """One chain: its step method, its draws so far, and its checkpoint.

    A stored draw stands for `thin` steps: values and log-posterior are those after the last of them, solves,
    failures, gradients and diverging trajectories are sums over them, accept and accepted are means.
    """

    def __init__(self, task: Task) -> None:
        self.task = task
        model = task.model
        posterior = model.initial_point()
        self.step = _make_step(task, posterior)
        template = DictToArrayBijection.map({v.name: np.asarray(posterior[v.name]) for v in self.step.vars})
        self.point: Point = dict(
            DictToArrayBijection.rmap(RaveledVars(floatX(task.start), template.point_map_info))
        )
        names = [v.name for v in model.unobserved_value_vars]
        wanted = [v.name for v in (*model.free_RVs, *model.deterministics)]
        self.names, self._values = outputs(model, [name for name in names if name in set(wanted)])
        self._ops = counting_ops(self.step._logp)
        self._each_accepted = bool(counting_ops(self._values.f))  # while the solve is still remembered
        self._current: list[np.ndarray] | None = None
        self.steps = 0
        self.draws: dict[str, list[np.ndarray]] = {name: [] for name in self.names}
        self.stats: dict[str, list[float]] = {}
        self._summed = _SUMS + _OF_GRADIENTS if isinstance(self.step, Nuts) else _SUMS
        self._sums = dict.fromkeys(self._summed, 0.0)
        self.solves = 0
        self.accepted = 0.0
        self.failures: Counter[str] = Counter()
        self.seconds = 0.0
        self._saved_at = time.monotonic()
        step_seed = np.random.SeedSequence(task.seed, spawn_key=(task.chain, 1))
        self.step.set_rng(np.random.default_rng(step_seed))
        self.step.tune = task.tune > 0
        if task.tune == 0:
            self.step.stop_tuning()
        if task.checkpoint is not None and task.checkpoint.exists():
            self._restore(task.checkpoint)

    @property
    def kept(self) -> int:
        """Stored draws so far."""
        return len(self.draws[self.names[0]])

    @property
    def tuning(self) -> bool:
        """Whether the tuning phase is still on."""
        return self.steps < self.task.tune

    def run(
        self,
        until: int,
        seconds: float | None,
        tick: Callable[[], None] = lambda: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        """Step until `until` draws are stored, `seconds` have passed or `stop` says so.

        How the steps are cut into calls has no influence on the draws.
        """
        began = time.monotonic()
        while self.kept < until and not stop():
            before = time.monotonic()
            self._one()
            now = time.monotonic()
            self.seconds += now - before
            tick()
            if self.task.checkpoint is not None and now - self._saved_at >= self.task.checkpoint_seconds:
                self.save()
            if seconds is not None and now - began >= seconds:
                break

    def _one(self) -> None:
        before, failed_before = count(self._ops)
        if self.task.tune and self.steps == self.task.tune:
            self.step.stop_tuning()
        self.point, [stats] = self.step.step(self.point)
        self.steps += 1
        if not self._ops:
            stats["solves"] = 1  # nothing counts: each step evaluates the log-posterior once
        accepted = float(stats["accepted"])
        if self._each_accepted and (accepted or self._current is None):
            self._current = self._values(self.point)
        after, failed_after = count(self._ops)
        self.solves += after - before if self._ops else 1
        self.failures.update(failed_after - failed_before)
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

    def since(self, first: int) -> dict[str, Any]:
        """Progress, and the draws from number `first` on, as one message to the parent."""
        return {
            "chain": self.task.chain,
            "steps": self.steps,
            "kept": self.kept,
            "tuning": self.tuning,
            "seconds": self.seconds,
            "solves": self.solves,
            "accepted": self.accepted,
            "failures": dict(self.failures),
            "draws": {name: np.array(rows[first:]) for name, rows in self.draws.items()},
            "stats": {name: np.array(rows[first:]) for name, rows in self.stats.items()},
        }

    def save(self) -> None:
        """Write the checkpoint; a kill at any moment leaves the old one or the new one."""
        path = self.task.checkpoint
        if path is None:
            return
        content = {
            "steps": self.steps,
            "point": self.point,
            "step": self._step_state(),
            "draws": {name: np.array(rows) for name, rows in self.draws.items()},
            "stats": {name: np.array(rows) for name, rows in self.stats.items()},
            "sums": self._sums,
            "current": self._current,
            "solves": self.solves,
            "accepted": self.accepted,
            "failures": self.failures,
            "seconds": self.seconds,
        }
        self._saved_at = write_state(path, of_chain(self.task.run, self.task.chain), content)

    def _step_state(self) -> dict[str, Any]:
        """What changes in the step method; the rest follows from the task."""
        state = self.step.sampling_state
        return {f.name: getattr(state, f.name) for f in fields(state) if not f.metadata.get("frozen")}

    def _restore(self, path: Path) -> None:
        content = read_state(path, of_chain(self.task.run, self.task.chain))
        self.steps = content["steps"]
        self.point = content["point"]
        fresh = self.step.sampling_state
        for name in self._step_state():
            setattr(fresh, name, content["step"][name])
        self.step.sampling_state = fresh
        self.draws = {name: list(rows) for name, rows in content["draws"].items()}
        self.stats = {name: list(rows) for name, rows in content["stats"].items()}
        self._sums = content["sums"]
        self._current = content["current"]
        self.solves = content["solves"]
        self.accepted = content["accepted"]
        self.failures = Counter(content["failures"])
        self.seconds = content["seconds"]


def _make_step(task: Task, point: Point) -> Any:
    kwargs: dict[str, Any] = {"model": task.model, "initial_point": point, "reference": task.reference}
    if task.step == "demetropolisz":
        return DEMetropolisZ(archive=task.archive, **kwargs, **task.options)
    if task.step == "nuts":
        return Nuts(**kwargs, **task.options)
    return Metropolis(vars=list(task.model.continuous_value_vars), **kwargs, **task.options)
