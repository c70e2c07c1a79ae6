"""Priors as values: the same ones make PyMC variables, searches, draws and tables."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from zoo.core.arrays import Array
from zoo.core.draws import LARGEST_DRAW, inverse_gamma_draws

_LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)
DIFFERENCE, KNOTS = 1e-3, 2001
"""Step of differences of a log-density, in sds; quantiles between which a PyMC variable interpolates."""


class ParameterError(ValueError):
    """A parameter or prior that is out of range or does not fit; its text says what to change."""


def log_normal_mass(low: Any, high: Any) -> Any:
    """log(Phi(high) - Phi(low)) of standard normal bounds, also far out in a tail."""
    a, b = log_normal_tails(low, high)
    return b + np.log1p(-np.exp(np.minimum(a - b, -1e-12)))


def log_normal_tails(low: Any, high: Any) -> tuple[Any, Any]:
    """log Phi of both ends; right of 0 those of their mirror images, since the left tail has the digits."""
    from scipy.special import log_ndtr  # late: names of effects are completed without SciPy

    return log_ndtr(np.where(low > 0, -high, low)), log_ndtr(np.where(low > 0, -low, high))


@lru_cache(1024)
def _law(name: str, *shapes: float, loc: float = 0.0, scale: float = 1.0) -> Any:
    """SciPy's distribution of that name; making one takes longer than a solution of a small tree."""
    from scipy import stats  # slow to load

    return getattr(stats, name)(*shapes, loc=loc, scale=scale)


# ---------------------------------------------------------------------------------------------------
# Priors


@dataclass(frozen=True)
class Prior:
    """What is known of a parameter before the data: a density on (low, high).

    Subclasses give its `law`, the log-density with its first two derivatives, and the PyMC variable.
    """

    @property
    def support(self) -> tuple[float, float]:
        """Bounds, in the parameter's unit: `low` and `high`, or 0 and infinity where it has none."""
        return float(getattr(self, "low", 0.0)), float(getattr(self, "high", math.inf))

    @property
    def depends_on(self) -> tuple[str, ...]:
        """Names of the parameters that this density is made of; a hierarchical prior has some."""
        return ()

    @property
    def law(self) -> Any:
        """The distribution of `scipy.stats`; a prior that has none gives `quantile` itself."""
        raise NotImplementedError

    def log_density(self, x: Array, given: Mapping[str, Array]) -> float:
        """Sum over the elements of x of the log-density, as if x were inside the bounds.

        These are a search's to keep. `given` has the parameters that a hierarchical prior depends on.
        """
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
        """`size` independent draws: quantiles of uniform numbers."""
        return self.quantile(rng.uniform(size=size), given)

    def quantile(self, p: ArrayLike, given: Mapping[str, Array] | None = None) -> Array:
        """Values below which the prior has mass p.

        Parameters
        ----------
        p : array
            Between 0 and 1.
        given : mapping
            The parameters that a hierarchical prior depends on.

        Returns
        -------
        array
            Of p's shape, in the parameter's unit.
        """
        with np.errstate(divide="ignore"):  # a quantile beyond the largest double is infinite
            return np.asarray(np.clip(self.law.ppf(p), *self.support))

    @property
    def median(self) -> float:
        """The median, where a search may start if nothing better is known."""
        return float(self.quantile(0.5))

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
    def law(self) -> Any:
        """``scipy.stats.uniform``."""
        return _law("uniform", loc=self.low, scale=self.high - self.low)

    def log_density(self, x: Array, given: Mapping[str, Array]) -> float:
        """-log(high - low) for each element."""
        return -np.size(x) * math.log(self.high - self.low)

    def curvature(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Zero and zero."""
        return np.zeros(np.shape(x)), np.zeros(np.shape(x))

    def variable(self, name: str, given: Mapping[str, Any], **settings: Any) -> Any:
        """``pm.Uniform``."""
        import pymc as pm

        return pm.Uniform(name, self.low, self.high, **settings)

    @property
    def text(self) -> str:
        """Such as "uniform in [0, 1]"."""
        return f"uniform in [{self.low:g}, {self.high:g}]"


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
    def bounded(self) -> bool:
        """Whether one of the bounds is finite."""
        return math.isfinite(self.low) or math.isfinite(self.high)

    @property
    def limits(self) -> tuple[float, float]:
        """Bounds of (x - mean)/sd."""
        return (self.low - self.mean) / self.sd, (self.high - self.mean) / self.sd

    @property
    def law(self) -> Any:
        """``scipy.stats.norm``, or ``scipy.stats.truncnorm`` where there are bounds."""
        name, shapes = ("truncnorm", self.limits) if self.bounded else ("norm", ())
        return _law(name, *shapes, loc=self.mean, scale=self.sd)

    def log_density(self, x: Array, given: Mapping[str, Array]) -> float:
        """Sum of -z^2/2 - log(sd sqrt(2 pi)) - log(mass inside the bounds), z = (x - mean)/sd."""
        z = (np.asarray(x) - self.mean) / self.sd
        return float(np.sum(-0.5 * z * z - self._log_size))

    @cached_property
    def _log_size(self) -> float:
        return math.log(self.sd) + _LOG_ROOT_2PI + float(log_normal_mass(*self.limits))

    def curvature(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """-(x - mean)/sd^2 and 1/sd^2."""
        x = np.asarray(x, dtype=np.float64)
        return -(x - self.mean) / self.sd**2, np.full(x.shape, 1.0 / self.sd**2)

    def variable(self, name: str, given: Mapping[str, Any], **settings: Any) -> Any:
        """``pm.Normal``, or ``pm.TruncatedNormal`` where there are bounds."""
        import pymc as pm

        if not self.bounded:
            return pm.Normal(name, self.mean, self.sd, **settings)
        bounds = {k: v for k, v in (("lower", self.low), ("upper", self.high)) if math.isfinite(v)}
        return pm.TruncatedNormal(name, self.mean, self.sd, **bounds, **settings)

    @property
    def median(self) -> float:
        """The mean if it lies inside the bounds, else the median between these."""
        return self.mean if self.low < self.mean < self.high else super().median

    @property
    def text(self) -> str:
        """Such as "normal(0, 0.5) in [-1, 1]"."""
        within = f" in [{self.low:g}, {self.high:g}]" if self.bounded else ""
        return f"normal({self.mean:g}, {self.sd:g}){within}"


@dataclass(frozen=True)
class _Exponential(Prior):
    """The prior of a positive number whose logarithm has another one, `log_prior`."""

    @property
    def log_prior(self) -> Uniform | Normal:
        """Of the logarithm."""
        raise NotImplementedError

    def log_density(self, x: Array, given: Mapping[str, Array]) -> float:
        """That of the logarithm, less log x."""
        log_x = np.log(x)
        return self.log_prior.log_density(log_x, given) - float(np.sum(log_x))

    def curvature(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """(s - 1)/x and (c + s - 1)/x^2, s and c those of the logarithm."""
        x = np.asarray(x, dtype=np.float64)
        slope, curvature = self.log_prior.curvature(np.log(x), given)
        return (slope - 1.0) / x, (curvature + slope - 1.0) / x**2

    def quantile(self, p: ArrayLike, given: Mapping[str, Array] | None = None) -> Array:
        """Exponentials of those of the logarithm."""
        return np.asarray(np.clip(np.exp(self.log_prior.quantile(p)), *self.support))


@dataclass(frozen=True)
class LogUniform(_Exponential):
    """Uniform in the logarithm: p(x) = 1/(x log(high/low)) on [low, high], low > 0."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not 0 < self.low < self.high < math.inf:
            raise ParameterError(
                f"log-uniform prior: bounds [{self.low}, {self.high}]: must be positive, ascend"
            )

    @property
    def log_prior(self) -> Uniform:
        """Uniform between the logarithms of the bounds."""
        return Uniform(math.log(self.low), math.log(self.high))

    def variable(self, name: str, given: Mapping[str, Any], **settings: Any) -> Any:
        """`zoo.core.distributions.LogUniform`, sampled as the logit of where its logarithm is."""
        import pytensor.tensor as pt
        from pymc.distributions.transforms import Chain, Interval, log

        from zoo.core.distributions import LogUniform as Variable

        between = Interval(bounds_fn=lambda *inputs: (pt.log(inputs[-2]), pt.log(inputs[-1])))
        return Variable(name, self.low, self.high, default_transform=Chain([log, between]), **settings)

    @property
    def text(self) -> str:
        """Such as "log-uniform in [1, 500]"."""
        return f"log-uniform in [{self.low:g}, {self.high:g}]"


@dataclass(frozen=True)
class LogNormal(_Exponential):
    """Log-normal: log x ~ N(log centre, spread^2), truncated to (low, high)."""

    centre: float
    spread: float
    low: float = 0.0
    high: float = math.inf

    def __post_init__(self) -> None:
        good = 0 < self.centre < math.inf and 0 < self.spread < math.inf and 0 <= self.low < self.high
        if not good:
            raise ParameterError(
                f"log-normal prior: median {self.centre}, sd of the logarithm {self.spread}, bounds "
                f"[{self.low}, {self.high}]: the first two must be positive and the bounds ascend from 0 up"
            )

    @cached_property
    def log_prior(self) -> Normal:
        """The truncated normal one."""
        low = math.log(self.low) if self.low > 0 else -math.inf
        return Normal(math.log(self.centre), self.spread, low, math.log(self.high))

    def variable(self, name: str, given: Mapping[str, Any], **settings: Any) -> Any:
        """``pm.LogNormal``, or `zoo.core.distributions.TruncatedLogNormal` where there are bounds."""
        import pymc as pm
        from pymc.distributions.transforms import Interval

        from zoo.core.distributions import TruncatedLogNormal

        of_logarithm = self.log_prior
        mean, limits = math.log(self.centre), (of_logarithm.low, of_logarithm.high)
        if not of_logarithm.bounded:
            return pm.LogNormal(name, mean, self.spread, **settings)
        between = Interval(self.low, self.high if math.isfinite(self.high) else None)
        return TruncatedLogNormal(name, mean, self.spread, *limits, default_transform=between, **settings)

    @property
    def median(self) -> float:
        """The centre if it lies inside the bounds, else the median between these."""
        return self.centre if self.low < self.centre < self.high else super().median

    @property
    def text(self) -> str:
        """Such as "log-normal(0.05, 0.5)", with the bounds if they leave out more than 1 % of it."""
        whole = float(np.exp(log_normal_mass(*self.log_prior.limits)))
        within = f" in [{self.low:g}, {self.high:g}]" if whole < 0.99 else ""
        return f"log-normal({self.centre:g}, {self.spread:g}){within}"


@dataclass(frozen=True)
class InverseGamma(Prior):
    """Inverse gamma with a shape and a scale: p(x) proportional to x^(-shape - 1) exp(-scale/x), x > 0."""

    shape: float
    scale: float

    def __post_init__(self) -> None:
        if not (0 < self.shape < math.inf and 0 < self.scale < math.inf):
            raise ParameterError(
                f"inverse-gamma prior: shape {self.shape}, scale {self.scale}: must be positive"
            )

    @property
    def law(self) -> Any:
        """``scipy.stats.invgamma``, whose quantiles are infinite where no double is large enough."""
        return _law("invgamma", self.shape, scale=self.scale)

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
        """``zoo.core.distributions.InverseGamma``, which can be drawn from however vague it is."""
        from zoo.core.distributions import InverseGamma as Variable

        return Variable(name, self.shape, self.scale, **settings)

    def draw(self, rng: np.random.Generator, size: int, given: Mapping[str, Array]) -> Array:
        """Of `inverse_gamma_draws`."""
        return inverse_gamma_draws(rng, self.shape, self.scale, size)

    @property
    def median(self) -> float:
        """The median, at most `LARGEST_DRAW`."""
        return min(super().median, LARGEST_DRAW)

    @property
    def text(self) -> str:
        """Such as "inverse gamma (3, 7.78)"."""
        return f"inverse gamma ({self.shape:g}, {self.scale:g})"


@dataclass(frozen=True)
class _Hierarchical(Prior):
    """A prior of positive elements that are alike, given a population's parameters.

    Subclasses give `depends_on`, `dependence`, `variable`, `text`, and the prior of one element, `_given`.
    """

    def _given(self, given: Mapping[str, Array] | None) -> Normal | LogNormal:
        """The prior of one element at these values of the population's parameters."""
        raise NotImplementedError

    def log_density(self, x: Array, given: Mapping[str, Array]) -> float:
        """Sum of the elements' log-densities."""
        return self._given(given).log_density(x, {})

    def curvature(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Those of an element's log-density."""
        return self._given(given).curvature(x, {})

    def quantile(self, p: ArrayLike, given: Mapping[str, Array] | None = None) -> Array:
        """Of one element."""
        return self._given(given).quantile(p)

    @property
    def median(self) -> float:
        """Not a number: that of the population."""
        return math.nan


@dataclass(frozen=True)
class Population(_Hierarchical):
    """Each element normal around a population's mean, and positive: x_i ~ N(m, s^2) given x_i > 0.

    Its sd is s = unit sqrt(v), and its density the normal one over Phi(m/s), which m and v change too.

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
    def depends_on(self) -> tuple[str, ...]:
        """Mean and variance of the population."""
        return self.mean, self.variance

    def _given(self, given: Mapping[str, Array] | None) -> Normal:
        values = given or {}
        return Normal(float(values[self.mean]), self.unit * math.sqrt(float(values[self.variance])), 0.0)

    def dependence(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        """With respect to m and v: -log p = sum (x - m)^2/(2 s^2) + n log(v)/2 + n log Phi(m/s) + const."""
        one = self._given(given)
        mean, sd = one.mean, one.sd
        v = float(given[self.variance])
        x = np.asarray(x, dtype=np.float64)
        z, n, t = (x - mean) / sd, len(x), mean / sd
        ratio = math.exp(-0.5 * t * t - 0.5 * math.log(2 * math.pi) - float(log_normal_mass(-math.inf, t)))
        bend = -ratio * (t + ratio)  # first and second derivative of log Phi(t)
        squares = float(np.sum(z * z))
        first = np.array([np.sum(z) / sd - n * ratio / sd, (squares - n + n * ratio * t) / (2.0 * v)])
        mixed = (np.sum(z) - 0.5 * n * (bend * t + ratio)) / (sd * v)
        of_variance = (squares - 0.5 * n + 0.25 * n * (bend * t * t + 3.0 * ratio * t)) / v**2
        second = np.array([[n * (1.0 + bend) / sd**2, mixed], [mixed, of_variance]])
        cross = np.stack([np.full(n, -1.0 / sd**2), -z / (sd * v)], axis=1)
        return first, second, cross

    def variable(self, name: str, given: Mapping[str, Any], **settings: Any) -> Any:
        """``zoo.core.distributions.PositiveNormal``, sampled as its logarithm."""
        import pymc as pm
        from pymc.distributions.transforms import log

        from zoo.core.distributions import PositiveNormal

        sd = self.unit * pm.math.sqrt(given[self.variance])
        mean = given[self.mean]
        return PositiveNormal(name, mean, sd, lower=0.0, default_transform=log, **settings)

    @property
    def text(self) -> str:
        """Such as "normal(m_chi, 10000 sqrt(v_chi)) above 0"."""
        return f"normal({self.mean}, {self.unit:g} sqrt({self.variance})) above 0"


@dataclass(frozen=True)
class LogPopulation(_Hierarchical):
    """Each element log-normal around a population's median: log x_i ~ N(log m, v).

    Parameters
    ----------
    median_name, variance : str
        Names of the parameters m and v; v is the variance of the logarithm.
    """

    median_name: str
    variance: str

    @property
    def depends_on(self) -> tuple[str, ...]:
        """Median and variance of the population."""
        return self.median_name, self.variance

    def _given(self, given: Mapping[str, Array] | None) -> LogNormal:
        values = given or {}
        return LogNormal(float(values[self.median_name]), math.sqrt(float(values[self.variance])))

    def dependence(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        """With respect to m and v, where -log p = sum log(x/m)^2/(2 v) + n log(v)/2."""
        m, v = float(given[self.median_name]), float(given[self.variance])
        x = np.asarray(x, dtype=np.float64)
        away = np.log(x / m)
        n, total, squares = len(x), float(np.sum(away)), float(np.sum(away * away))
        first = np.array([total / (m * v), 0.5 * squares / v**2 - 0.5 * n / v])
        mixed = total / (m * v**2)
        second = np.array([[(n + total) / (m * m * v), mixed], [mixed, squares / v**3 - 0.5 * n / v**2]])
        cross = np.stack([-1.0 / (x * m * v), -away / (x * v * v)], axis=1)
        return first, second, cross

    def variable(self, name: str, given: Mapping[str, Any], **settings: Any) -> Any:
        """``pm.LogNormal``."""
        import pymc as pm

        m, v = given[self.median_name], given[self.variance]
        return pm.LogNormal(name, pm.math.log(m), pm.math.sqrt(v), **settings)

    @property
    def text(self) -> str:
        """Such as "log-normal(m_chi, sqrt(v_chi))"."""
        return f"log-normal({self.median_name}, sqrt({self.variance}))"


@dataclass(frozen=True)
class FrozenPrior(Prior):
    """A frozen continuous distribution of SciPy.

    Parameters
    ----------
    words : str
        Its name and arguments; two priors of the same words are equal.
    distribution : scipy.stats.rv_continuous_frozen
    """

    words: str
    distribution: Any = field(repr=False, compare=False)

    @property
    def support(self) -> tuple[float, float]:
        """Bounds, in the parameter's unit."""
        low, high = self.distribution.support()
        return float(low), float(high)

    @property
    def law(self) -> Any:
        """The distribution."""
        return self.distribution

    @cached_property
    def sd(self) -> float:
        """Half the width of the central 68 %, which every distribution has."""
        low, high = self.quantile([0.16, 0.84])
        return 0.5 * float(high - low)

    def log_density(self, x: Array, given: Mapping[str, Array]) -> float:
        """Sum of the elements' log-densities."""
        return float(np.sum(self.distribution.logpdf(x)))

    def curvature(self, x: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Central differences of the log-density, inside the bounds."""
        step = DIFFERENCE * self.sd
        low, high = self.support
        at = np.clip(np.asarray(x, dtype=np.float64), low + 2.0 * step, high - 2.0 * step)
        before, here, after = (self.distribution.logpdf(at + k * step) for k in (-1, 0, 1))
        return (after - before) / (2.0 * step), (2.0 * here - before - after) / step**2

    def variable(self, name: str, given: Mapping[str, Any], **settings: Any) -> Any:
        """``pm.Interpolated`` between `KNOTS` quantiles."""
        import pymc as pm

        at = np.unique(self.quantile(np.linspace(1e-6, 1.0 - 1e-6, KNOTS)))
        return pm.Interpolated(name, at, self.distribution.pdf(at), **settings)

    @property
    def text(self) -> str:
        """Such as "gamma(2, scale=0.5)"."""
        return self.words


def as_prior(given: Any, name: str = "") -> Prior:
    """A prior from itself or from a frozen continuous distribution of SciPy.

    Parameters
    ----------
    given : Prior or scipy.stats.rv_continuous_frozen
    name : str
        Of its parameter, for the error.

    Returns
    -------
    Prior

    Raises
    ------
    ParameterError
        If it is neither.

    Examples
    --------
    >>> from scipy import stats
    >>> as_prior(stats.gamma(2, scale=0.5)).text
    'gamma(2, scale=0.5)'
    """
    if isinstance(given, Prior):
        return given
    if not (hasattr(given, "logpdf") and hasattr(given, "dist")):
        raise ParameterError(
            f"prior {f'{name} = ' * bool(name)}{given!r:.80}: give one of zoo, such as zoo.Normal(80, 5), or "
            "a frozen continuous distribution of SciPy, such as scipy.stats.gamma(2, scale=0.5)"
        )
    if given.dist.name == "uniform":  # as one of zoo, whose bounds are known as such
        low, high = given.support()
        return Uniform(float(low), float(high))
    words = [f"{x:g}" for x in given.args] + [f"{name}={x:g}" for name, x in given.kwds.items()]
    return FrozenPrior(f"{given.dist.name}({', '.join(words)})", given)
