"""What a forward model is: parameters, a configuration made of them, and series solved from it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import FunctionType
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from zoo.core.arrays import Array, Brief
from zoo.core.parameters import Parameter, Prior, unpack


class SolveError(RuntimeError):
    """A forward model has no solution at a point.

    Outside sampling it is raised; inside, the point has zero likelihood and is counted under `kind`.

    Parameters
    ----------
    reason : str
        In words, with what to change.
    kind : str
        A short key under which failures are counted, such as "collapse".
    """

    def __init__(self, reason: str, kind: str = "failed") -> None:
        super().__init__(reason)
        self.kind = kind


@dataclass(frozen=True, eq=False, repr=False)
class Outputs(Brief):
    """What is asked of a solve: series and the times at which they are sampled.

    Parameters
    ----------
    series : tuple of hashable
        What each series is, in the forward model's own terms; in blood (vessel, position, quantity).
    times : array (n_times,)
    """

    series: tuple[Hashable, ...]
    times: Array

    @property
    def shape(self) -> tuple[int, int]:
        """(n_series, n_times)."""
        return len(self.series), len(self.times)


class InNumba(NamedTuple):
    """A forward model as functions that numba compiles, which call no Python; they belong to this process.

    Parameters
    ----------
    solve : function
        From theta (n_values,) to a status, 0 or the number of a failure from 1 on, and series (n_series,
        n_times).
    differentiate : function
        From theta to these and slopes (n_values, n_series, n_times).
    failures : tuple of str
        Kinds of failures, as `SolveError` has them.
    keeps : object
        What must live as long as the functions are called.
    """

    solve: Callable[[Array], tuple[int, Array]]
    differentiate: Callable[[Array], tuple[int, Array, Array]]
    failures: tuple[str, ...]
    keeps: object = None


@runtime_checkable
class ForwardModel(Protocol):
    """A simulator, as everything else in zoo sees it.

    Attributes
    ----------
    name : str
    parameters : tuple of Parameter
    outputs : Outputs
        What is observed; the default of `solve`.
    key : str
        Digest of everything that a solution depends on besides theta: two forward models with one key give
        the same numbers.
    families : tuple of str
        Kinds of effects in the order in which they are applied; empty if it does not matter.

    A model that may be solved in several threads at once says so with an attribute ``threads = True``. One
    that knows where its solutions are less exact than promised has a method ``warning_at(configuration)``,
    which returns a sentence about it, or an empty text; it is asked at the mode. One that can be solved on a
    finer grid has a method ``refined()``, which returns a model of half the cells and steps, or None; its
    errors are of second order in their size. One whose discretisation follows its parameters has a method
    ``pinned(configuration)``, which returns the same model with the discretisation that this solve takes, so
    that its solutions are smooth functions of them. One that numba can call without Python has a method
    ``in_numba()``, which returns an `InNumba` or None; it is asked of a model of the very class that has it.
    """

    @property
    def name(self) -> str:
        """What results, records and messages call it."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Free parameters, in the order of theta."""

    @property
    def outputs(self) -> Outputs:
        """Series and times that `solve` gives if no others are asked for."""

    @property
    def families(self) -> tuple[str, ...]:
        """Kinds of effects, in the order in which they are applied."""

    @property
    def key(self) -> str:
        """Digest of everything that a solution depends on besides theta."""

    def configure(self, theta: Array) -> Any:
        """A solve about to be made, from parameters (n_values,); what effects may change."""
        ...

    def solve(self, configuration: Any, outputs: Outputs | None = None) -> Array:
        """Series (n_series, n_times), each in its own unit.

        Raises
        ------
        SolveError
            If there is no solution.
        """
        ...


class Around:
    """A forward model around another one, which solves and has what it has not itself.

    Parameters
    ----------
    model : ForwardModel
    """

    def __init__(self, model: ForwardModel) -> None:
        self.model = model
        self.name, self.outputs, self.families = model.name, model.outputs, model.families

    def solve(self, configuration: Any, outputs: Outputs | None = None) -> Array:
        """As the model does."""
        return self.model.solve(configuration, outputs)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "model":
            raise AttributeError(name)
        return getattr(self.model, name)


class WithPriors(Around):
    """A forward model with other priors of some parameters; itself a forward model.

    Parameters
    ----------
    model : ForwardModel
    priors : mapping of name to Prior
    """

    def __init__(self, model: ForwardModel, priors: Mapping[str, Prior]) -> None:
        super().__init__(model)
        self.parameters = tuple(replace(p, prior=priors.get(p.name, p.prior)) for p in model.parameters)

    @property
    def key(self) -> str:
        """Of the model: no solution depends on a prior."""
        return self.model.key

    def configure(self, theta: Array) -> Any:
        """As the model does."""
        return self.model.configure(theta)

    def refined(self) -> ForwardModel | None:
        """The model's own with these priors."""
        finer = refined(self.model)
        return None if finer is None else self._of(finer)

    def pinned(self, configuration: Any) -> ForwardModel:
        """The model's own with these priors."""
        return self._of(pinned(self.model, configuration))

    def _of(self, model: ForwardModel) -> ForwardModel:
        return WithPriors(model, {p.name: p.prior for p in self.parameters})


class Corrected(Around):
    """A forward model less its error at one point, which a better one tells; itself a forward model.

    y(theta) - factor (y(point) - y_better(point)): elsewhere the error is less by as much as it is alike.

    Parameters
    ----------
    model : ForwardModel
    own, better : ForwardModel
        The same, with effects, and one with lesser errors.
    point : array (n_values,)
        Of the parameters of these two.
    factor : float
        Of their difference in the error.
    """

    def __init__(
        self, model: ForwardModel, own: ForwardModel, better: ForwardModel, point: Array, factor: float
    ) -> None:
        super().__init__(model)
        self._pair, self._point, self._factor = (own, better), point, factor
        self._errors: dict[str, Array] = {}
        self.key = content_key("corrected", model.key, own.key, better.key, point, factor)

    def error(self, outputs: Outputs | None = None) -> Array:
        """Of the model at the point, (n_series, n_times).

        Raises
        ------
        SolveError
            If one of the two cannot be solved there.
        """
        key = content_key(outputs or self.outputs)
        if key not in self._errors:
            own, better = (one.solve(one.configure(self._point), outputs) for one in self._pair)
            self._errors[key] = self._factor * (own - better)
        return self._errors[key]

    def solve(self, configuration: Any, outputs: Outputs | None = None) -> Array:
        """Series of the model, less its error."""
        return self.model.solve(configuration, outputs) - self.error(outputs)

    def _differentiate(self, own: Any, *given: Any) -> tuple[Array, Array]:
        values, slopes = own(*given)
        return values - self.error(given[3] if len(given) > 3 else None), slopes

    def __getattr__(self, name: str) -> Any:
        found = super().__getattr__(name)
        return partial(self._differentiate, found) if name == "solve_derivatives" else found


def pinned(model: ForwardModel, configuration: Any) -> ForwardModel:
    """The same model at the discretisation of one solve, by its method ``pinned()`` if it has one.

    Parameters
    ----------
    model : ForwardModel
    configuration
        Of the solve.

    Raises
    ------
    SolveError
        If it cannot be solved.
    """
    fix = getattr(model, "pinned", None)
    return model if fix is None else fix(configuration)


def refined(model: ForwardModel) -> ForwardModel | None:
    """The same model solved with cells and steps of half the size, by its method ``refined()`` if it has one.

    Parameters
    ----------
    model : ForwardModel

    Returns
    -------
    ForwardModel or None
        None where it has no such method, or no finer grid.
    """
    finer = getattr(model, "refined", None)
    return None if finer is None else finer()


@dataclass(frozen=True, eq=False)
class FunctionModel:
    """A forward model made of one function of the configuration and the times.

    Parameters
    ----------
    function : callable
        ``function(configuration, times) -> array (n_series, n_times)`` or (n_times,). The configuration is a
        dict of parameters by name; effects may change it and add to it.
    parameters : tuple of Parameter
    outputs : Outputs
    name : str
    families : tuple of str
    functions : tuple of str
        Names in the configuration of free functions (`zoo.free_function`); those of the baseline are 0.
    finer : callable, optional
        The function with cells and steps of half the size, for errors of second order in it: a diagnosis then
        takes the function's own error off.

    Examples
    --------
    >>> import numpy as np
    >>> from zoo.core.parameters import Uniform
    >>> t = np.linspace(0.0, 1.0, 5)
    >>> slope = Parameter("slope", Uniform(0, 2))
    >>> line = FunctionModel(lambda c, t: c["slope"] * t, (slope,), Outputs(("y",), t))
    >>> line.solve(line.configure([0.5]))
    array([[0.   , 0.125, 0.25 , 0.375, 0.5  ]])
    """

    function: Callable[[Any, Array], Any]
    parameters: tuple[Parameter, ...]
    outputs: Outputs
    name: str = "function"
    families: tuple[str, ...] = ()
    functions: tuple[str, ...] = ()
    finer: Callable[[Any, Array], Any] | None = None

    def refined(self) -> FunctionModel | None:
        """The model of the `finer` function; None without one."""
        return None if self.finer is None else replace(self, function=self.finer, finer=None)

    @property
    def key(self) -> str:
        """Digest of the function with all that it refers to, the parameters and the outputs."""
        text = function_text(self.function)
        return content_key(text, self.name, repr(self.parameters), self.outputs, *self.functions)

    def configure(self, theta: ArrayLike) -> dict[str, Any]:
        """Parameters by name, and free functions that are 0."""
        return {**unpack(self.parameters, theta), **dict.fromkeys(self.functions, np.zeros_like)}

    def solve(self, configuration: Any, outputs: Outputs | None = None) -> Array:
        """The function's series, checked for shape and finiteness.

        Raises
        ------
        SolveError
            If the function raises one, or returns another shape, or what is complex or not finite.
        """
        wanted = outputs or self.outputs
        returned = self.function(configuration, wanted.times)
        if returned is None:
            raise SolveError(f"{self.name}: returns None; let it return its series", "shape")
        if np.iscomplexobj(returned):
            raise SolveError(f"{self.name}: returns complex numbers; let it return real ones", "complex")
        values = np.atleast_2d(np.asarray(returned, dtype=np.float64))
        if values.shape != wanted.shape:
            turned = "; give its transpose" if values.T.shape == wanted.shape else ""
            what = f"series of shape {values.shape}, wanted {wanted.shape}{turned}"
            raise SolveError(f"{self.name}: {what}", "shape")
        if not np.all(np.isfinite(values)):
            raise SolveError(f"{self.name}: the solution is not finite", "not-finite")
        return values


def at_all_times(function: Callable[[Any, Array], Any], times: Array) -> Callable[[Any, Array], Any]:
    """A function that is called at all these times also where its series are asked for at some of them.

    What steps from one time to the next would be another simulator at times of which some are left out.

    Parameters
    ----------
    function : callable
        As in `FunctionModel`.
    times : array (n,)
        Ascending.

    Returns
    -------
    callable
    """

    def simulate(configuration: Any, wanted: Array) -> Any:
        if not np.isin(wanted, times).all():
            return function(configuration, wanted)
        series = np.asarray(function(configuration, times))
        if series.shape[-1:] != times.shape:
            raise SolveError(f"series of shape {series.shape} at {len(times)} times", "shape")
        return series[..., np.searchsorted(times, wanted)]

    return simulate


def content_key(*parts: Any) -> str:
    """SHA-256 of texts, bytes, arrays and outputs."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, Outputs):
            part = repr(part.series).encode() + np.ascontiguousarray(part.times).tobytes()
        elif isinstance(part, np.ndarray):
            data = np.ascontiguousarray(part)
            part = f"{data.dtype}{data.shape}".encode() + data.tobytes()
        elif not isinstance(part, bytes):
            part = str(part).encode()
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()


def function_text(function: Any) -> bytes:
    """What tells a function from others: its pickle by value, with its code and all that this refers to.

    What cannot be pickled is told apart by its address, so that it is equal to itself only.
    """
    import cloudpickle  # type: ignore[import-untyped]

    if isinstance(function, FunctionType):  # one of an importable module would be pickled by its name
        parts = (function.__code__, function.__globals__, function.__name__, function.__defaults__)
        copy = FunctionType(*parts, function.__closure__)
        copy.__kwdefaults__, copy.__module__ = function.__kwdefaults__, "__main__"
        function = copy
    try:
        return bytes(cloudpickle.dumps(function))
    except Exception:
        return f"{function!r} at {id(function)}".encode()


def from_pints(
    model: Any,
    times: ArrayLike,
    priors: Sequence[Parameter],
    *,
    labels: Sequence[str] = (),
    name: str = "",
) -> FunctionModel:
    """A model of PINTS as a forward model.

    Parameters
    ----------
    model : pints.ForwardModel
        With `n_parameters()`, `n_outputs()` and `simulate(parameters, times)`.
    times : array (n_times,)
    priors : sequence of Parameter
        One number for each of the model's parameters, in their order.
    labels : sequence of str
        Of its outputs.
    name : str

    Returns
    -------
    FunctionModel

    Raises
    ------
    ValueError
        If the number of parameters differs.

    References
    ----------
    Clerx et al. 2019, doi 10.5334/jors.252.
    """
    if len(priors) != model.n_parameters():
        raise ValueError(f"{len(priors)} parameters for {model.n_parameters()}: give one for each")
    names = [p.name for p in priors]

    def simulate(configuration: Any, at: Array) -> Array:
        if unknown := [key for key in configuration if key not in names]:
            raise ValueError(
                f"{', '.join(map(str, unknown))}: no parameter of {type(model).__name__}, which has "
                f"{', '.join(names)}; to add a term, give a FunctionModel whose function calls `simulate`"
            )
        values = np.asarray(model.simulate([float(configuration[n]) for n in names], at))
        return values.reshape(len(at), -1).T

    series = tuple(labels) or tuple(f"y{i}" for i in range(getattr(model, "n_outputs", lambda: 1)()))
    outputs = Outputs(series, np.asarray(times, dtype=np.float64))
    return FunctionModel(simulate, tuple(priors), outputs, name or type(model).__name__)
