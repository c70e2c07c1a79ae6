"""What a model's priors say before data: intervals of its parameters, and bands of the observed series."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from zoo.core.arrays import Array
from zoo.core.forward import SolveError
from zoo.core.model import record_of
from zoo.core.parameters import Parameter, draw_prior, unpack

DRAWS = 4000
"""Draws from which the intervals of hierarchical priors are taken."""


@dataclass(frozen=True)
class PriorRow:
    """A parameter's prior in numbers.

    Parameters
    ----------
    parameter : Parameter
    median, low, high : float
        Median and 95 % interval, in the parameter's unit; of one element of a vector.
    origin : str
        Where the prior came from.
    """

    parameter: Parameter
    median: float
    low: float
    high: float
    origin: str


@dataclass(frozen=True)
class PriorPredictive:
    """Series of prior draws.

    Parameters
    ----------
    draws : array (n_draws, n_values)
        Of the forward model's parameters, solved or not.
    series : array (n_solved, n_series, n_times)
        Computed, without errors, in the series' units.
    failures : mapping of str to int
        Draws that could not be solved, by the reason.
    """

    draws: Array
    series: Array
    failures: Mapping[str, int]

    @property
    def text(self) -> str:
        """How many draws could be solved, and why the others could not."""
        n, solved = len(self.draws), len(self.series)
        why = ", ".join(f"{count} {kind}" for kind, count in self.failures.items())
        return f"{solved} of {n} prior draws could be solved" + (f"; not solved: {why}" if why else "")


def prior_rows(model: Any) -> tuple[PriorRow, ...]:
    """Priors of a model's parameters in numbers, those of the errors last.

    Parameters
    ----------
    model : pymc.Model
        Made by a model of the zoo.
    """
    record = record_of(model)
    origins = record.settings.get("prior origins", {})
    found = []
    for parameters, otherwise in (
        (record.forward.parameters, "the model's file"),
        (record.errors.parameters, "its errors"),
    ):
        drawn = _hierarchical(parameters)
        for p in parameters:
            if p.name in drawn:
                low, median, high = np.quantile(drawn[p.name], (0.025, 0.5, 0.975))
            else:
                low, median, high = p.prior.quantile([0.025, 0.5, 0.975])
            origin = str(origins.get(p.name, "the effect" if "." in p.name else otherwise))
            found.append(PriorRow(p, float(median), float(low), float(high), origin))
    return tuple(found)


def _hierarchical(parameters: Sequence[Parameter]) -> dict[str, Array]:
    """Draws of one element of each parameter whose prior depends on others."""
    names = [p.name for p in parameters if p.prior.depends_on]
    if not names:
        return {}
    rng = np.random.default_rng(1)
    draws = [unpack(parameters, draw_prior(parameters, rng)) for _ in range(DRAWS)]
    return {name: np.array([np.ravel(values[name])[0] for values in draws]) for name in names}


def prior_predictive(
    model: Any, n_draws: int = 200, seed: int = 1, tick: Callable[[int], None] = lambda done: None
) -> PriorPredictive:
    """Solve a model at draws of its prior.

    Parameters
    ----------
    model : pymc.Model
        Made by a model of the zoo.
    n_draws : int
    seed : int
    tick : callable
        Told how many draws are done.

    Returns
    -------
    PriorPredictive
    """
    forward = record_of(model).forward
    rng = np.random.default_rng(seed)
    draws, series, failures = [], [], Counter[str]()
    for k in range(n_draws):
        theta = draw_prior(forward.parameters, rng)
        draws.append(theta)
        try:
            series.append(np.asarray(forward.solve(forward.configure(theta))))
        except SolveError as error:
            failures[error.kind] += 1
        tick(k + 1)
    shape = (len(series), *forward.outputs.shape)
    return PriorPredictive(np.array(draws), np.array(series).reshape(shape), dict(failures.most_common()))
