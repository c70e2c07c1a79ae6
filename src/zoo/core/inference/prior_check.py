"""What a posterior says of its prior: on which bounds it leans, and what the data do not inform."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from zoo.core.arrays import Array
from zoo.core.arviz_lines import effective, split_rhat
from zoo.core.effects import WithEffects
from zoo.core.inference.elements import scalars
from zoo.core.inference.record import ResultsError
from zoo.core.parameters import LogNormal, LogUniform, Parameter, Prior, pack, variable_name

OUTER = 0.01
"""Part of a prior's mass at each end in which a posterior is counted."""
NEAR = 0.05
"""Part of the way from a bound to the prior's median beyond which nothing leans on it."""
LEANING = 5.0
"""A posterior with more than this many times the prior's mass there leans on the bound."""
BINS = 10
"""Parts of equal prior mass over which a posterior is compared with its prior."""
UNINFORMED = 0.05
"""Nats below which a parameter is not informed: what a normal posterior of 0.79 of its prior's sd has."""
LEAST_ESS = 100.0
"""Effective draws below which nothing is said of what the data inform."""
MOST_RHAT = 1.1
"""R-hat above which chains have not met, so that nothing is said either."""


@dataclass(frozen=True)
class AtBound:
    """A parameter that stands at, or leans on, a bound of its prior.

    Parameters
    ----------
    parameter : str
        Such as `c` or `chi[3]`.
    side : str
        "lower" or "upper".
    bound : float
        In the parameter's unit.
    unit : str
    share : float or None
        Part of the draws in the prior's outer 1 %; None for a mode.
    """

    parameter: str
    side: str
    bound: float
    unit: str
    share: float | None = None

    @property
    def place(self) -> str:
        """Such as "stiffness at 1e+05 g cm-1 s-2"."""
        return f"{self.parameter} at {self.bound:g} {self.unit}".removesuffix(" 1")

    @property
    def text(self) -> str:
        """What is wrong and what lifts it, without a full stop."""
        bound = f"the {self.side} bound of its prior, {self.bound:g} {self.unit}".removesuffix(" 1")
        what = f"the mode of {self.parameter} stands at {bound}"
        if self.share is not None:
            part = f"{self.share:.0%} of its draws in the outer 1 % of the prior"
            what = f"{self.parameter} leans on {bound}, with {part}"
        name = self.parameter.partition("[")[0]
        return f"{what}: --prior {name}=..., or priors={{{name!r}: ...}}, lifts it"


@dataclass(frozen=True)
class PriorCheck:
    """Where a posterior leans on its prior, and what it does not add to it.

    Parameters
    ----------
    bounds : tuple of AtBound
    uninformed : tuple of str
        Scalars whose posterior is like their prior.
    numerical : str
        What the forward model says of its exactness at the mode; empty if nothing.
    """

    bounds: tuple[AtBound, ...] = ()
    uninformed: tuple[str, ...] = ()
    numerical: str = ""

    @property
    def warnings(self) -> list[str]:
        """One for each bound, without a full stop."""
        return [found.text for found in self.bounds]

    def as_dict(self) -> dict[str, Any]:
        """Fit for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, given: Mapping[str, Any]) -> PriorCheck:
        """Read back from `as_dict`.

        Raises
        ------
        ResultsError
            If it is something else.
        """
        try:
            bounds = tuple(AtBound(**found) for found in given["bounds"])
            uninformed = tuple(str(name) for name in given["uninformed"])
            return cls(bounds, uninformed, str(given.get("numerical", "")))
        except (TypeError, KeyError) as error:
            raise ResultsError(
                f"run record: prior_check is not readable ({error}); sample again to get a record"
            ) from None


def edges(prior: Prior) -> tuple[float | None, float | None]:
    """Where the outer 1 % of a prior begins at its lower and its upper bound; None where it has no bound.

    That is its 1 % or 99 % quantile, but no further from the bound than a twentieth of the way to the median
    (2 % are the same for a flat prior): the tail of a normal far inside its bounds is not a bound. Zero is
    none either where the prior has no upper end: there positive numbers end, and nothing can be widened.

    Parameters
    ----------
    prior : Prior

    Returns
    -------
    low, high : float or None
        In the parameter's unit.
    """
    if prior.depends_on:
        return None, None
    low, high = prior.support
    logarithmic = isinstance(prior, LogUniform | LogNormal)
    found: list[float | None] = []
    for bound, p in ((low, OUTER), (high, 1.0 - OUTER)):
        if not math.isfinite(bound) or (bound == 0.0 and (math.isinf(high) or logarithmic)):
            found.append(None)
            continue
        quantile, middle = float(prior.quantile(p)), float(prior.quantile(0.5))
        near = bound * (middle / bound) ** NEAR if logarithmic else bound + NEAR * (middle - bound)
        found.append(min(quantile, near) if bound == low else max(quantile, near))
    return found[0], found[1]


def priors_of(model: Any) -> tuple[tuple[Parameter, ...], frozenset[str]]:
    """Parameters of a model with a record, and the names of those that are an effect's; else nothing."""
    from zoo.core.model import ModelRecord  # PyMC is slow to load, and a diagnosis does not need it

    record = getattr(model, "zoo", None)
    if not isinstance(record, ModelRecord):
        return (), frozenset()
    added = record.forward.added if isinstance(record.forward, WithEffects) else ()
    names = frozenset(p.name for one in added for p in one.parameters)
    return (*record.forward.parameters, *record.errors.parameters), names


def model_check(model: Any, draws: Mapping[str, Array]) -> PriorCheck | None:
    """What `check_priors` says of a model's draws; None without a record."""
    parameters, effects = priors_of(model)
    return check_priors(parameters, draws, effects=effects) if parameters else None


def exactness_at(model: Any, values: Mapping[str, Any]) -> str:
    """What a model's forward model says of its exactness at values of the variables; empty if nothing."""
    from zoo.core.model import ModelRecord

    record = getattr(model, "zoo", None)
    forward = record.forward if isinstance(record, ModelRecord) else None
    if forward is None or not hasattr(forward, "warning_at"):
        return ""
    theta = pack(forward.parameters, {p.name: values[variable_name(p.name)] for p in forward.parameters})
    return str(forward.warning_at(forward.configure(theta)))


def check_priors(
    parameters: Sequence[Parameter],
    draws: Mapping[str, Array],
    *,
    effects: Iterable[str] = (),
) -> PriorCheck:
    """Compare draws of a posterior with the priors of its parameters.

    A parameter leans on a finite bound if the outer 1 % of its prior there (`edges`) holds more than 5 % of
    the draws. It is not informed by the data if

        sum_k p_k log(10 p_k) - 9/(2 ESS) < 0.05,

    p_k the share of the draws in the k-th tenth of its prior's mass: the posterior's information over its
    prior, less what it would be by chance. Below an effective sample size of 100, or above an R-hat of 1.1,
    nothing is said.

    Parameters
    ----------
    parameters : sequence of Parameter
    draws : mapping
        Variable -> array (n_chains, n_draws), or (n_chains, n_draws, size) of a vector.
    effects : iterable of str
        Names of parameters that are an effect's; their bound 0 is the model without it, no limit.

    Returns
    -------
    PriorCheck
    """
    bounds: list[AtBound] = []
    uninformed: list[str] = []
    without = frozenset(effects)
    for p in parameters:
        name = variable_name(p.name)
        if name not in draws or p.prior.depends_on:
            continue
        values = np.asarray(draws[name], dtype=np.float64)
        ends = _ends(p, without)
        for label, x in scalars({name: values}):
            if x.size == 0 or np.all(x == x.flat[0]):
                continue
            for side, bound, edge in ends:
                share = float(np.mean(x <= edge if side == "lower" else x >= edge))
                if share > LEANING * OUTER:
                    bounds.append(AtBound(label, side, bound, p.unit, share))
            if x.shape[0] < 2 or x.shape[1] < 4:
                continue
            inner = p.prior.quantile(np.arange(1, BINS) / BINS)
            part = np.bincount(np.searchsorted(inner, x.ravel()), minlength=BINS) / x.size
            information = float(np.sum(part * np.log(np.where(part > 0.0, BINS * part, 1.0))))
            if information > 2.0 * UNINFORMED:  # by far the most are; spares the rest of the work
                continue
            ess = effective(x)
            by_chance = (BINS - 1) / (2.0 * ess)
            settled = ess >= LEAST_ESS and split_rhat(x) <= MOST_RHAT
            if settled and information - by_chance < UNINFORMED:
                uninformed.append(label)
    return PriorCheck(tuple(bounds), tuple(uninformed))


def _ends(p: Parameter, effects: frozenset[str]) -> list[tuple[str, float, float]]:
    """Side, bound and edge of each end of a prior that is a limit."""
    return [
        (side, bound, edge)
        for side, bound, edge in zip(("lower", "upper"), p.prior.support, edges(p.prior), strict=True)
        if edge is not None and not (bound == 0.0 and p.name in effects)
    ]


def modes_at_bounds(
    parameters: Sequence[Parameter], values: Mapping[str, Any], *, effects: Iterable[str] = ()
) -> tuple[AtBound, ...]:
    """Parameters whose mode stands within a tenth of the outer 1 % of their prior at a bound.

    Parameters
    ----------
    parameters : sequence of Parameter
    values : mapping
        Variable -> number, or array (size,) of a vector, at the mode.
    effects : iterable of str
        As in `check_priors`.

    Returns
    -------
    tuple of AtBound
    """
    found = []
    without = frozenset(effects)
    for p in parameters:
        name = variable_name(p.name)
        if name not in values or p.prior.depends_on:
            continue
        x = np.atleast_1d(np.asarray(values[name], dtype=np.float64))
        for side, bound, edge in _ends(p, without):
            for i in np.flatnonzero(np.abs(x - bound) <= 0.1 * abs(edge - bound)):
                found.append(AtBound(f"{name}[{i}]" if p.dims else name, side, bound, p.unit))
    return tuple(found)
