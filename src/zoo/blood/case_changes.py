"""The changes of a case that a parameter makes, along which its series are differentiated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np

from zoo.blood.case import Case, Stencil, same_run
from zoo.blood.solve_errors import NoDerivativeError
from zoo.core.arrays import Array
from zoo.core.forward import SolveError

NEAR, FAR = 1e-5, 1e-3
"""Steps of differences, over the scale of a parameter: where it changes stiffness, shapes and loads alone;
and, with stencils of fourth order, where it changes more."""
OFF = 3e-5
"""How far a parameter is moved off zero, over its scale, where what it adds is absent at zero."""


def additions(case: Case) -> tuple[object, ...]:
    """What a case has and another may lack: waves, settings, responses, functions, terms in each vessel."""

    def there(term: Any) -> object:
        if isinstance(term, np.ndarray):
            return term.shape, term.astype(bool).tobytes()
        return getattr(term, "changes", None)

    terms = (there(getattr(case.physics, f.name)) for f in fields(case.physics))
    response = there(case.network.response_cosine)
    return bool(case.waves), case.options, case.conventions, response, *terms


def off_zero(configure: Callable[[Array], Case], case: Case, theta: Array, scales: Array) -> Array:
    """Theta with its zeros moved a little where what they add is absent at zero.

    A solve without a term is another run than one with little of it, that may have other state variables: the
    difference of one time step of both is no derivative.

    Parameters
    ----------
    configure : function
        From theta to a case.
    case : Case
        ``configure(theta)``.
    theta, scales : array (n_values,)
        Over what a change of each element is small; zero for those that no solve reads.

    Returns
    -------
    array (n_values,)
        `theta` itself where nothing is absent.
    """
    at, there = theta, additions(case)
    for i in np.flatnonzero((theta == 0) & (scales > 0)):
        for step in (OFF * scales[i], -OFF * scales[i]):
            moved = at.copy()
            moved[i] = step
            try:
                near = additions(configure(moved))
            except (SolveError, ValueError):
                continue
            if near != there:
                at, there = moved, near
            break
    return at


def stencil_of(configure: Callable[[Array], Case], case: Case, theta: Array, i: int, scale: float) -> Stencil:
    """The change of a case along element i of theta.

    Parameters
    ----------
    configure : function
        From theta to a case.
    case : Case
        ``configure(theta)``.
    theta : array (n_values,)
    i : int
    scale : float
        Over which its change is small.

    Returns
    -------
    Stencil
        Central differences, or one-sided ones of second order where the parameter ends.

    Raises
    ------
    NoDerivativeError
        If the numerical settings or the wall law change with it, or it can be changed to neither side.
    """

    def at(step: float) -> Case:
        moved = theta.copy()
        moved[i] += step
        found = configure(moved)
        if found.wall != case.wall or found.options != case.options or found.conventions != case.conventions:
            raise NoDerivativeError(
                f"parameter {i}: the grid, the conventions or the wall change with it: it has no derivative; "
                "sample without gradients"
            )
        return found

    def tried(steps: tuple[float, ...]) -> tuple[Case, ...] | None:
        try:
            return tuple(at(step) for step in steps)
        except NoDerivativeError:
            raise
        except (SolveError, ValueError):
            return None

    h = NEAR * scale
    two = tried((h, -h))
    if two and all(same_run(case, one) for one in two):
        return Stencil((h, -h), (0.5 / h, -0.5 / h), two)
    h = FAR * scale
    steps: tuple[float, ...] = (h, -h, 2 * h, -2 * h)
    if four := tried(steps):
        return Stencil(steps, tuple(w / (12 * h) for w in (8.0, -8.0, -1.0, 1.0)), four)
    for side in (0.1 * h, -0.1 * h):
        steps = (side, 2 * side, 3 * side)
        if three := tried(steps):
            return Stencil(steps, tuple(w / (2 * side) for w in (-5.0, 8.0, -3.0)), three)
    raise NoDerivativeError(
        f"parameter {i} = {theta[i]:.6g}: can be changed to neither side; keep it away from the ends of its "
        "range"
    )
