"""Errors of any mix of quantities: a noise, and on request a Gaussian process, for each group of series."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from zoo.core.arrays import Array
from zoo.core.data import Data
from zoo.core.errors.base import DIMS, ErrorModel, ErrorModelError, TermsInNumba
from zoo.core.errors.gaussian_process import Processes, gp_gradient
from zoo.core.parameters import LogNormal, Parameter, Prior

_LOG_2PI = math.log(2.0 * math.pi)

NOISE = (0.005, 2.0, 1e-5)
"""Prior of a noise's sd: median and lower limit in parts of the group's range, and sd of the logarithm."""
AMPLITUDE = (0.03, 1.5)
"""Prior of a process' amplitude: median in parts of the group's range, and sd of the logarithm."""
WEIGHTS = (300.0, 1.2)
"""Prior of the variance of the kernel's weights: median, per squared cycle, and sd of the logarithm."""
BIAS = (20.0, 1.5)
"""Prior of the variance of the kernel's bias: median, and sd of the logarithm."""
FIRST = 0.03
"""Noise and amplitude that a search begins with, in parts of the range: large, so that no misfit is too."""


@dataclass(frozen=True)
class GroupNoise(ErrorModel):
    """Independent normal errors with a standard deviation for each group of series: y_i ~ N(mean_i, sd^2).

    Parameters
    ----------
    known : mapping of str to float
        Standard deviations that are given, in the unit of the series, by the name of a group or the label of
        a series, which goes before its group's. What is given is fixed, the others are inferred.
    priors : mapping of str to Prior
        Of parameters by name, instead of those that follow from the data.

    Notes
    -----
    The prior of "noise_G", the sd of group G, follows from R, the largest range of a series of the group:
    log-normal with median 0.005 R and a sd of the logarithm of 2, above 1e-5 R. 95 % of it lie between
    R/10000 and R/4, so it scales with the unit.

    Examples
    --------
    >>> t = np.arange(4) / 4
    >>> data = Data(t, np.array([[0.0, 8.0, 2.0, 0.0], [0.0, 0.3, 0.1, 0.0]]), labels=["p", "q"])
    >>> errors = GroupNoise(known={"q": 0.01}).bind(data)
    >>> [p.name for p in errors.parameters]
    ['noise_p']
    >>> errors.terms(np.zeros((2, 4)), {"noise_p": 1.0})[:, 0].round(3)
    array([-0.919,  3.686])
    """

    gaps: ClassVar[bool] = True
    known: Mapping[str, float] | tuple[tuple[str, float], ...] = ()
    priors: Mapping[str, Prior] | tuple[tuple[str, Prior], ...] = ()

    def __post_init__(self) -> None:
        for name in ("known", "priors"):
            given = getattr(self, name)
            pairs = given.items() if isinstance(given, Mapping) else given
            object.__setattr__(self, name, tuple(sorted(pairs, key=lambda pair: pair[0])))
        for name, sd in dict(self.known).items():
            if not 0 < sd < math.inf:
                raise ErrorModelError(f"known: {name} = {sd}: a standard deviation must be positive")

    @property
    def name(self) -> str:
        """Its name, "noise"."""
        return "noise"

    @property
    def least_squares_first(self) -> bool:
        """Yes."""
        return True

    def bind(self, data: Data) -> Self:
        """The same for given data.

        Raises
        ------
        ErrorModelError
            If a standard deviation is known, or a prior given, of what the data or parameters do not have.
        """
        bound = super().bind(data)
        there = [*data.rows, *data.labels]
        parameters = [p.name for p in bound._all_parameters]
        for what, given, possible in (
            ("known", dict(bound.known), there),
            ("priors", dict(bound.priors), parameters),
        ):
            for name in given:
                if name not in possible:
                    raise ErrorModelError(
                        f"{data.source or data.name}: {what}: {name!r}: no such name; use one of "
                        + ", ".join(dict.fromkeys(possible))
                    )
        return bound

    def with_priors(self, priors: Mapping[str, Prior]) -> Self:
        """The same with other priors of some of its parameters; what there is, `bind` sees."""
        return replace(self, priors={**dict(self.priors), **priors})

    def _group_parameters(self, group: str, unit: str, size: float) -> Iterator[Parameter]:
        """Of one group whose series have the range `size`."""
        if None in [self._given[i] for i in self.on.rows[group]]:
            median, spread, low = NOISE
            prior = LogNormal(median * size, spread, low * size)
            about = f"sd of the noise, {group}"
            yield Parameter(f"noise_{group}", prior, unit, FIRST * size, about, log=True)

    @cached_property
    def _given(self) -> list[float | None]:
        """Known standard deviation of each series; None for those to be inferred."""
        known = dict(self.known)
        pairs = zip(self.on.labels, self.on.groups, strict=True)
        return [known.get(label, known.get(group)) for label, group in pairs]

    @cached_property
    def _all_parameters(self) -> tuple[Parameter, ...]:
        """Of all groups, with the priors that follow from the data."""
        found: list[Parameter] = []
        for group, rows in self.on.rows.items():
            values = self.on.values[rows]
            size = float(np.nanmax(np.nanmax(values, axis=1) - np.nanmin(values, axis=1)))
            size = size or float(np.nanmax(np.abs(values))) or 1.0
            found += self._group_parameters(group, self.on.unit(group), size)
        return tuple(found)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """For each group G "noise_G", unless it is known for all its series."""
        given = dict(self.priors)
        found = []
        for p in self._all_parameters:
            prior = given.get(p.name)
            if prior is not None:
                low, high = prior.support
                p = replace(p, prior=prior, start=p.start if low < p.first < high else None)
            found.append(p)
        return tuple(found)

    @property
    def fixed(self) -> dict[str, str]:
        """The known standard deviation of each series that has one."""
        series = zip(self.on.labels, self.on.units, self._given, strict=True)
        return {f"noise of {label}": f"known, {sd:g} {unit}" for label, unit, sd in series if sd is not None}

    def noise(self, values: Mapping[str, Any]) -> list[Any]:
        """Standard deviation of the noise of each series, a number or a tensor."""
        pairs = zip(self._given, self.on.groups, strict=True)
        return [values[f"noise_{group}"] if sd is None else sd for sd, group in pairs]

    def _noise(self, values: Mapping[str, ArrayLike]) -> Array:
        """The same as a column (n_series, 1)."""
        return np.array([float(np.asarray(sd)) for sd in self.noise(values)])[:, None]

    def variance(self, values: Mapping[str, ArrayLike]) -> Array:
        """The variance at each time, (n_series, n_times)."""
        return np.repeat(self._noise(values) ** 2, self.on.n_times, axis=1)

    def whiten(self, residuals: Array, values: Mapping[str, ArrayLike]) -> Array | None:
        """Residuals over the standard deviation."""
        return self.on.filled(residuals / self._noise(values))

    def unwhiten(self, z: Array, values: Mapping[str, ArrayLike]) -> Array | None:
        """Standard normal numbers times the standard deviation."""
        return np.asarray(z * self._noise(values))

    def terms(
        self, residual: Array, values: Mapping[str, ArrayLike], decomposition: str = "sequential"
    ) -> Array:
        """Terms log p(y_i), (n_series, n_times), the same in every decomposition."""
        sd = self._noise(values)
        return self.on.filled(-0.5 * (_LOG_2PI + (residual / sd) ** 2) - np.log(sd))

    def observe(
        self, name: str, mean: Any, ok: Any, variables: Mapping[str, Any], dims: Sequence[str] = DIMS
    ) -> Any:
        """Add the observed variable, whose log-density is written in PyTensor."""
        import pytensor.tensor as pt

        from zoo.core.errors.variables import IidErrors

        variance = pt.stack([pt.as_tensor_variable(sd) ** 2 for sd in self.noise(variables)])[:, None]
        observed = self.on.filled(self.on.values, np.inf)
        return IidErrors(name, mean, ok, variance, observed=observed, dims=tuple(dims))


@dataclass(frozen=True)
class GroupProcess(Processes, GroupNoise):
    """Noise and a Gaussian process for each group of series.

    y ~ N(mean, amplitude^2 K(w, b) + noise^2 I), independently for each series, with K the neural-network
    kernel over cycles, times divided by the data's period (or whole record). The series of a group share its
    four parameters.

    Parameters
    ----------
    known : mapping of str to float
        See `GroupNoise`.
    priors : mapping of str to Prior
        See `GroupNoise`.

    Notes
    -----
    The priors of group G, whose series have the range R at most: "noise_G" as in `GroupNoise`; "amplitude_G"
    log-normal with median 0.03 R and a sd of the logarithm of 1.5, so that 95 % of it lie between R/630 and
    0.57 R; "w_G", per squared cycle, log-normal with median 300 and a sd of 1.2; "b_G" log-normal with median
    20 and a sd of 1.5. The medians of noise and amplitude are apart, and the process is smooth where noise is
    not, which tells the two apart; where there is no discrepancy the amplitude falls below the noise, and w
    and b follow their priors.

    References
    ----------
    Rasmussen and Williams 2006, Gaussian Processes for Machine Learning, eq. 4.29; Paun et al. 2020,
    eq. (4.6), doi 10.1098/rsif.2020.0886, with a fixed amplitude and noise.
    """

    @property
    def name(self) -> str:
        """Its name, "process"."""
        return "process"

    def _group_parameters(self, group: str, unit: str, size: float) -> Iterator[Parameter]:
        yield from super()._group_parameters(group, unit, size)
        median, spread = AMPLITUDE
        amplitude = LogNormal(median * size, spread)
        about = f"amplitude of the process, {group}"
        yield Parameter(f"amplitude_{group}", amplitude, unit, FIRST * size, about, log=True)
        about = f"variance of the kernel's weights, {group}"
        yield Parameter(f"w_{group}", LogNormal(*WEIGHTS), "cycle-2", label=about, log=True)
        about = f"variance of the kernel's bias, {group}"
        yield Parameter(f"b_{group}", LogNormal(*BIAS), label=about, log=True)

    @cached_property
    def cycles(self) -> Array:
        """The data's times in parts of its period or record, (n_times,)."""
        return np.asarray(self.on.times / self.on.duration)

    def _parts(self, values: Mapping[str, ArrayLike]) -> Iterator[tuple[Any, float, tuple[Any, ...]]]:
        sd = self._noise(values).ravel()
        for group, rows in self.on.rows.items():
            a, w, b = (float(np.asarray(values[f"{name}_{group}"])) for name in ("amplitude", "w", "b"))
            for one, inferred in dict.fromkeys((sd[i], self._given[i] is None) for i in rows):
                ratio = one / a if a > 0 else math.inf
                clocks: dict[bytes, list[int]] = {}
                for i in rows:
                    if (sd[i], self._given[i] is None) == (one, inferred):
                        clocks.setdefault(self.on.measured[i].tobytes(), []).append(i)
                for same in clocks.values():
                    at = np.flatnonzero(self.on.measured[same[0]])
                    index = ..., np.array(same)[:, None], at
                    yield index, a, (self.cycles[at], w, b, ratio * ratio)

    def gradient(
        self, residual: Array, values: Mapping[str, ArrayLike], weight: Array
    ) -> tuple[Array, dict[str, float]]:
        """That of a process of amplitude 1 for r/a, whose noise has the variance (noise/a)^2."""
        by_residual, found = np.zeros(residual.shape), dict.fromkeys(self.parameter_names, 0.0)
        for at, a, law in self._parts(values):
            first, part, ratio = int(at[1][0, 0]), residual[at], law[-1]
            group = self.on.groups[first]
            scaled, by_w, by_b, by_ratio = gp_gradient(part / a, weight[at], *law)
            by_residual[at] = scaled / a
            by_a = np.vdot(scaled, part / a) + np.sum(weight[at]) + 2.0 * ratio * by_ratio
            found[f"amplitude_{group}"] -= float(by_a) / a
            found[f"w_{group}"] += by_w
            found[f"b_{group}"] += by_b
            if self._given[first] is None:
                found[f"noise_{group}"] += 2.0 * math.sqrt(ratio) / a * by_ratio
        return by_residual, found

    def in_numba(self) -> TermsInNumba | None:
        """Of the process of each group, or of the series of a group with the same known noise.

        None where samples are missing.
        """
        from zoo.core.errors.process_in_numba import Part, processes

        if not self.on.whole:
            return None

        at = {name: i for i, name in enumerate(self.parameter_names)}
        parts = []
        for group, rows in self.on.rows.items():
            own = {name: at[f"{name}_{group}"] for name in ("amplitude", "w", "b")}
            for sd in dict.fromkeys(self._given[i] for i in rows):
                same = tuple(i for i in rows if self._given[i] == sd)
                if sd is None:
                    parts.append(Part(same, **own, noise=at[f"noise_{group}"]))
                else:
                    parts.append(Part(same, **own, variance=sd * sd))
        return processes(self.cycles, parts)

    def observe(
        self, name: str, mean: Any, ok: Any, variables: Mapping[str, Any], dims: Sequence[str] = DIMS
    ) -> Any:
        """Add the observed variable, with the terms as an operation with their `gradient`."""
        return ErrorModel.observe(self, name, mean, ok, variables, dims)
