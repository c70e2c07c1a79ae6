"""Derivatives of a forward model's series by its parameters, where it can give them.

A forward model that can has a method

    solve_derivatives(configure, theta, scales, outputs=None) -> (values, slopes)

with the series (n_series, n_times) of ``configure(theta)`` and their derivatives (n_values, n_series,
n_times) along each element of theta.  `configure` may be that of effects around the model, and `scales`
(n_values,) says over what a change of each element is small; an element of scale zero is not read, and its
slope is zero.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.core.arrays import Array
from zoo.core.forward import ForwardModel, Outputs, SolveError
from zoo.core.parameters import Parameter

SHARE_OF_PRIOR = 0.05
"""Of the prior's width, below which the size of an element says nothing about its scale."""


class Jacobian(NamedTuple):
    """A solve and its derivatives: values (n_series, n_times), slopes (n_values, n_series, n_times)."""

    values: Array
    slopes: Array


def has_jacobian(model: ForwardModel) -> bool:
    """Whether a forward model, or the one that effects were added to, gives derivatives."""
    return callable(getattr(model, "solve_derivatives", None))


def jacobian(model: ForwardModel, theta: ArrayLike, outputs: Outputs | None = None) -> Jacobian | None:
    """Series of a forward model and their derivatives by each element of theta.

    Parameters
    ----------
    model : ForwardModel
        Itself or with effects.
    theta : array (n_values,)
    outputs : Outputs
        The observed ones if absent.

    Returns
    -------
    Jacobian or None
        None where the model gives no derivatives.

    Raises
    ------
    SolveError
        If the solve, or its derivatives, fail.
    """
    if not has_jacobian(model):
        return None
    at = np.array(theta, dtype=np.float64)
    differentiate: Callable[..., Any] = model.solve_derivatives  # type: ignore[attr-defined]
    values, slopes = differentiate(model.configure, at, scales_of(model.parameters, at), outputs)
    found = Jacobian(np.asarray(values, dtype=np.float64), np.asarray(slopes, dtype=np.float64))
    shape = (outputs or model.outputs).shape
    if found.values.shape != shape or found.slopes.shape != (len(at), *shape):
        raise ValueError(
            f"{model.name}: series {found.values.shape} and slopes {found.slopes.shape}, wanted {shape} and "
            f"{(len(at), *shape)}"
        )
    if not (np.all(np.isfinite(found.values)) and np.all(np.isfinite(found.slopes))):
        raise SolveError(f"{model.name}: the solution or its derivatives are not finite", "not-finite")
    return found


def scales_of(parameters: tuple[Parameter, ...], theta: Array) -> Array:
    """Over what a change of each element of theta is small.

    It is the element's size; a part of its prior's width, if that is more, where the prior goes below zero or
    the element is zero.

    Parameters
    ----------
    parameters : tuple of Parameter
    theta : array (n_values,)

    Returns
    -------
    array (n_values,)
        Zero for those that only priors read.
    """
    return scales_at(np.asarray(theta), *widths_of(parameters))


def widths_of(parameters: tuple[Parameter, ...]) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """Of each element a part of its prior's width, whether that goes below zero, and whether it is read.

    Parameters
    ----------
    parameters : tuple of Parameter

    Returns
    -------
    width, about_zero, read : array (n_values,)
    """
    widths, about_zero = [], []
    for p in parameters:
        try:
            low, high = p.prior.quantile([0.16, 0.84])
            width, below = SHARE_OF_PRIOR * float(high - low) / 2, p.prior.support[0] < 0
        except (KeyError, NotImplementedError, TypeError):  # a prior that depends on other parameters
            width, below = 0.0, False
        widths += [width if np.isfinite(width) else 0.0] * p.size
        about_zero += [below] * p.size
    read = np.concatenate([np.full(p.size, not p.hyper) for p in parameters])
    return np.array(widths), np.array(about_zero, dtype=bool), read


def scales_at(theta: Array, width: Array, about_zero: NDArray[np.bool_], read: NDArray[np.bool_]) -> Array:
    """`scales_of` from `widths_of`; of functions that numba compiles."""
    least = np.where(about_zero | (theta == 0), width, 0.0)
    found = np.where(read, np.maximum(least, np.abs(theta)), 0.0)
    return np.where(read & (found == 0), 1.0, found)
