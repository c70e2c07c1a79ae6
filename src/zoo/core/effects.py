"""Effects: what a baseline model may lack, as values that plug into any forward model."""

from __future__ import annotations

import math
import pkgutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from zoo.core.arrays import Array
from zoo.core.forward import Around, ForwardModel, content_key, function_text, refined
from zoo.core.parameters import Normal, Parameter, n_values
from zoo.core.user_code import run_file, unfit
from zoo.core.words import nearest

ENTRY_POINTS = "zoo.effects"
NUMERICS = "numerics"
"""Family of effects on the numerical solution, which mean something on one grid only."""


class EffectError(ValueError):
    """An effect, baseline or location that does not exist, or one that does not fit; the text says which."""


@dataclass(frozen=True)
class Measure:
    """What sizes are parts of where a simulator's own size is the natural one, such as its beat.

    Parameters
    ----------
    text : str
        For tables, such as "beats".
    of : function
        From a forward model to that size in the parameter's unit.
    """

    text: str
    of: Callable[[Any], float]


@dataclass(frozen=True)
class EffectParameter:
    """A parameter of an effect, with its prior: normal(centre, scale), truncated to [low, high].

    Parameters
    ----------
    name, unit : str
        The unit is that of the values that the effect is applied with.
    scale : float
        Standard deviation of the prior before truncation.
    low, high : float
        Bounds of the prior.
    starts : tuple of float
        Where a search may start, none of them 0.
    why : str
        Reason for the scale.
    centre : float
        Mean of the prior before truncation; 0 unless `zero_is_base` is false.
    zero_is_base : bool
        False for a shape, which says nothing while the effect's first parameter is 0.
    continuous : bool
        False for a switch: the smallest nonzero value is already far from the baseline.
    measure : Measure, optional
        What scale, bounds, starts and centre are parts of; if absent they are in the unit.
    """

    name: str
    unit: str
    scale: float
    low: float
    high: float
    starts: tuple[float, ...]
    why: str = ""
    centre: float = 0.0
    zero_is_base: bool = True
    continuous: bool = True
    measure: Measure | None = field(default=None, repr=False)

    @property
    def prior(self) -> Normal:
        """The truncated normal, in parts of the measure where there is one."""
        return Normal(self.centre, self.scale, self.low, self.high)

    @property
    def text(self) -> str:
        """Its prior in words, such as "normal(0, 0.5) in [-1, 1] s" or "normal(0, 0.03) in [0, 1] beats"."""
        unit = self.measure.text if self.measure else self.unit
        return f"{self.prior.text} {unit}".removesuffix(" 1")

    def of(self, model: Any) -> EffectParameter:
        """The same in its unit, for a forward model; itself where it has no measure."""
        if self.measure is None:
            return self
        size = self.measure.of(model)
        return replace(
            self,
            scale=self.scale * size,
            low=self.low * size,
            high=self.high * size,
            starts=tuple(start * size for start in self.starts),
            centre=self.centre * size,
            measure=None,
        )

    @property
    def start(self) -> float:
        """The first of its starts, or the centre of a shape."""
        return self.starts[0] if self.zero_is_base else self.centre


@dataclass(frozen=True)
class Location:
    """Where an effect acts: everywhere, at one part of the simulator, or at that part and all below it.

    Parameters
    ----------
    part : int or str, optional
        None stands for everywhere alike.
    subtree : bool
    noun : str
        What a part is called, such as "vessel".
    """

    part: int | str | None = None
    subtree: bool = False
    noun: str = field(default="", compare=False)

    def __str__(self) -> str:
        if self.part is None:
            return "everywhere"
        name = f"{self.noun} {self.part}".strip()
        return f"{name} and below" if self.subtree else name

    @property
    def suffix(self) -> str:
        """For the name of a parameter: "", "@2" or "@2+"."""
        return "" if self.part is None else f"@{self.part}" + ("+" if self.subtree else "")


EVERYWHERE = Location()
Apply = Callable[[Any, tuple[float, ...], Location], Any]
BySize = Callable[[Any, float], Any] | Callable[[Any, float, Location], Any]
Change = Apply | BySize
Locations = Callable[[Any], tuple[Location, ...]]


def everywhere(model: Any) -> tuple[Location, ...]:
    """The only location of an effect that has none."""
    return (EVERYWHERE,)


@dataclass(frozen=True)
class EverywhereIf:
    """Locations of an effect that acts everywhere, in models for which it is something new.

    Parameters
    ----------
    new : function
        From a forward model to whether the effect can be added to it.
    """

    new: Callable[[Any], bool]

    def __call__(self, model: Any) -> tuple[Location, ...]:
        """Everywhere, where the effect is new to the model; else nowhere."""
        return (EVERYWHERE,) if self.new(model) else ()


@dataclass(frozen=True)
class Effect:
    """One thing that a baseline model may lack.

    Parameters
    ----------
    name : str
    parameters : tuple of EffectParameter
        The first is 0 in the baseline.
    apply : function or None
        ``apply(configuration, values, location) -> configuration``, a value for each parameter; it returns
        a changed copy, or the configuration itself when the first value is 0. Values are not held to the
        prior's bounds. None for what is part of the errors and not of a solve.
    locations : function
        From a forward model to the locations at which the effect can act.
    family : str
        Its kind; a forward model's `families` are the order in which effects are applied.
    statement, equation, source, signature : str
        What it is in words and as an equation, where that comes from, and what it does to the series.
    baselines : tuple of str
        Names of the forward models that it can be added to; empty means all.
    position : int
        Its order in a family.
    home : str
        "module:attribute" of the catalogue that it is built into; empty for a user's.
    """

    name: str
    parameters: tuple[EffectParameter, ...]
    apply: Apply | None
    locations: Locations = everywhere
    family: str = ""
    statement: str = ""
    equation: str = ""
    source: str = ""
    signature: str = ""
    baselines: tuple[str, ...] = ()
    position: int = field(default=1 << 30, compare=False)
    home: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        if not self.parameters:
            raise EffectError(
                f"effect {self.name}: has no parameters; give at least one EffectParameter, 0 where "
                "the effect is not there"
            )
        first = self.parameters[0]
        for start in first.starts:
            if start == 0.0 or not first.low <= start <= first.high:
                raise EffectError(
                    f"effect {self.name}: parameter {first.name}: start {start:g}: give one between "
                    f"{first.low:g} and {first.high:g} that is not 0, where there is no effect"
                )

    # functions behind a decorator have no importable name: an effect of a catalogue is pickled by its own
    def __reduce__(self) -> Any:
        if self.home:
            known = pkgutil.resolve_name(self.home).get(self.name)
            if known is self:
                return _from_home, (self.home, self.name)
            if known is not None and replace(known, parameters=self.parameters) == self:
                return _from_home, (self.home, self.name, self.parameters)
        return Effect, tuple(getattr(self, f.name) for f in fields(self))

    def offered(self, baseline: str) -> bool:
        """Whether it can be added to a forward model, by that model's name."""
        return not self.baselines or baseline in self.baselines

    def of(self, model: Any) -> Effect:
        """The effect with its parameters in their units, for a forward model; itself if they are."""
        found = tuple(p.of(model) for p in self.parameters)
        return self if found == self.parameters else replace(self, parameters=found)

    def at(self, location: Location = EVERYWHERE) -> AddedEffect:
        """The effect at a location, as what is added to a forward model."""
        return AddedEffect(self, location)


def _from_home(home: str, name: str, parameters: tuple[EffectParameter, ...] | None = None) -> Effect:
    made: Effect = pkgutil.resolve_name(home)[name]
    return made if parameters is None else replace(made, parameters=parameters)


@dataclass(frozen=True)
class AddedEffect:
    """An effect at a location."""

    effect: Effect
    location: Location = EVERYWHERE

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.effect.name

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """As parameters of a forward model, such as "local-stiffness@2.log-stiffness"."""
        return tuple(
            Parameter(
                f"{self.effect.name}{self.location.suffix}.{p.name}",
                p.prior,
                p.unit,
                start=p.start,
                label=f"{self.effect.name} {p.name}",
            )
            for p in self.effect.parameters
        )


def effect(
    name: str,
    family: str = "",
    *,
    size: float = 0.0,
    unit: str = "1",
    low: float | None = None,
    high: float | None = None,
    starts: Sequence[float] = (),
    parameters: Sequence[EffectParameter] = (),
    equation: str = "",
    source: str = "",
    signature: str = "",
    why: str = "",
    locations: Locations = everywhere,
    baselines: Sequence[str] = (),
) -> Callable[[Change], Effect]:
    """Make an effect of a function that changes what a simulator solves: a decorator.

    An effect of one size has the prior normal(0, size), truncated to [low, high]::

        change(parameters, size) -> parameters
        change(parameters, size, location) -> parameters        with `locations`

    An effect of several numbers has `parameters` instead of a size::

        change(parameters, values, location) -> parameters

    Parameters
    ----------
    name : str
        Such as "evaporation".
    family : str
        Effects of one family belong to one component, of which at most one is wrong in one way; an effect
        without a family is a component by itself.
    size : float
        Standard deviation of the prior, before truncation, in `unit`.
    unit : str
        "1" for a pure number.
    low, high : float, optional
        Bounds of the prior, in `unit`; ten times `size` either way if absent.
    starts : sequence of float
        Sizes from which a search begins, none of them 0; `size` and `-size` inside the bounds if absent.
    parameters : sequence of EffectParameter
        Instead of a size; the first is 0 where there is no effect.
    equation, source, signature : str
        Its equation, where that comes from, and what it does to the series.
    why : str
        Reason for the prior's size.
    locations : function
        From a forward model to the locations at which the effect can act; everywhere if absent.
    baselines : sequence of str
        Names of the forward models that it can be added to; all if absent.

    Returns
    -------
    function
        From `change` to the `Effect`. `change` returns a changed copy and is called only when the size is not
        0; its docstring is the effect's statement.

    Raises
    ------
    EffectError
        If neither or both of `size` and `parameters` are given, the size is not positive, or the function
        takes other arguments.

    Examples
    --------
    >>> @effect("leak", unit="1/s", size=0.1, low=0.0)
    ... def leak(parameters, size):
    ...     "The tank leaks."
    ...     return {**parameters, "leak": size}
    >>> leak.apply({"k": 1.0}, (0.2,), Location())
    {'k': 1.0, 'leak': 0.2}
    >>> leak.parameters[0].text
    'normal(0, 0.1) in [0, 1] 1/s'
    """
    if bool(parameters) == (size != 0.0) or not 0.0 <= size < math.inf:
        raise EffectError(f"effect {name}: size = {size}: give a positive size, or parameters instead of it")
    known = tuple(parameters)
    if not known:
        low, high = (-10.0 * size if low is None else low), (10.0 * size if high is None else high)
        starts = starts or tuple(start for start in (size, -size) if low <= start <= high)
        known = (EffectParameter("size", unit, size, low, high, tuple(starts)),)
    if why:
        known = (replace(known[0], why=why), *known[1:])
    located = not (locations is everywhere or isinstance(locations, EverywhereIf))

    called = ["parameters", "values" if parameters else "size", "location"]
    called = called if parameters or located else called[:2]

    def make(change: Change) -> Effect:
        if wrong := unfit(change, len(called)):
            hint = "" if located else "; one that acts at a place has locations="
            raise EffectError(f"effect {name}: is called as ({', '.join(called)}): {wrong}{hint}")
        return Effect(
            name, known, _Guarded(name, known, change, located, not parameters), locations, family,
            (change.__doc__ or "").strip(), equation, source, signature, tuple(baselines),
        )  # fmt: skip

    return make


@dataclass(frozen=True)
class _Guarded:
    """The function inside an effect, with its arguments checked."""

    name: str
    parameters: tuple[EffectParameter, ...]
    change: Change
    located: bool
    by_size: bool = False

    def __call__(self, configuration: Any, values: tuple[float, ...], location: Location) -> Any:
        if len(values) != len(self.parameters) or not all(math.isfinite(value) for value in values):
            wanted = ", ".join(f"{p.name} ({p.unit})" for p in self.parameters)
            raise EffectError(f"effect {self.name}: values = {values}: give finite numbers for {wanted}")
        if self.located and location.part is None:
            raise EffectError(f"effect {self.name}: location: is missing; give where it acts")
        if not values[0]:
            return configuration
        change: Callable[..., Any] = self.change
        if not self.by_size:
            changed = change(configuration, values, location)
        elif self.located:
            changed = change(configuration, values[0], location)
        else:
            changed = change(configuration, values[0])
        if changed is None:
            raise EffectError(
                f"effect {self.name}: its function returns None; let it return the changed configuration"
            )
        return changed


# ---------------------------------------------------------------------------------------------------
# A forward model with effects


def in_order(model: ForwardModel, added: Sequence[AddedEffect]) -> list[int]:
    """Indices of effects in the order in which they are applied: by family, then by position."""
    families = list(model.families)

    def key(i: int) -> tuple[int, int]:
        made = added[i].effect
        return (families.index(made.family) if made.family in families else len(families)), made.position

    return sorted(range(len(added)), key=key)


class WithEffects(Around):
    """A forward model with effects; itself a forward model.

    Its parameters are those of the model, then those of the effects in the order given; effects are applied
    in the order of the model's families, whatever the order given.

    Parameters
    ----------
    model : ForwardModel
    added : sequence of AddedEffect

    Raises
    ------
    EffectError
        If an effect acts on the errors and not on a solve, is given twice at one location, or cannot be added
        to this model.
    """

    def __init__(self, model: ForwardModel, added: Sequence[AddedEffect]) -> None:
        super().__init__(model)
        self.added = tuple(one.effect.of(model).at(one.location) for one in added)
        for i, one in enumerate(self.added):
            if one.effect.apply is None:
                raise EffectError(f"effect {one.name}: is part of the errors; it cannot be added to a solve")
            if not one.effect.offered(model.name):
                only = ", ".join(one.effect.baselines)
                raise EffectError(f"effect {one.name}: cannot be added to {model.name}, only to {only}")
            if one in self.added[:i]:
                raise EffectError(f"effect {one.name}: is given twice at {one.location}; give it once")
        self.parameters = model.parameters + tuple(p for one in self.added for p in one.parameters)
        self._order = in_order(model, self.added)

    @property
    def key(self) -> str:
        """Of the model and the effects' names, locations and functions."""
        texts = [_effect_text(one) for one in self.added]
        return content_key(self.model.key, repr(self._order), *texts)

    def configure(self, theta: Array) -> Any:
        """The model's configuration, changed by each effect."""
        theta = np.asarray(theta, dtype=np.float64)
        n = n_values(self.model.parameters)
        parts, at = [], n
        for one in self.added:
            size = len(one.effect.parameters)
            parts.append(tuple(float(value) for value in theta[at : at + size]))
            at += size
        if theta.shape != (at,):
            raise EffectError(
                f"{theta.size} values for {at}: give {', '.join(p.name for p in self.parameters)}"
            )
        configuration = self.model.configure(theta[:n])
        for i in self._order:
            one = self.added[i]
            assert one.effect.apply is not None
            configuration = one.effect.apply(configuration, parts[i], one.location)
        return configuration

    def refined(self) -> ForwardModel | None:
        """The model's own with the effects; None where one of them is an error of the grid itself."""
        finer = None if any(one.effect.family == NUMERICS for one in self.added) else refined(self.model)
        return None if finer is None else WithEffects(finer, self.added)


def _effect_text(one: AddedEffect) -> bytes:
    change = getattr(one.effect.apply, "change", one.effect.apply)
    text = f"{one.name} {one.location.part!r} {one.location.subtree} {one.effect.parameters!r}".encode()
    return text + function_text(change)


def with_effects(model: ForwardModel, added: Iterable[AddedEffect]) -> ForwardModel:
    """The model itself without effects, else `WithEffects`."""
    found = tuple(added)
    return WithEffects(model, found) if found else model


# ---------------------------------------------------------------------------------------------------
# Catalogues


class Catalogue(Mapping[str, Effect]):
    """Effects by name, in the order in which those of a family are applied.

    Parameters
    ----------
    families : sequence of str
        Kinds that an effect may have; empty means any.
    entry_points : str
        Group of entry points whose effects belong to it; empty means none. They are loaded when a name is
        first looked up that is not there, or all are listed.
    home : str
        "module:attribute" where this catalogue is found in another process; effects defined below that module
        are pickled by their names.
    """

    def __init__(self, families: Sequence[str] = (), entry_points: str = "", home: str = "") -> None:
        self.families = tuple(families)
        self.home = home
        self._entry_points = entry_points
        self._effects: dict[str, Effect] = {}

    def check(self, made: Effect) -> Effect:
        """An effect, which may be a user's, of one of the families, or of none.

        Raises
        ------
        EffectError
            If its family is unknown.
        """
        if self.families and made.family and made.family not in self.families:
            raise EffectError(
                f"effect {made.name}: family = {made.family!r}: {nearest(made.family, self.families)}"
            )
        return made

    def add(self, made: Effect) -> Effect:
        """Put an effect into the catalogue, in place of one of the same name; returns it with its position.

        Raises
        ------
        EffectError
            If its family is unknown.
        """
        self.check(made)
        old = self._effects.get(made.name)
        change = getattr(made.apply, "change", made.apply)
        module = self.home.partition(":")[0]
        own = bool(module) and (change is None or str(getattr(change, "__module__", "")).startswith(module))
        position = old.position if old else len(self._effects)
        made = replace(made, position=position, home=self.home if own else "")
        self._effects[made.name] = made
        return made

    def effect(self, *args: Any, **settings: Any) -> Callable[[Change], Effect]:
        """The decorator `effect`, which also adds the effect to this catalogue."""
        decorate = effect(*args, **settings)
        return lambda change: self.add(decorate(change))

    def _load(self) -> None:
        if not self._entry_points:
            return
        from importlib.metadata import entry_points

        group, self._entry_points = self._entry_points, ""
        for point in entry_points(group=group):
            for made in effects_in(point.load()):
                self.add(made)

    def __getitem__(self, name: str) -> Effect:
        if name not in self._effects:
            self._load()
        if name not in self._effects:
            raise EffectError(f"effect {name!r}: {nearest(name, list(self._effects))}")
        return self._effects[name]

    def get(self, name: str, default: Any = None) -> Any:
        """An effect by its name, or something else where there is none."""
        self._load()
        return self._effects.get(name, default)

    def __contains__(self, name: object) -> bool:
        self._load()
        return name in self._effects

    def __iter__(self) -> Iterator[str]:
        self._load()
        return iter(list(self._effects))

    def __len__(self) -> int:
        self._load()
        return len(self._effects)

    def resolve(self, given: Iterable[str | Effect]) -> tuple[Effect, ...]:
        """Effects from names and effects, each once.

        Raises
        ------
        EffectError
            For a name that is not there.
        """
        found = [self[one] if isinstance(one, str) else self.check(one) for one in given]
        return tuple({made.name: made for made in found}.values())


def effects_in(found: Any) -> list[Effect]:
    """The effects that an object holds: one, several, or those of a module."""
    if isinstance(found, Effect):
        return [found]
    values = vars(found).values() if hasattr(found, "__dict__") and not callable(found) else found
    return list({one.name: one for one in values if isinstance(one, Effect)}.values())


def load_module(path: str | Path) -> Any:
    """Run a Python file and return it as a module whose functions travel to other processes by value.

    This executes the file, and what it imports from its folder: give only one that you trust.

    Raises
    ------
    EffectError
        If it is missing or fails.
    """
    path = Path(path)
    if not path.is_file():
        raise EffectError(f"{path}: cannot be read; give a Python file")
    try:
        return run_file(path, f"zoo_user_{path.stem}_{content_key(str(path.resolve()))[:8]}")
    except Exception as error:
        raise EffectError(f"{path}: {type(error).__name__}: {error}; correct the file") from error


def load_effects(path: str | Path) -> list[Effect]:
    """The effects that a Python file defines.

    Raises
    ------
    EffectError
        If the file cannot be run, or defines none.
    """
    found = effects_in(load_module(path))
    if not found:
        raise EffectError(f"{path}: defines no effect; decorate a function with @effect(...)")
    return found
