"""What was learned of a component, as diagnosis.json has it: functions with bands, and their size."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from zoo.core.components import FreeFunction
from zoo.core.diagnosis.components.refining import Component, Kind
from zoo.core.diagnosis.file import LearnedFunction, Plausible

Array = NDArray[np.float64]
Judge = Callable[[FreeFunction, Array], tuple[bool, str]]

IMPLAUSIBLE = 2.5
"""Rms of a learned function, in its prior's scale, above which it is said that it can hardly be."""
TOLD_DIRECTIONS = 8
"""Directions that the data inform that are told at most."""


def learned_function(kind: Kind, probability: float) -> LearnedFunction:
    """Mean and 95 % band of a function's values, what the prior had, and what the data narrow.

    Parameters
    ----------
    kind : Kind
    probability : float
        Of this function among those of its component.
    """
    f, w = kind.function, kind.learned
    low, high = w.band()
    prior = f.size * np.sqrt(np.diag(f.correlation(w.best.length)))
    return LearnedFunction(
        name=f.name,
        argument=f.argument,
        argument_unit=f.argument_unit,
        unit=f.unit,
        values=_list(f.at),
        labels=list(f.labels),
        mean=_list(w.mean),
        low=_list(low),
        high=_list(high),
        prior_sd=_list(prior),
        location=f.location.part,
        equation=f.equation,
        size=w.size,
        prior_size=f.size,
        length=w.best.length,
        probability=probability,
        narrowed=[_list(one) for one in w.narrowed()[:TOLD_DIRECTIONS]],
        bent=w.block.bent if math.isfinite(w.block.bent) else None,
        beside=dict(zip(_names(kind), map(float, kind.fit.values), strict=False)),
    )


def _names(kind: Kind) -> list[str]:
    forward = kind.fit.forward
    return [p.name for p in forward.parameters[: forward.n_base]]


def _list(values: Array) -> list[float]:
    return [float(x) for x in values]


def functions_of(component: Component) -> list[LearnedFunction]:
    """All functions of a component, the most probable first."""
    z = np.array([k.log_z for k in component.kinds])
    weights = np.exp(z - z.max())
    weights /= weights.sum()
    ranked = sorted(zip(component.kinds, weights, strict=True), key=lambda x: -x[1])
    return [learned_function(kind, float(weight)) for kind, weight in ranked]


def expected(function: FreeFunction, values: Array) -> tuple[bool, str]:
    """Whether the values of a function are of the size that its prior expects, and a sentence about it."""
    rms, unit = math.sqrt(float(np.mean(values**2))), "" if function.unit == "1" else f" {function.unit}"
    why = f" ({function.why})" if function.why else ""
    text = (
        f"{function.name} would have an rms of {rms:.2g}{unit}, {rms / function.size:.1f} times the "
        f"{function.size:.2g}{unit} that is expected{why}"
    )
    return rms <= IMPLAUSIBLE * function.size, text


def plausible(kind: Kind, judge: Judge | None = None) -> Plausible:
    """Whether what was learned of a function can be believed, by a field's own judgement or by its prior."""
    value, why = (judge or expected)(kind.function, kind.learned.mean)
    return Plausible(value=value, why=why)
