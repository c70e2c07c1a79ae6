"""Names that these modules had before; for those that still use them."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.blood import case as now
from zoo.blood.case import Case
from zoo.blood.conventions import Conventions
from zoo.blood.effects.catalogue import CATALOGUE
from zoo.blood.effects.locations import at_vessel
from zoo.blood.forward import FAMILIES
from zoo.blood.network import Network, stiffness_profile
from zoo.blood.solver import Physics, SolverOptions
from zoo.blood.study import Study
from zoo.core.effects import Effect, EffectError, EffectParameter, Location, in_order, nearest
from zoo.core.forward import SolveError

Array = NDArray[np.float64]
Amplitude = EffectParameter


def Place(vessel: int | None = None, subtree: bool = False) -> Location:
    return Location() if vessel is None else at_vessel(vessel, subtree)


Effect.amplitudes = property(lambda self: self.parameters)  # type: ignore[attr-defined]
Effect.bases = property(lambda self: self.baselines)  # type: ignore[attr-defined]
Effect.places = property(  # type: ignore[attr-defined]
    lambda self: lambda network: self.locations(SimpleNamespace(network=network))
)
Location.vessel = property(lambda self: self.part)  # type: ignore[attr-defined]
Location.__iter__ = lambda self: iter((self.part, self.subtree))  # type: ignore[attr-defined]


def get_effect(name: str) -> Effect:
    return CATALOGUE[name]


def simulate(case: Case, series: Any, times_s: Any) -> tuple[Array, str | None]:
    try:
        return now.simulate(case, series, times_s), None
    except SolveError as error:
        return np.full((len(series), np.size(times_s)), np.nan), str(error)


def apply_all(case: Case, added: Sequence[tuple[Effect, Sequence[float], Location]]) -> Case:
    order = in_order(SimpleNamespace(families=FAMILIES), [made.at(place) for made, _, place in added])  # type: ignore[arg-type]
    for made, values, place in (added[i] for i in order):
        if made.apply is None:
            raise EffectError(f"effect {made.name}: is part of the errors; it cannot be applied to a case")
        case = made.apply(case, tuple(float(value) for value in values), place)
    return case


# ---------------------------------------------------------------------------------------------------
# Base models


@dataclass(frozen=True)
class BaseParameter:
    """A parameter of a base model, its prior uniform in [low, high].

    `start` is where a search may begin (a published posterior median), `log` says whether a search should
    step in its logarithm, which leaves the prior as it is.
    """

    name: str
    unit: str
    low: float
    high: float
    start: float
    log: bool = True


@dataclass(frozen=True)
class Base:
    """A model to which effects are added: a wall law, and stiffness alike in all vessels or by radius.

    Parameters
    ----------
    name : str
    wall : {"linear", "tangent"}
    parameters : tuple of BaseParameter
        With the priors of the models in `models`.
    models : tuple of str
        Letters of the models that share this mean.
    wall_factor : float or None
        Instead of the conventions' own, as model I has it.
    """

    name: str
    wall: str
    parameters: tuple[BaseParameter, ...]
    models: tuple[str, ...]
    wall_factor: float | None = None

    def case(
        self,
        study: Study,
        theta: Mapping[str, float] | Sequence[float] | Array,
        options: SolverOptions | None = None,
        *,
        conventions: Conventions | None = None,
    ) -> Case:
        """The base's case for a study at one set of parameters.

        Parameters
        ----------
        study : Study
        theta : mapping by name, or sequence in the order of `parameters`
        options : SolverOptions
        conventions : Conventions
            Instead of the study's own.

        Returns
        -------
        Case

        Raises
        ------
        EffectError
            If a parameter is missing or unknown.
        """
        names = tuple(p.name for p in self.parameters)
        values = dict(theta) if isinstance(theta, Mapping) else dict(zip(names, theta, strict=False))
        if set(values) != set(names) or len(theta) != len(names):
            raise EffectError(f"base {self.name}: {len(theta)} parameters: give {', '.join(names)}")
        chosen = conventions or study.conventions
        if conventions is None and self.wall_factor is not None:
            chosen = chosen.replace(wall_factor=self.wall_factor)
        network = _network(study)
        if "f1" in values:
            stiffness = stiffness_profile(
                network.radius_in_cm,
                float(values["f1"]),
                float(values["f2"]),
                float(values["f3"]),
                chosen.stiffness_radius_unit_cm,
            )
        else:
            stiffness = np.full(len(network.ids), float(values["f3"]))

        def alike(name: str, otherwise: float = 1.0) -> Array:
            return np.full(len(network.ids), float(values.get(name, otherwise)))

        return Case(
            network=network,
            inflow_time_s=study.inflow_time_s,
            inflow_ml_s=study.inflow_ml_s,
            conventions=chosen,
            wall=self.wall,
            options=options or SolverOptions(),
            physics=Physics(),
            stiffness=stiffness,
            gamma=alike("gamma", 2.0),
            psi1=alike("psi1"),
            psi2=alike("psi2"),
            c=alike("c"),
        )

    @property
    def start(self) -> dict[str, float]:
        """Where a search may begin, by name."""
        return {p.name: p.start for p in self.parameters}


@functools.lru_cache(maxsize=8)
def _network(study: Study) -> Network:
    return Network.from_study(study)


def _outlets(psi1: float, psi2: float, c: float) -> tuple[BaseParameter, ...]:
    return tuple(
        BaseParameter(name, "1", 0.05, 2.5, start)
        for name, start in (("psi1", psi1), ("psi2", psi2), ("c", c))
    )


_CHI = "g cm-1 s-2"
_F2 = "1/stiffness_radius_unit_cm"
BASES: dict[str, Base] = {
    base.name: base
    for base in (
        Base(
            "linear-constant",
            "linear",
            (BaseParameter("f3", _CHI, 2e4, 1e5, 4.31e4), *_outlets(0.28, 0.87, 1.35)),
            ("A", "B", "C"),
        ),
        Base(
            "linear-radius",
            "linear",
            (
                BaseParameter("f1", _CHI, 1e3, 1e7, 51.1e5),
                BaseParameter("f2", _F2, -300, -50, -171.0, False),
                BaseParameter("f3", _CHI, 3e4, 6e4, 4.32e4),
                *_outlets(0.29, 0.87, 1.34),
            ),
            ("D", "E"),
        ),
        Base(
            "tangent-constant",
            "tangent",
            (
                BaseParameter("f3", _CHI, 3e4, 5e5, 9.17e4),
                BaseParameter("gamma", "1", 1, 2 * math.pi, 5.18),
                *_outlets(0.37, 0.94, 1.60),
            ),
            ("H",),
        ),
        Base(
            "tangent-radius",
            "tangent",
            (
                BaseParameter("f1", _CHI, 5e3, 1e5, 0.58e5),
                BaseParameter("f2", _F2, -200, 0, -6.0, False),
                BaseParameter("f3", _CHI, 1e4, 5e5, 2.00e4),
                BaseParameter("gamma", "1", 1, 2 * math.pi, 5.09),
                *_outlets(0.34, 0.97, 1.58),
            ),
            ("I",),
            wall_factor=1.0,
        ),
    )
}
"""Base models by name."""


def get_base(name: str) -> Base:
    """A base by its name, or by the letter of a model that shares its mean.

    Parameters
    ----------
    name : str
        Such as "linear-constant" or "B".

    Returns
    -------
    Base

    Raises
    ------
    EffectError
        If there is none.
    """
    if name in BASES:
        return BASES[name]
    for base in BASES.values():
        if name.upper() in base.models:
            return base
    if name.upper() in ("F", "G"):
        raise EffectError(
            f"base {name!r}: has a stiffness of its own for each vessel, which local-stiffness already is; "
            "use linear-constant"
        )
    letters = [letter for base in BASES.values() for letter in base.models]
    raise EffectError(f"base {name!r}: {nearest(name, [*BASES, *letters])}")


def effects_for(base: str, names: Sequence[str] | None = None) -> tuple[str, ...]:
    """Names of effects, each of which a base can take, once each; all of the catalogue if none are given.

    Parameters
    ----------
    base : str
        Its name.
    names : sequence of str, optional

    Raises
    ------
    EffectError
        For a name that is not in the catalogue, or an effect that the base cannot take.
    """
    if names is None:
        return tuple(name for name, effect in CATALOGUE.items() if effect.offered(base))
    for name in names:
        effect = CATALOGUE[name]
        if not effect.offered(base):
            only = ", ".join(effect.baselines)
            raise EffectError(f"effect {name}: cannot be added to {get_base(base).name}, only to {only}")
    return tuple(dict.fromkeys(names))
