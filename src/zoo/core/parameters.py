"""Parameters of a forward model: name, unit, prior and start, and theta as the vector of their values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from zoo.core.arrays import Array
from zoo.core.priors import FrozenPrior as FrozenPrior
from zoo.core.priors import InverseGamma as InverseGamma
from zoo.core.priors import LogNormal as LogNormal
from zoo.core.priors import LogPopulation as LogPopulation
from zoo.core.priors import LogUniform as LogUniform
from zoo.core.priors import Normal as Normal
from zoo.core.priors import ParameterError as ParameterError
from zoo.core.priors import Population as Population
from zoo.core.priors import Prior as Prior
from zoo.core.priors import Uniform as Uniform
from zoo.core.priors import as_prior as as_prior
from zoo.core.priors import log_normal_mass as log_normal_mass
from zoo.core.priors import log_normal_tails as log_normal_tails


@dataclass(frozen=True)
class Parameter:
    """A free number of a forward model, or a vector of them.

    Parameters
    ----------
    name : str
        Unique in its model; also the name of the PyMC variable.
    prior : Prior
    unit : str
        "1" for a pure number.
    start : float, optional
        Where a search begins, one value for all elements; the prior's median if absent.
    label : str
        For tables and axes; the name if empty.
    log : bool
        Whether a search steps in its logarithm, which leaves the prior as it is.
    power : float, optional
        Power of it in which solutions are most nearly linear, 0 for its logarithm: a surrogate in place of
        the forward model is made in it. Of a stiffness -1/2, for so goes the time a wave travels. If
        absent the logarithm where `log`, else the parameter itself.
    dims : str
        Name of the dimension of a vector, such as "vessel"; empty for a number.
    size : int
        Elements.
    hyper : bool
        Whether only the priors of others depend on it and no solution does, as a population's mean.
    """

    name: str
    prior: Prior
    unit: str = "1"
    start: float | None = None
    label: str = ""
    log: bool = False
    dims: str = ""
    size: int = 1
    hyper: bool = False
    power: float | None = None

    def __post_init__(self) -> None:
        if self.power not in (None, 1.0) and self.prior.support[0] < 0.0:
            raise ParameterError(
                f"parameter {self.name}: power = {self.power:g}, but its prior {self.prior.text} reaches "
                "below 0; leave the power out"
            )

    @property
    def response(self) -> float:
        """The power of it that a surrogate takes, 0 for its logarithm."""
        return (0.0 if self.log else 1.0) if self.power is None else float(self.power)

    @property
    def first(self) -> float:
        """Where a search begins."""
        return self.prior.median if self.start is None else float(self.start)


def as_parameters(priors: Mapping[str, Any]) -> tuple[Parameter, ...]:
    """Parameters from priors by name: each a prior, a frozen distribution of SciPy, or a `Parameter`.

    Raises
    ------
    ParameterError
        If one is none of these, or a `Parameter` has another name.
    """
    if not isinstance(priors, Mapping):
        raise ParameterError(
            f"priors = {priors!r:.80}: give a dict by name of parameter, such as {{'k': zoo.Normal(80, 5)}}"
        )
    found = []
    for name, given in priors.items():
        p = given if isinstance(given, Parameter) else Parameter(name, as_prior(given, name))
        if p.name != name:
            raise ParameterError(f"prior {name!r} is of a parameter named {p.name!r}: give both one name")
        found.append(p)
    return tuple(found)


def n_values(parameters: Iterable[Parameter]) -> int:
    """Length of theta."""
    return sum(p.size for p in parameters)


def unpack(parameters: Sequence[Parameter], theta: ArrayLike) -> dict[str, Array]:
    """Theta by name: a scalar array for a number, (size,) for a vector.

    Parameters
    ----------
    parameters : sequence of Parameter
    theta : array (n_values,)
        In their order.

    Returns
    -------
    dict

    Raises
    ------
    ParameterError
        If theta has another length.
    """
    values = np.asarray(theta, dtype=np.float64)
    if values.shape != (n_values(parameters),):
        names = ", ".join(p.name + (f" ({p.size})" if p.dims else "") for p in parameters)
        raise ParameterError(f"{values.size} values for {n_values(parameters)}: give {names}")
    found, at = {}, 0
    for p in parameters:
        part = values[at : at + p.size]
        found[p.name] = part if p.dims else part[0]
        at += p.size
    return found


def pack(parameters: Sequence[Parameter], values: Mapping[str, ArrayLike]) -> Array:
    """Theta (n_values,) from values by name; one value may stand for all elements of a vector.

    Raises
    ------
    ParameterError
        If a parameter is missing, unknown or of another length.
    """
    names = [p.name for p in parameters]
    if set(values) != set(names):
        wrong = sorted(set(values) ^ set(names))
        raise ParameterError(f"parameters {', '.join(wrong)}: missing or unknown; give {', '.join(names)}")
    parts = []
    for p in parameters:
        value = np.asarray(values[p.name], dtype=np.float64)
        if value.size not in (1, p.size):
            raise ParameterError(f"{p.name} has {value.size} values: give 1 or {p.size}")
        parts.append(np.broadcast_to(value.ravel(), (p.size,)))
    return np.concatenate(parts) if parts else np.zeros(0)


def start_of(parameters: Sequence[Parameter]) -> dict[str, Array]:
    """Where a search begins, by name; a population's elements begin at its mean."""
    found: dict[str, Array] = {}
    for p in parameters:
        value = p.first
        if math.isnan(value):
            value = float(found[p.prior.depends_on[0]])
        found[p.name] = np.full(p.size, value) if p.dims else np.asarray(value)
    return found


def log_prior(parameters: Sequence[Parameter], theta: ArrayLike) -> float:
    """Log prior density of theta; -inf outside the bounds."""
    values = unpack(parameters, theta)
    total = 0.0
    for p in parameters:
        low, high = p.prior.support
        x = values[p.name]
        if not np.all((x >= low) & (x <= high)):
            return -math.inf
        total += p.prior.log_density(x, values)
    return total


def draw_prior(parameters: Sequence[Parameter], rng: np.random.Generator) -> Array:
    """One draw of theta (n_values,) from the priors, those that others depend on first."""
    found: dict[str, Array] = {}
    for p in parameters:
        value = p.prior.draw(rng, p.size, found)
        found[p.name] = value if p.dims else value[0]
    return pack(parameters, found)


def random_variables(parameters: Sequence[Parameter]) -> dict[str, Any]:
    """PyMC variables of parameters, made inside a model's context, by name.

    Their names in the model are those of the parameters, with what a NetCDF file does not take replaced
    by `variable_name`.
    """
    made: dict[str, Any] = {}
    for p in parameters:
        settings = {"dims": p.dims} if p.dims else {}
        made[p.name] = p.prior.variable(variable_name(p.name), made, **settings)
    return made


def variable_name(name: str) -> str:
    """A parameter's name as a variable of a model and of a file: no slash."""
    return name.replace("/", " per ")
