"""Parameters of a forward model, and their priors as values for PyMC, searches and tables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import log_ndtr, ndtri_exp

Array = NDArray[np.float64]


class ParameterError(ValueError):
    """A parameter or prior that is out of range or does not fit; its text says what to change."""


def log_normal_mass(low: Any, high: Any) -> Any:
    """log(Phi(high) - Phi(low)) of standard normal bounds, also far out in a tail."""
    a, b = log_normal_tails(low, high)
    return b + np.log1p(-np.exp(np.minimum(a - b, -1e-12)))


def log_normal_tails(low: Any, high: Any) -> tuple[Any, Any]:
    """log Phi of both ends; right of 0 those of their mirror images, since the left tail has the digits."""
    return log_ndtr(np.where(low > 0, -high, low)), log_ndtr(np.where(low > 0, -low, high))


# ---------------------------------------------------------------------------------------------------
# Priors


@dataclass(frozen=True)
class Prior:
    """What is known of a parameter before the data: a density on (low, high).

    Subclasses give the log-density with its first two derivatives, the PyMC variable, and draws.
    """

    @property
    def support(self) -> tuple[float, float]:
        """Lower and upper bound, in the parameter's unit."""
        raise NotImplementedError

    @property
    def depends_on(self) -> tuple[str, ...]:
        """Names of the parameters that this density is made of; a hierarchical prior has some."""
        return ()

    def log_density(self, x: Array, given: Mapping[str, Array]) -> float:
        """Sum over the elements of x of the log-density; `given` has the parameters it depends on."""
        raise NotImplementedError

    def curvature(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """First derivative of each element's log-density, and its negative second derivative."""
        raise NotImplementedError

    def dependence(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        """Derivatives with respect to the k parameters that a hierarchical prior depends on.

        Returns
        -------
        array (k,)
            First derivatives of the log-density.
        array (k, k)
            Negative second derivatives.
        array (size, k)
            Negative second derivatives with respect to each element of x and each of them.
        """
        raise NotImplementedError

    def variable(self, name: str, given: Mapping[str, Any], **settings: Any) -> Any:
        """The PyMC random variable, made inside a model's context."""
        raise NotImplementedError

    def draw(self, rng: np.random.Generator, size: int, given: Mapping[str, Array]) -> Array:
        """`size` independent draws."""
        raise NotImplementedError

    @property
    def median(self) -> float:
        """The median, where a search may start if nothing better is known."""
        raise NotImplementedError

    @property
    def text(self) -> str:
        """In words, such as "uniform in [0, 1]"."""
        raise NotImplementedError


@dataclass(frozen=True)
class Uniform(Prior):
    """Uniform on [low, high]."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ParameterError(
                f"uniform prior: bounds [{self.low}, {self.high}]: must be finite and ascend"
            )

    @property
    def support(self) -> tuple[float, float]:
        """Its two bounds."""
        return float(self.low), float(self.high)

    def log_density(self, x: Array, given: Mapping[str, Array]) -> float:
        """-log(high - low) for each element, whatever it is: the bounds are the search's to keep."""
        return -np.size(x) * math.log(self.high - self.low)

    def curvature(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Zero and zero."""
        return np.zeros(np.shape(x)), np.zeros(np.shape(x))

    def variable(self, name: str, given: Mapping[str, Any], **settings: Any) -> Any:
        """``pm.Uniform``."""
        import pymc as pm

        return pm.Uniform(name, self.low, self.high, **settings)

    def draw(self, rng: np.random.Generator, size: int, given: Mapping[str, Array]) -> Array:
        """`size` uniform draws."""
        return rng.uniform(self.low, self.high, size)

    @property
    def median(self) -> float:
        """The middle."""
        return 0.5 * (self.low + self.high)

    @property
    def text(self) -> str:
        """Such as "uniform in [0, 1]"."""
        return f"uniform in [{self.low:g}, {self.high:g}]"


@dataclass(frozen=True)
class LogUniform(Prior):
    """Uniform in the logarithm: p(x) = 1/(x log(high/low)) on [low, high], low > 0."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not 0 < self.low < self.high < math.inf:
            raise ParameterError(
                f"log-uniform prior: bounds [{self.low}, {self.high}]: must be positive, ascend"
            )

    @property
    def support(self) -> tuple[float, float]:
        """Its two bounds."""
        return float(self.low), float(self.high)

    def log_density(self, x: Array, given: Mapping[str, Array]) -> float:
        """Sum of -log x - log log(high/low)."""
        return float(np.sum(-np.log(x) - math.log(math.log(self.high / self.low))))

    def curvature(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """-1/x and -1/x^2."""
        x = np.asarray(x, dtype=np.float64)
        return -1.0 / x, -1.0 / x**2

    def variable(self, name: str, given: Mapping[str, Any], **settings: Any) -> Any:
        """``zoo.core.distributions.LogUniform``."""
        from zoo.core import distributions

        return distributions.LogUniform(name, self.low, self.high, **settings)

    def draw(self, rng: np.random.Generator, size: int, given: Mapping[str, Array]) -> Array:
        """Exponentials of uniform draws."""
        return np.asarray(np.exp(rng.uniform(math.log(self.low), math.log(self.high), size)))

    @property
    def median(self) -> float:
        """The geometric mean of the bounds."""
        return math.sqrt(self.low * self.high)

    @property
    def text(self) -> str:
        """Such as "log-uniform in [1, 500]"."""
        return f"log-uniform in [{self.low:g}, {self.high:g}]"


@dataclass(frozen=True)
class Normal(Prior):
    """Normal(mean, sd), truncated to [low, high] where these are finite."""

    mean: float
    sd: float
    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self) -> None:
        if not (0 < self.sd < math.inf and math.isfinite(self.mean) and self.low < self.high):
            raise ParameterError(
                f"normal prior: mean {self.mean}, sd {self.sd}, bounds [{self.low}, {self.high}]: the sd "
                "must be positive and the bounds ascend"
            )

    @property
    def support(self) -> tuple[float, float]:
        """Its two bounds."""
        return float(self.low), float(self.high)

    @property
    def _log_mass(self) -> float:
        low, high = ((bound - self.mean) / self.sd for bound in (self.low, self.high))
        return math.log(self.sd * math.sqrt(2.0 * math.pi)) + float(log_normal_mass(low, high))

    def log_density(self, x: Array, given: Mapping[str, Array]) -> float:
        """Of the truncated normal, as if x were inside the bounds."""
        z = (np.asarray(x) - self.mean) / self.sd
        return float(np.sum(-0.5 * z * z - self._log_mass))

    def curvature(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """-(x - mean)/sd^2 and 1/sd^2."""
        x = np.asarray(x, dtype=np.float64)
        return -(x - self.mean) / self.sd**2, np.full(x.shape, 1.0 / self.sd**2)

    def variable(self, name: str, given: Mapping[str, Any], **settings: Any) -> Any:
        """``pm.Normal``, or ``pm.TruncatedNormal`` where there are bounds."""
        import pymc as pm

        if math.isinf(self.low) and math.isinf(self.high):
            return pm.Normal(name, self.mean, self.sd, **settings)
        bounds = {k: v for k, v in (("lower", self.low), ("upper", self.high)) if math.isfinite(v)}
        return pm.TruncatedNormal(name, self.mean, self.sd, **bounds, **settings)

    def draw(self, rng: np.random.Generator, size: int, given: Mapping[str, Array]) -> Array:
        """By inversion of the distribution function, exact in the tails too."""
        low, high = ((bound - self.mean) / self.sd for bound in (self.low, self.high))
        log_a, log_b = log_normal_tails(low, high)
        u = rng.uniform(size=size)
        z = ndtri_exp(log_b + np.log(u + (1.0 - u) * np.exp(log_a - log_b)))
        return np.asarray(np.clip(self.mean + self.sd * (-z if low > 0 else z), self.low, self.high))

    @property
    def median(self) -> float:
        """The mean, moved inside the bounds."""
        return float(np.clip(self.mean, self.low, self.high))

    @property
    def text(self) -> str:
        """Such as "normal(0, 0.5) in [-1, 1]"."""
        bounded = math.isfinite(self.low) or math.isfinite(self.high)
        return f"normal({self.mean:g}, {self.sd:g})" + (
            f" in [{self.low:g}, {self.high:g}]" if bounded else ""
        )


@dataclass(frozen=True)
class InverseGamma(Prior):
    """Inverse gamma with a shape and a scale: p(x) proportional to x^(-shape - 1) exp(-scale/x), x > 0."""

    shape: float
    scale: float

    @property
    def support(self) -> tuple[float, float]:
        """Zero and infinity."""
        return 0.0, math.inf

    def log_density(self, x: Array, given: Mapping[str, Array]) -> float:
        """Sum of shape log scale - log Gamma(shape) - (shape + 1) log x - scale/x."""
        constant = self.shape * math.log(self.scale) - math.lgamma(self.shape)
        return float(np.sum(constant - (self.shape + 1) * np.log(x) - self.scale / np.asarray(x)))

    def curvature(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """-(shape + 1)/x + scale/x^2, and 2 scale/x^3 - (shape + 1)/x^2."""
        x = np.asarray(x, dtype=np.float64)
        slope = -(self.shape + 1) / x + self.scale / x**2
        return slope, 2 * self.scale / x**3 - (self.shape + 1) / x**2

    def variable(self, name: str, given: Mapping[str, Any], **settings: Any) -> Any:
        """``pm.InverseGamma``."""
        import pymc as pm

        return pm.InverseGamma(name, self.shape, self.scale, **settings)

    def draw(self, rng: np.random.Generator, size: int, given: Mapping[str, Array]) -> Array:
        """Scale over gamma draws."""
        return self.scale / rng.gamma(self.shape, size=size)

    @property
    def median(self) -> float:
        """The median, by the inverse of the regularised gamma function."""
        from scipy.stats import invgamma

        return float(invgamma.median(self.shape, scale=self.scale))

    @property
    def text(self) -> str:
        """Such as "inverse gamma (3, 7.78)"."""
        return f"inverse gamma ({self.shape:g}, {self.scale:g})"


@dataclass(frozen=True)
class Population(Prior):
    """Each element normal around a population's mean: x_i ~ N(m, (unit sqrt(v))^2), x_i > 0.

    Parameters
    ----------
    mean, variance : str
        Names of the parameters m and v.
    unit : float
        What the population's standard deviation is counted in, in the parameter's unit.
    """

    mean: str
    variance: str
    unit: float = 1.0

    @property
    def support(self) -> tuple[float, float]:
        """Zero and infinity: sampled and searched as a logarithm."""
        return 0.0, math.inf

    @property
    def depends_on(self) -> tuple[str, ...]:
        """Mean and variance of the population."""
        return self.mean, self.variance

    def _standard(self, given: Mapping[str, Array]) -> tuple[float, float]:
        return float(given[self.mean]), self.unit * math.sqrt(float(given[self.variance]))

    def log_density(self, x: Array, given: Mapping[str, Array]) -> float:
        """Sum of the elements' normal log-densities."""
        mean, sd = self._standard(given)
        z = (np.asarray(x) - mean) / sd
        return float(np.sum(-0.5 * z * z - math.log(sd * math.sqrt(2 * math.pi))))

    def curvature(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """-(x - m)/sd^2 and 1/sd^2."""
        mean, sd = self._standard(given)
        x = np.asarray(x, dtype=np.float64)
        return -(x - mean) / sd**2, np.full(x.shape, 1.0 / sd**2)

    def dependence(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        """With respect to m and v, where -log p = sum (x - m)^2/(2 unit^2 v) + n log(v)/2."""
        mean, sd = self._standard(given)
        v = float(given[self.variance])
        x = np.asarray(x, dtype=np.float64)
        z, n = (x - mean) / sd, len(x)
        first = np.array([np.sum(z) / sd, (np.sum(z * z) - n) / (2.0 * v)])
        mixed = np.sum(z) / (sd * v)
        second = np.array([[n / sd**2, mixed], [mixed, (np.sum(z * z) - 0.5 * n) / v**2]])
        cross = np.stack([np.full(n, -1.0 / sd**2), -z / (sd * v)], axis=1)
        return first, second, cross

    def variable(self, name: str, given: Mapping[str, Any], **settings: Any) -> Any:
        """``pm.Normal``, sampled as its logarithm."""
        import pymc as pm

        sd = self.unit * pm.math.sqrt(given[self.variance])
        return pm.Normal(name, given[self.mean], sd, transform=pm.distributions.transforms.log, **settings)

    def draw(self, rng: np.random.Generator, size: int, given: Mapping[str, Array]) -> Array:
        """Normal draws, those below zero drawn again."""
        mean, sd = self._standard(given)
        return Normal(mean, sd, 0.0).draw(rng, size, {})

    @property
    def median(self) -> float:
        """Not a number: that of the population."""
        return math.nan

    @property
    def text(self) -> str:
        """Such as "normal(m_chi, 10000 sqrt(v_chi))"."""
        return f"normal({self.mean}, {self.unit:g} sqrt({self.variance}))"


# ---------------------------------------------------------------------------------------------------
# Parameters


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

    @property
    def first(self) -> float:
        """Where a search begins."""
        return self.prior.median if self.start is None else float(self.start)

    @property
    def title(self) -> str:
        """For a table or an axis, with its unit."""
        text = self.label or self.name
        return text if self.unit == "1" else f"{text} ({self.unit})"


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
