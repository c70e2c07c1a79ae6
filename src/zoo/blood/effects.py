"""What a base model may lack: a catalogue of effects, each switched on by an amplitude that is 0 in the base.

An effect takes a `Case`, a solve about to be made, and returns a changed copy: another network, another
inflow, other parameters, terms inside the solver (`zoo.blood.solver.Physics`), or a function that acts on the
solved waves, as a sensor does. To add one, copy any function of the last part of this file with its
`@effect(...)`; docs/effects.md shows one of ten lines.
"""

from __future__ import annotations

import difflib
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.blood.conventions import Conventions
from zoo.blood.network import Network, stiffness_profile
from zoo.blood.solver import PUBLISHED_CELLS_PER_CM, Physics, Solver, SolverArgumentError, SolverOptions
from zoo.blood.study import QUANTITIES, Study

Array = NDArray[np.float64]

FAMILIES = (
    "geometry",
    "wall",
    "fluid",
    "junctions",
    "outflow",
    "surroundings",
    "inflow",
    "sensor",
    "noise",
    "numerics",
)
"""In this order effects are applied: first what others read, such as lengths and radii."""
WAVE_SAMPLES = 1024
"""Samples of a beat on which functions of the waves act."""
GRAVITY = 980.665
"""cm/s2."""


class EffectError(ValueError):
    """An effect, base or place that does not exist, or one that does not fit the case."""


# ---------------------------------------------------------------------------------------------------
# A solve about to be made


@dataclass(frozen=True)
class Wave:
    """Waveforms over one beat, which sensors act on.

    Parameters
    ----------
    value : array (n_series, n)
        At times m period/n, each series in its own unit.
    quantity : tuple of str
        "pressure_mmHg", "flow_ml_s" or "area_cm2", for each series.
    period_s : float
        s.
    """

    value: Array
    quantity: tuple[str, ...]
    period_s: float

    @property
    def is_pressure(self) -> NDArray[np.bool_]:
        """Which series are pressures, (n_series,)."""
        return np.array([q == "pressure_mmHg" for q in self.quantity], dtype=bool)


@dataclass(frozen=True, eq=False)
class Case:
    """A solve about to be made: what an effect may change.

    Parameters
    ----------
    network : Network
    inflow_time_s, inflow_ml_s : array (n,)
        Flow into the root over one beat.
    conventions : Conventions
    wall : {"linear", "tangent"}
    options : SolverOptions
    physics : Physics
        Terms inside the solver.
    stiffness, gamma, psi1, psi2, c : array (n_vessels,)
        chi (g cm-1 s-2), the tangent wall's gamma, and the factors of the nominal R1, R2, C.
    waves : tuple of functions
        From `Wave` to `Wave`, applied to the solution in this order.
    coarse_blend : float
        a in y + a (y(2 dx) - y), where y(2 dx) is a second solve with cells twice as long.
    """

    network: Network
    inflow_time_s: Array
    inflow_ml_s: Array
    conventions: Conventions
    wall: str
    options: SolverOptions
    physics: Physics
    stiffness: Array
    gamma: Array
    psi1: Array
    psi2: Array
    c: Array
    waves: tuple[Callable[[Wave], Wave], ...] = ()
    coarse_blend: float = 0.0


def simulate(
    case: Case, series: Sequence[tuple[int, float, str]], times_s: ArrayLike
) -> tuple[Array, str | None]:
    """Solve a case and sample it.

    Without functions of the waves this is ``Solver(...).solve(...)``, bit for bit. They act on
    `WAVE_SAMPLES` uniform samples of the beat, and what they add there is added to the solution after
    periodic cubic interpolation.

    Parameters
    ----------
    case : Case
    series : sequence of (vessel id, position, quantity)
        Position 0 is the vessel's inlet, 1 its outlet.
    times_s : array (n_times,)
        s, from the start of the beat.

    Returns
    -------
    array (n_series, n_times)
        Each series in its own unit; NaN when the solve failed.
    str or None
        Why it failed, or None.

    Raises
    ------
    zoo.blood.study.StudyError
        If a vessel is not in the network.
    EffectError
        If a position or a quantity does not exist.
    """
    for vessel, position, quantity in series:
        case.network.index(vessel)
        if quantity not in QUANTITIES:
            raise EffectError(f"quantity = {quantity!r}: {_near(quantity, QUANTITIES)}")
        if not 0 <= position <= 1:
            raise EffectError(f"position = {position!r} of vessel {vessel}: must be in [0, 1]")
    times = np.asarray(times_s, dtype=np.float64)
    period = case.network.period_s
    beat = np.arange(WAVE_SAMPLES) * (period / WAVE_SAMPLES)
    wanted = np.concatenate([times, beat]) if case.waves else times

    solved, reason = _sample(case, series, wanted)
    if reason is None and case.coarse_blend:
        coarse, reason = _sample(_coarser(case), series, wanted)
        solved = solved + case.coarse_blend * (coarse - solved)
    if reason is not None:
        return np.full((len(series), len(times)), np.nan), reason
    if not case.waves:
        return solved, None

    plain = solved[:, len(times) :]
    wave = Wave(plain, tuple(quantity for _, _, quantity in series), period)
    for act in case.waves:
        wave = act(wave)
    return solved[:, : len(times)] + _periodic(wave.value - plain, period, times), None


def _sample(case: Case, series: Sequence[tuple[int, float, str]], times: Array) -> tuple[Array, str | None]:
    try:
        solver = Solver(
            case.network,
            case.inflow_time_s,
            case.inflow_ml_s,
            wall=case.wall,
            conventions=case.conventions,
            series=[(vessel, position) for vessel, position, _ in series],
            times_s=times,
            options=case.options,
            physics=case.physics,
        )
        solution = solver.solve(case.stiffness, case.gamma, case.psi1, case.psi2, case.c, check=False)
    except SolverArgumentError as error:
        return np.empty(0), str(error)
    if not solution.ok:
        return np.empty(0), solution.reason
    values = np.array([getattr(solution, quantity)[i] for i, (_, _, quantity) in enumerate(series)])
    values = values.reshape(len(series), len(times))
    if not np.all(np.isfinite(values)):
        return np.empty(0), "the solution is not finite"
    return values, None


def _coarser(case: Case) -> Case:
    """The same with cells twice as long, and with them the time step."""
    case = with_true_lengths(case)
    steps = case.options.steps_per_beat
    coarse = max(32, steps // 2) if steps else 0
    return replace(case, options=replace(case.options, dx_cm=2 * case.options.dx_cm, steps_per_beat=coarse))


def _periodic(values: Array, period: float, times: Array) -> Array:
    """Cubic spline through uniform samples of a beat, (n_series, n) to (n_series, n_times)."""
    from scipy.interpolate import CubicSpline

    n = values.shape[1]
    closed = np.concatenate([values, values[:, :1]], axis=1)
    spline = CubicSpline(np.arange(n + 1) * (period / n), closed, axis=1, bc_type="periodic")
    return np.asarray(spline(np.mod(times, period)))


# ---------------------------------------------------------------------------------------------------
# What an effect is


@dataclass(frozen=True)
class Amplitude:
    """A parameter of an effect, with its prior: normal(centre, scale), truncated to [low, high].

    Parameters
    ----------
    name, unit : str
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
        False for a shape, which says nothing while the effect's first amplitude is 0.
    continuous : bool
        False for a switch: the smallest nonzero value is already far from the base.
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


class Place(NamedTuple):
    """Where an effect acts: nowhere in particular, one vessel (its id), or that one and all below."""

    vessel: int | None = None
    subtree: bool = False

    def __str__(self) -> str:
        if self.vessel is None:
            return "everywhere"
        return f"vessel {self.vessel} and below" if self.subtree else f"vessel {self.vessel}"


Change = Callable[[Case, tuple[float, ...], Place], Case]


@dataclass(frozen=True)
class Effect:
    """One thing that a base model may lack.

    Parameters
    ----------
    name : str
    family : str
        One of `FAMILIES`.
    statement, equation, source : str
        What it is, in words and as an equation, and where that comes from.
    signature : str
        What it does to a beat.
    amplitudes : tuple of Amplitude
        The first is 0 in the base.
    places : function
        From a network to the places at which it can act; ``(Place(),)`` when it has none.
    apply : function or None
        ``apply(case, values, place) -> Case``, a value for each amplitude; the case itself when the first
        value is 0. Values are not held to the prior's bounds. None for noise, which is no part of a solve.
    bases : tuple of str
        Names of the bases that it can be added to; empty means all.
    """

    name: str
    family: str
    statement: str
    equation: str
    source: str
    signature: str
    amplitudes: tuple[Amplitude, ...]
    places: Callable[[Network], tuple[Place, ...]]
    apply: Change | None
    bases: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise EffectError(f"effect {self.name}: family = {self.family!r}: {_near(self.family, FAMILIES)}")

    def offered(self, base: str) -> bool:
        """Whether it can be added to a base, by the base's name."""
        return not self.bases or get_base(base).name in self.bases

    # the functions inside an effect have no importable name, so a pickle keeps the effect's own
    def __reduce__(self) -> Any:
        if CATALOGUE.get(self.name) is self:
            return get_effect, (self.name,)
        return Effect, tuple(getattr(self, f.name) for f in fields(self))


CATALOGUE: dict[str, Effect] = {}
"""All effects by name, in the order in which those of a family are applied."""


def _near(word: object, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(str(word), known, 1, 0.5)
    return f"unknown; {f'did you mean {close[0]!r}? ' if close else ''}use one of {', '.join(known)}"


def get_effect(name: str) -> Effect:
    """An effect of the catalogue by its name.

    Raises
    ------
    EffectError
        If there is none; the text names the nearest.
    """
    if name not in CATALOGUE:
        raise EffectError(f"effect {name!r}: {_near(name, list(CATALOGUE))}")
    return CATALOGUE[name]


def apply_all(case: Case, added: Sequence[tuple[Effect, Sequence[float], Place]]) -> Case:
    """A case with several effects, in the catalogue's order whatever the order given.

    Parameters
    ----------
    case : Case
    added : sequence of (Effect, values, Place)
        Values for each of the effect's amplitudes.

    Returns
    -------
    Case

    Raises
    ------
    EffectError
        If an effect acts on the errors and not on a solve, or does not fit the case.
    """
    names = list(CATALOGUE)

    def order(item: tuple[Effect, Sequence[float], Place]) -> tuple[int, int]:
        made = item[0]
        return FAMILIES.index(made.family), names.index(made.name) if made.name in names else len(names)

    for made, values, place in sorted(added, key=order):
        if made.apply is None:
            raise EffectError(f"effect {made.name}: is part of the errors; it cannot be applied to a case")
        case = made.apply(case, tuple(float(value) for value in values), place)
    return case


def everywhere(network: Network) -> tuple[Place, ...]:
    """The only place of an effect that has none."""
    return (Place(),)


def each_vessel(network: Network) -> tuple[Place, ...]:
    """Every vessel."""
    return tuple(Place(int(vessel)) for vessel in network.ids)


def vessels_and_subtrees(network: Network) -> tuple[Place, ...]:
    """Every vessel, and everything below and with each vessel that is neither the root nor a terminal."""
    inner = [i for i in range(1, len(network.ids)) if len(network.children(i))]
    return each_vessel(network) + tuple(Place(int(network.ids[i]), True) for i in inner)


def sides_and_terminals(network: Network) -> tuple[Place, ...]:
    """The sides of the first branching, one of two or all of more, and every terminal."""
    at = 0
    while len(network.children(at)) == 1:
        at = int(network.children(at)[0])
    sides = network.ids[network.children(at)]
    sides = sides[: 1 if len(sides) == 2 else len(sides)]
    terminals = network.ids[network.terminals]
    return tuple(Place(int(v), True) for v in sides) + tuple(Place(int(v)) for v in terminals)


def members(network: Network, place: Place) -> NDArray[np.bool_]:
    """Which vessels a place holds, (n_vessels,).

    Raises
    ------
    zoo.blood.study.StudyError
        If its vessel is not in the network.
    """
    if place.vessel is None:
        return np.ones(len(network.ids), dtype=bool)
    inside = np.zeros(len(network.ids), dtype=bool)
    inside[network.index(place.vessel)] = True
    if place.subtree:
        for i, parent in enumerate(network.parent):
            inside[i] |= parent >= 0 and inside[parent]
    return inside


def effect(
    name: str,
    family: str,
    *,
    equation: str,
    source: str,
    signature: str,
    amplitudes: Sequence[Amplitude],
    why: str,
    places: Callable[[Network], tuple[Place, ...]] = everywhere,
    bases: Sequence[str] = (),
) -> Callable[[Change], Effect]:
    """Put an effect into the catalogue: a decorator of the function that changes the case.

    Parameters
    ----------
    name, family, equation, source, signature, amplitudes, places, bases
        As in `Effect`; its statement is the function's docstring.
    why : str
        Reason for the scale of the first amplitude.

    Returns
    -------
    function
        From ``change(case, values, place) -> Case`` to the `Effect`. `change` is called only when the
        first value is not 0.
    """

    def register(change: Change) -> Effect:
        def apply(case: Case, values: tuple[float, ...], place: Place) -> Case:
            if len(values) != len(amplitudes) or not all(math.isfinite(value) for value in values):
                wanted = ", ".join(f"{a.name} ({a.unit})" for a in amplitudes)
                raise EffectError(f"effect {name}: values = {values}: give finite numbers for {wanted}")
            if places is not everywhere and place.vessel is None:
                raise EffectError(f"effect {name}: place: is missing; give a vessel's id")
            return change(case, values, place) if values[0] else case

        texts = (name, family, (change.__doc__ or "").strip(), equation, source, signature)
        explained = (replace(amplitudes[0], why=why), *amplitudes[1:])
        made = Effect(*texts, explained, places, apply, tuple(bases))
        CATALOGUE[name] = made
        return made

    return register


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
_CONSTANT = ("linear-constant", "tangent-constant")
_LINEAR = ("linear-constant", "linear-radius")


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
    raise EffectError(f"base {name!r}: {_near(name, [*BASES, *letters])}")


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
        effect = get_effect(name)
        if not effect.offered(base):
            only = ", ".join(effect.bases)
            raise EffectError(f"effect {name}: cannot be added to {get_base(base).name}, only to {only}")
    return tuple(dict.fromkeys(names))


# ---------------------------------------------------------------------------------------------------
# Steps that effects share


def with_true_lengths(case: Case) -> Case:
    """The same case with the lengths that its grid has, where the conventions truncate them.

    Truncated lengths come in steps of 1/40 cm; an effect that changes a length must not.
    """
    if not case.conventions.truncate_lengths:
        return case
    cells = np.floor(PUBLISHED_CELLS_PER_CM * case.network.length_cm + 1e-9)
    return replace(
        case,
        network=replace(case.network, length_cm=cells / PUBLISHED_CELLS_PER_CM),
        conventions=case.conventions.replace(truncate_lengths=False),
        options=replace(case.options, dx_cm=1 / PUBLISHED_CELLS_PER_CM),
    )


def with_network(case: Case, **arrays: Any) -> Case:
    """The case with some of its network's arrays changed."""
    return replace(case, network=replace(case.network, **arrays))


def with_physics(case: Case, **terms: Any) -> Case:
    """The case with some terms of its physics changed."""
    return replace(case, physics=replace(case.physics, **terms))


def with_offset(case: Case, at_inlet: ArrayLike, at_outlet: ArrayLike) -> Case:
    """The case with something added to the wall's pressure, dyn/cm2, linear along each vessel."""
    zero = np.zeros(len(case.network.ids))

    def total(old: Array | None, added: ArrayLike) -> Array:
        return np.asarray((zero if old is None else old) + np.asarray(added, dtype=np.float64))

    old = case.physics
    return with_physics(
        case,
        offset_in=total(old.offset_in, at_inlet),
        offset_out=total(old.offset_out, at_outlet),
    )


def with_wave(case: Case, act: Callable[[Wave], Wave]) -> Case:
    """The case with one more function of the waves, after those it has."""
    return replace(case, waves=(*case.waves, act))


def total_resistance(case: Case) -> Array:
    """psi1 R1 + psi2 R2 of every vessel, dyn s/cm5, NaN where there is no terminal; (n_vessels,)."""
    return np.asarray(case.psi1 * case.network.R1 + case.psi2 * case.network.R2)


def wall_slope(case: Case) -> Array:
    """dp/d(A/A0) at rest, dyn/cm2, (n_vessels,): (2/3) chi, or k chi pi/gamma of the tangent wall."""
    if case.wall == "linear":
        return np.asarray(2 / 3 * case.stiffness)
    return np.asarray(case.conventions.wall_factor * case.stiffness * math.pi / case.gamma)


def filtered(values: Array, period_s: float, response: Callable[[Array], NDArray[Any]]) -> Array:
    """Periodic samples after a linear filter.

    Parameters
    ----------
    values : array (..., n)
        Over one period.
    period_s : float
    response : function
        Complex response at the angular frequencies (rad/s) of the harmonics from 0 up.

    Returns
    -------
    array (..., n)
    """
    n = values.shape[-1]
    harmonics = 2 * math.pi / period_s * np.arange(n // 2 + 1)
    return np.fft.irfft(np.fft.rfft(values) * response(harmonics), n)


def _add(wave: Wave, amount_mmHg: float) -> Wave:
    return replace(wave, value=wave.value + amount_mmHg * wave.is_pressure[:, None])


def _scale(wave: Wave, gain: float) -> Wave:
    return replace(wave, value=wave.value * (1 + gain * wave.is_pressure[:, None]))


def _filter(wave: Wave, response: Callable[[Array], NDArray[Any]], only_pressure: bool) -> Wave:
    changed = filtered(wave.value, wave.period_s, response)
    if only_pressure:
        changed = np.where(wave.is_pressure[:, None], changed, wave.value)
    return replace(wave, value=changed)


def _low_pass(omega: Array, time_s: float) -> NDArray[Any]:
    return np.asarray(1 / (1 + 1j * omega * time_s))


def _delay(omega: Array, time_s: float) -> NDArray[Any]:
    return np.asarray(np.exp(-1j * omega * time_s))


def _resonance(omega: Array, natural_period_s: float, damping: float) -> NDArray[Any]:
    ratio = omega * natural_period_s / (2 * math.pi)
    return np.asarray(1 / (1 - ratio**2 + 2j * damping * ratio))


def _jitter(omega: Array, sd_s: float) -> NDArray[Any]:
    return np.asarray(np.exp(-0.5 * (omega * sd_s) ** 2))


def relative_viscosity(diameter_um: ArrayLike) -> Array:
    """Viscosity of blood in a tube over that of its plasma, at a haematocrit of 0.45.

    mu = 220 exp(-1.3 d) + 3.2 - 2.44 exp(-0.06 d^0.645).

    Parameters
    ----------
    diameter_um : array
        Micrometres.

    Returns
    -------
    array

    References
    ----------
    Pries et al. 1992, doi 10.1152/ajpheart.1992.263.6.H1770.
    """
    d = np.asarray(diameter_um, dtype=np.float64)
    return np.asarray(220 * np.exp(-1.3 * d) + 3.2 - 2.44 * np.exp(-0.06 * d**0.645))


LARGE_VESSEL_VISCOSITY = 3.2
"""Limit of `relative_viscosity` in wide tubes."""


def ladder_sections(n: int) -> tuple[Array, Array]:
    """Foster form of a ladder of n equal sections, each C/n to ground, then R2/n on to the next.

    The nodes obey (C/n) dv/dt + (n/R2) T v = q e1 with T tridiagonal, so with eigenvalues l_k and
    eigenvectors u_k of T the impedance is the sum of R_k/(1 + i w R_k C_k), R_k = R2 u_k1^2/(n l_k) and
    C_k = C/(n u_k1^2).

    Parameters
    ----------
    n : int
        From 1, which is the Windkessel.

    Returns
    -------
    array (n,)
        rho, R_k/R2; they add up to 1.
    array (n,)
        kappa, C_k/C.
    """
    matrix = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    matrix[0, 0] = 1
    values, vectors = np.linalg.eigh(matrix)
    weight = n * vectors[0] ** 2
    return weight / (n**2 * values), 1 / weight


def _sections(case: Case) -> tuple[Array, Array]:
    """Sections of every vessel's outlet, (n_vessels, n_sections); one, the Windkessel, unless changed."""
    old = case.physics
    if old.section_resistance is None or old.section_compliance is None:
        ones = np.ones((len(case.network.ids), 1))
        return ones, ones
    return old.section_resistance, old.section_compliance


def _blended(parts: Sequence[tuple[float | Array, Array, Array]]) -> dict[str, Array]:
    """Sections of a weighted sum of impedances: R_k weight, C_k/weight; those of no weight are left out."""
    rho = np.concatenate([weight * rho for weight, rho, _ in parts], axis=1)
    with np.errstate(divide="ignore"):
        kappa = np.concatenate([kappa / weight for weight, _, kappa in parts], axis=1)
    kept = np.any(rho != 0, axis=0)
    rho, kappa = rho[:, kept], kappa[:, kept]
    return {"section_resistance": rho, "section_compliance": np.where(rho == 0, 1.0, kappa)}


# ---------------------------------------------------------------------------------------------------
# Geometry


@effect(
    "vessel-radius",
    "geometry",
    equation="r0 -> r0 exp(a) in one vessel",
    source="Paun et al. 2020, doi 10.1098/rsif.2020.0886, takes the radii of a micro-CT image as exact",
    signature="a reflection from both ends of the vessel; very like its stiffness",
    amplitudes=[Amplitude("log-radius", "1", 0.15, -0.7, 0.7, (0.1, -0.1))],
    why="resolution of the image, and the tone that an excised lung has lost",
    places=each_vessel,
)
def vessel_radius(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """One vessel is wider or narrower than measured."""
    factor = np.where(members(case.network, place), math.exp(values[0]), 1.0)
    net = case.network
    return with_network(
        case, radius_in_cm=net.radius_in_cm * factor, radius_out_cm=net.radius_out_cm * factor
    )


@effect(
    "vessel-length",
    "geometry",
    equation="L -> L exp(a) in one vessel",
    source="Paun et al. 2020, doi 10.1098/rsif.2020.0886, takes the lengths of a micro-CT image as exact",
    signature="moves in time what the vessel's far end sends back, and adds its volume's compliance",
    amplitudes=[Amplitude("log-length", "1", 0.2, -1.0, 1.0, (0.2, -0.2))],
    why="where a vessel ends in a branching is known to about a diameter, a fifth of its length",
    places=each_vessel,
)
def vessel_length(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """One vessel is longer or shorter than measured."""
    case = with_true_lengths(case)
    factor = np.where(members(case.network, place), math.exp(values[0]), 1.0)
    return with_network(case, length_cm=case.network.length_cm * factor)


@effect(
    "taper",
    "geometry",
    equation="r0(outlet) -> r0(outlet) (1 - t), linear from the inlet",
    source="Olufsen et al. 2000, doi 10.1114/1.1326031, has tapering vessels",
    signature="a higher and earlier peak: the pressure's reflections are spread over the vessels",
    amplitudes=[Amplitude("taper", "1", 0.2, -0.5, 0.6, (0.15, -0.15))],
    why="daughters have 0.5 to 0.8 of the parent's radius, and a third of that may lie within a vessel",
)
def taper(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """Every vessel narrows towards its outlet."""
    return with_network(case, radius_out_cm=case.network.radius_out_cm * (1 - values[0]))


@effect(
    "stenosis",
    "geometry",
    equation="r0 -> r0 (1 - s (1 + cos(2 pi (x - L/2)/l))/2) within l; a loss K_t rho/2 (A0/A_t - 1)^2 u|u|",
    source="Young & Tsai 1973, doi 10.1016/0021-9290(73)90099-7 (K_t = 1.52)",
    signature="raises pressure above it while flow is large and delays what comes back from below",
    amplitudes=[Amplitude("severity", "1", 0.3, 0.0, 0.85, (0.5, 0.25))],
    why="share of the radius: 0.3 halves the area",
    places=each_vessel,
)
def stenosis(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """One vessel has a short throat in its middle."""
    inside = members(case.network, place)
    zero = np.zeros(len(inside))
    old = zero if case.physics.throat_severity is None else case.physics.throat_severity
    return with_physics(
        case,
        throat_severity=np.where(inside, 1 - (1 - old) * (1 - values[0]), old),
        throat_length=np.minimum(0.15, 0.8 * case.network.length_cm),
    )


# ---------------------------------------------------------------------------------------------------
# Wall


@effect(
    "tangent-wall",
    "wall",
    equation="p = k chi_t tan(pi/gamma (A/A0 - 1)), k chi_t pi/gamma = (2/3) chi",
    source="Paun et al. 2020, doi 10.1098/rsif.2020.0886, eq. (3.4)",
    signature="higher, narrower peaks: waves run faster at high pressure",
    amplitudes=[Amplitude("1/gamma", "1", 0.5, 0.02, 1.2, (0.2, 0.7), continuous=False)],
    why="models H and I allow 1/gamma from 0.16 to 1; the published medians are 0.19 and 0.20",
    bases=_LINEAR,
)
def tangent_wall(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The wall stiffens as it is stretched: eq. (3.4) with the linear wall's stiffness at rest."""
    if case.wall != "linear":
        raise EffectError("effect tangent-wall: the case has a tangent wall already; use a linear base")
    gamma = 1 / values[0]
    stiffness = wall_slope(case) * gamma / (math.pi * case.conventions.wall_factor)
    return replace(case, wall="tangent", stiffness=stiffness, gamma=np.full(len(stiffness), gamma))


@effect(
    "radius-dependent-stiffness",
    "wall",
    equation="chi -> chi (1 + a exp(-(r0 - r_min)/l)), r_min the smallest radius of the tree",
    source="Olufsen et al. 2000, doi 10.1114/1.1326031; Paun et al. 2020, doi 10.1098/rsif.2020.0886, (3.5)",
    signature="stronger, earlier reflections from the periphery; smaller pulse volume of the small vessels",
    amplitudes=[
        Amplitude("excess", "1", 1.0, -0.9, 8.0, (1.0, -0.4)),
        Amplitude(
            "decay",
            "cm",
            0.006,
            0.003,
            0.06,
            (0.0164,),
            "model I's median f2 is -6 per 0.1 cm, and a third of it either way",
            centre=0.0164,
            zero_is_base=False,
        ),
    ],
    why="the narrowest vessels twice as stiff as wide ones; model I's medians give 1.3",
    bases=_CONSTANT,
)
def radius_dependent_stiffness(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """Narrow vessels are stiffer than wide ones, eq. (3.5)."""
    radius = case.network.radius_in_cm
    return replace(
        case, stiffness=case.stiffness * (1 + values[0] * np.exp(-(radius - radius.min()) / values[1]))
    )


@effect(
    "local-stiffness",
    "wall",
    equation="chi -> chi exp(a) in one vessel or subtree",
    source="Paun et al. 2020, doi 10.1098/rsif.2020.0886, models F and G (a stiffness for each vessel)",
    signature="a reflection at the ends of the stiff part, the sooner the nearer",
    amplitudes=[Amplitude("log-stiffness", "1", 0.7, -2.5, 2.5, (0.5, -0.5))],
    why="a factor of two; models F and G allow each vessel 2e4 to 1e5, a factor of 2.2 either way",
    places=vessels_and_subtrees,
)
def local_stiffness(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """One vessel, or one vessel and all below it, is stiffer or softer than the rest."""
    factor = np.where(members(case.network, place), math.exp(values[0]), 1.0)
    return replace(case, stiffness=case.stiffness * factor)


@effect(
    "viscoelastic-wall",
    "wall",
    equation="p = p_e + tau dp_e/dt, p_e the elastic wall's pressure",
    source="Alastruey et al. 2011, doi 10.1016/j.jbiomech.2011.05.041",
    signature="damps high harmonics, the more the farther the wave has run; pressure leads area",
    amplitudes=[Amplitude("tau", "s", 3e-3, 0.0, 0.03, (2e-3, 8e-3))],
    why="pressure leads area by 2 pi tau/T in the first harmonic: 0.17 rad in a mouse's 0.11 s",
)
def viscoelastic_wall(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The wall resists fast stretching (Kelvin-Voigt)."""
    old = case.physics.viscoelastic_time
    added = np.full(len(case.network.ids), values[0])
    return with_physics(case, viscoelastic_time=added if old is None else old + added)


# ---------------------------------------------------------------------------------------------------
# Fluid


@effect(
    "velocity-profile",
    "fluid",
    equation="alpha = (zeta + 2)/(zeta + 1), friction -2 (zeta + 2) pi nu q/A, zeta = 2/a",
    source="Alastruey et al. 2011, doi 10.1016/j.jbiomech.2011.05.041",
    signature="another loss along the tree: a shift of the mean with flow and a steeper or flatter decay",
    amplitudes=[Amplitude("2/zeta", "1", 0.7, 0.05, 1.5, (1.0, 0.25), continuous=False)],
    why="from nearly flat to parabolic (1): the range of steady laminar profiles",
)
def velocity_profile(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The velocity profile is a power of the radius, not flat with a Stokes layer; parabolic at 1."""
    zeta = 2 / values[0]
    return with_physics(
        case,
        momentum_correction=(zeta + 2) / (zeta + 1),
        stokes_friction=0.0,
        viscous_friction=2 * (zeta + 2),
    )


@effect(
    "radius-dependent-viscosity",
    "fluid",
    equation="mu -> mu (1 + s (m(d)/3.2 - 1)), m = 220 exp(-1.3 d) + 3.2 - 2.44 exp(-0.06 d^0.645), d in um",
    source="Pries et al. 1992, doi 10.1152/ajpheart.1992.263.6.H1770 (haematocrit 0.45)",
    signature="a little less loss in small vessels; hardly seen, the Windkessels take it up",
    amplitudes=[Amplitude("share", "1", 1.0, 0.0, 1.5, (1.0, 0.5))],
    why="1 is the published law; half as much again as its bound",
)
def radius_dependent_viscosity(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """Blood is thinner in narrow vessels (Fahraeus-Lindqvist)."""
    diameter_um = 1e4 * (case.network.radius_in_cm + case.network.radius_out_cm)
    factor = 1 + values[0] * (relative_viscosity(diameter_um) / LARGE_VESSEL_VISCOSITY - 1)
    old = case.physics.viscosity_factor
    return with_physics(case, viscosity_factor=factor if old is None else old * factor)


@effect(
    "hydrostatic",
    "fluid",
    equation="P = wall(A) + rho g s x, P = p + rho g s x the measured pressure, x the path from the root",
    source="Clark et al. 2011, doi 10.1152/japplphysiol.00775.2010 (gravity in the lung's arteries)",
    signature="distends low vessels and narrows high ones; changes wave speed and compliance along the tree",
    amplitudes=[Amplitude("slope", "1", 0.5, -1.0, 1.0, (0.6, -0.6))],
    why="sine of the mean slope, -1 to 1 by definition; paths turn, so seldom near its bounds",
)
def hydrostatic(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The tree rises from the heart; pressures are a fluid-filled catheter's, its zero at the root."""
    net = with_true_lengths(case).network
    start = np.zeros(len(net.ids))
    for i, parent in enumerate(net.parent):
        if parent >= 0:
            start[i] = start[parent] + net.length_cm[parent]
    weight = net.density * GRAVITY * values[0]
    return with_offset(case, weight * start, weight * (start + net.length_cm))


# ---------------------------------------------------------------------------------------------------
# Junctions


@effect(
    "total-pressure-junctions",
    "junctions",
    equation="p + tau rho u^2/2 equal in all branches",
    source="Mynard & Valen-Sendstad 2015, doi 10.1002/cnm.2717",
    signature="a pressure step of rho u^2/2 at each junction in systole",
    amplitudes=[Amplitude("share", "1", 1.0, 0.0, 1.5, (1.0, 0.5))],
    why="1 is Bernoulli's law without loss, 0 the base",
)
def total_pressure_junctions(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """Vessels that meet share the total instead of the static pressure."""
    return with_physics(case, total_pressure=case.physics.total_pressure + values[0])


@effect(
    "minor-losses",
    "junctions",
    equation="p(daughter's inlet) = p(parent's outlet) - K rho/2 u|u|, u the parent's",
    source="Mynard & Valen-Sendstad 2015, doi 10.1002/cnm.2717",
    signature="lower distal pressure, higher proximal one, at peak flow; like taper",
    amplitudes=[Amplitude("K", "1", 2.0, 0.0, 15.0, (1.5, 5.0))],
    why="losses at a branching are of the order of the dynamic pressure; more where angles are sharp",
)
def minor_losses(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """Flow loses pressure where it divides."""
    return with_physics(case, junction_loss=case.physics.junction_loss + values[0])


# ---------------------------------------------------------------------------------------------------
# Outflow


@effect(
    "venous-pressure",
    "outflow",
    equation="p - p_v = R1 q + v, C dv/dt = q - v/R2",
    source="Qureshi et al. 2014, doi 10.1007/s10237-014-0563-y (2 mmHg in the left atrium)",
    signature="the same mean with a smaller resistance: a faster diastolic decay towards p_v",
    amplitudes=[Amplitude("p_v", "mmHg", 5.0, -10.0, 20.0, (5.0,))],
    why="2 to 12 mmHg in the atrium; below 0 only where the zero of the pressure is off",
)
def venous_pressure(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The Windkessels end at the left atrium's pressure instead of 0."""
    offset = np.full(len(case.network.ids), -values[0] * case.conventions.mmhg)
    return with_wave(with_offset(case, offset, offset), functools.partial(_add, amount_mmHg=values[0]))


@effect(
    "uneven-resistance",
    "outflow",
    equation="R1, R2 -> R1 exp(a), R2 exp(a) on that side and exp(-a) on the other; or at one terminal",
    source="Qureshi et al. 2018, doi 10.1007/s10237-018-1078-8 (nominal shares by Poiseuille's law)",
    signature="flow moves to the other side; seen in flows and distal pressures more than at the root",
    amplitudes=[Amplitude("log-resistance", "1", 0.5, -2.0, 2.0, (0.6, -0.6))],
    why="a nominal share goes with r^4: 12 % of the radius is 0.5 in its logarithm",
    places=sides_and_terminals,
)
def uneven_resistance(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """One side of the tree, or one outlet, has more resistance than its nominal share."""
    otherwise = -values[0] if place.subtree else 0.0
    factor = np.exp(np.where(members(case.network, place), values[0], otherwise))
    return replace(case, psi1=case.psi1 * factor, psi2=case.psi2 * factor)


@effect(
    "terminal-inertance",
    "outflow",
    equation="p = v + R1 q + L dq/dt, L = rho l/A0 of the terminal, with 6 rho c/A0 parallel to L",
    source="Westerhof et al. 2009, doi 10.1007/s11517-008-0359-2",
    signature="high harmonics are reflected at the outlets; ripples after the upstroke",
    amplitudes=[Amplitude("length", "cm", 0.5, 0.0, 2.0, (0.1, 0.3))],
    why="as long a column as the vessel before it has, a few tenths of a cm in a mouse",
)
def terminal_inertance(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """Blood behind the outlets has inertia."""
    net = case.network
    added = np.zeros(len(net.ids))
    added[net.terminals] = net.density * values[0] / (math.pi * net.radius_out_cm[net.terminals] ** 2)
    old = case.physics.inertance
    return with_physics(case, inertance=added if old is None else old + added)


@effect(
    "side-branches",
    "outflow",
    equation="A_t + q_x = -G r0^m p; its sum over the tree is g times the sum of 1/(psi1 R1 + psi2 R2)",
    source="Olufsen et al. 2000, doi 10.1114/1.1326031 (the tree is cut where the image ends)",
    signature="a smaller resistance in all; waves are damped on their way",
    amplitudes=[
        Amplitude("conductance", "1", 0.3, 0.0, 3.0, (0.3, 1.0)),
        Amplitude(
            "exponent",
            "1",
            1.0,
            -1.0,
            4.0,
            (1.0,),
            "as many for each area of wall (1), give or take: for each length it is 0, for each volume 2",
            centre=1.0,
            zero_is_base=False,
        ),
    ],
    why="a few tenths of the terminals' conductance: most branches of this size are in the image",
)
def side_branches(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """Branches too small for the image leave the vessels all along."""
    net = with_true_lengths(case).network
    total = values[0] * np.sum(1 / total_resistance(case)[net.terminals])
    density = (0.5 * (net.radius_in_cm + net.radius_out_cm)) ** values[1]
    added = total * density / np.sum(density * net.length_cm)
    old = case.physics.leak
    return with_physics(case, leak=added if old is None else old + added)


@effect(
    "distributed-outflow",
    "outflow",
    equation="R1, then n times (C/n to ground, R2/n onward); its impedance is linear in n between whole n",
    source="Olufsen & Nadim 2004, Math. Biosci. Eng. 1, 61-80 (lumped models of downstream trees)",
    signature="less compliance for fast waves: a slower late decay with a higher pulse",
    amplitudes=[Amplitude("n - 1", "sections", 4.0, 0.0, 15.0, (2.0, 6.0))],
    why="beyond about 5 sections a ladder is near its limit, a transmission line",
)
def distributed_outflow(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """Compliance and resistance behind an outlet alternate in n sections instead of one."""
    if values[0] < 0:
        raise EffectError(f"effect distributed-outflow: n - 1 = {values[0]}: must not be negative")
    whole = math.floor(values[0])
    part = values[0] - whole
    n_vessels = len(case.network.ids)
    parts: list[tuple[float | Array, Array, Array]] = []
    for weight, n in ((1 - part, whole + 1), (part, whole + 2)):
        if weight:
            rho, kappa = ladder_sections(n)
            parts.append((weight, np.tile(rho, (n_vessels, 1)), np.tile(kappa, (n_vessels, 1))))
    return with_physics(case, **_blended(parts))


TREE_ALPHA, TREE_BETA = 0.9, 0.6
"""Radii of the two daughters over their parent's, in the small arteries' tree."""
TREE_DEPTH = 0.1
"""The tree ends where the radius is this part of the terminal's."""
TREE_HARMONICS = 40
TREE_POLES = 24


def _has_daughters(relative: float) -> bool:
    return relative >= TREE_DEPTH * (1 - 1e-9)


@functools.cache
def _tree_nodes() -> tuple[tuple[int, int, float, int], ...]:
    """Vessels of the tree by powers (i, j) of alpha and beta, smallest radii first.

    i, j, radius over the terminal's, and how many there are. Those whose radius is not below `TREE_DEPTH`
    have daughters.
    """
    many = {(0, 0): 1}
    for step in range(99):
        for i, j in [node for node in many if sum(node) == step]:
            if _has_daughters(TREE_ALPHA**i * TREE_BETA**j):
                for daughter in ((i + 1, j), (i, j + 1)):
                    many[daughter] = many.get(daughter, 0) + many[i, j]
    nodes = [(i, j, TREE_ALPHA**i * TREE_BETA**j, n) for (i, j), n in many.items()]
    return tuple(sorted(nodes, key=lambda node: node[2]))


@functools.lru_cache(maxsize=8)
def _tree_inertia(radius: tuple[float, ...], nu: float, omega: tuple[float, ...]) -> list[NDArray[Any]]:
    """1 - F of every vessel of the trees, a list of (n, m); see `tree_impedance`."""
    from scipy.special import jv

    inertia = []
    for _, _, relative, _ in _tree_nodes():
        r = np.array(radius)[:, None] * relative
        w = 1j**1.5 * r * np.sqrt(np.array(omega) / nu)
        inertia.append(1 - 2 * jv(1, w) / (w * jv(0, w)))
    return inertia


def tree_impedance(
    radius_cm: ArrayLike,
    resistance: ArrayLike,
    compliance: ArrayLike,
    density: float,
    viscosity: float,
    omega: ArrayLike,
) -> NDArray[np.complex128]:
    """Input impedance of the asymmetric tree of small arteries behind terminals.

    Every vessel of radius r has the length m r and daughters of 0.9 r and 0.6 r; one below a tenth of the
    terminal's radius has none, and the pressure at its end is 0. m and the wall's slope dp/d(A/A0), alike in
    the tree, are such that the steady resistance and the compliance of all vessels are the given ones. In a
    vessel, with F = 2 J1(w)/(w J0(w)) and w = i^1.5 r sqrt(omega/nu),

        Z(0) = (i/g tan(omega l/c) + Z(l))/(1 + i g Z(l) tan(omega l/c)),
        c^2 = slope (1 - F)/rho, g = c A0/slope,

    and 8 mu l/(pi r^4) + Z(l) at omega = 0.

    Parameters
    ----------
    radius_cm : array (n,)
        Of the terminals.
    resistance, compliance : array (n,)
        Of the whole trees, dyn s/cm5 and cm5/dyn.
    density, viscosity : float
        g/cm3 and g/(cm s).
    omega : array (m,)
        rad/s, the first of them 0.

    Returns
    -------
    complex array (n, m)
        dyn s/cm5.

    References
    ----------
    Olufsen et al. 2000, doi 10.1114/1.1326031.
    """
    root, wanted, stored = (
        np.asarray(values, dtype=np.float64)[:, None] for values in (radius_cm, resistance, compliance)
    )
    w = np.asarray(omega, dtype=np.float64)[1:]
    nodes = _tree_nodes()

    def joined(i: int, j: int, relative: float, among: Mapping[tuple[int, int], Any]) -> Any:
        """Impedance of two daughters, 0 where there are none."""
        return 1 / (1 / among[i + 1, j] + 1 / among[i, j + 1]) if _has_daughters(relative) else 0.0

    steady: dict[tuple[int, int], float] = {}  # in units of 8 mu m/(pi r^3) of the terminal's radius
    for i, j, relative, _ in nodes:
        steady[i, j] = relative**-3 + joined(i, j, relative, steady)
    volume = sum(many * relative**3 for _, _, relative, many in nodes)
    length_ratio = wanted * math.pi * root**3 / (8 * viscosity * steady[0, 0])
    slope = length_ratio * math.pi * root**3 * volume / stored

    waves: dict[tuple[int, int], NDArray[np.complex128]] = {}
    inertia = _tree_inertia(tuple(root[:, 0].tolist()), viscosity / density, tuple(w.tolist()))
    for (i, j, relative, _), inertial in zip(nodes, inertia, strict=True):
        r = root * relative
        speed = np.sqrt(slope * inertial / density)
        turn = np.tan(w * length_ratio * r / speed)
        g = speed * math.pi * r**2 / slope
        end = joined(i, j, relative, waves)
        waves[i, j] = (1j / g * turn + end) / (1 + 1j * g * end * turn)
    return np.concatenate([wanted.astype(np.complex128), waves[0, 0]], axis=1)


def foster_fit(impedance: NDArray[np.complex128], period_s: float) -> tuple[float, Array, Array]:
    """Resistance and parallel RC pairs in series whose impedance is nearest to a given one.

    Z(w) = R_0 + sum of R_k/(1 + i w tau_k) with fixed tau_k, spaced evenly in their logarithm, and the R by
    non-negative least squares of the relative error; exact for steady flow.

    Parameters
    ----------
    impedance : complex array (m,)
        At harmonics 0 to m - 1.
    period_s : float

    Returns
    -------
    float
        R_0, positive.
    array (n,), array (n,)
        R_k and tau_k (s).
    """
    from scipy.optimize import nnls

    omega = 2 * math.pi / period_s * np.arange(len(impedance))
    tau = period_s / (2 * math.pi) * np.geomspace(0.5 / len(impedance), 20, TREE_POLES)
    columns = 1 / (1 + 1j * omega[:, None] * np.concatenate([[0.0], tau]))
    weight = 1 / (np.abs(impedance) * np.sqrt(np.maximum(1, np.arange(len(impedance)))))
    weight[0] *= 1e3
    least = 1e-3 * impedance[0].real  # R_0 stands where R1 does, which must be positive
    rows = weight[:, None] * columns
    target = weight * (impedance - least)
    fitted, _ = nnls(np.concatenate([rows.real, rows.imag]), np.concatenate([target.real, target.imag]))
    fitted[0] += least
    fitted *= impedance[0].real / fitted.sum()
    return float(fitted[0]), fitted[1:], tau


@functools.lru_cache(maxsize=64)
def _tree_sections(
    radius: tuple[float, ...],
    resistance: tuple[float, ...],
    compliance: tuple[float, ...],
    density: float,
    viscosity: float,
    period_s: float,
) -> tuple[Array, Array, Array]:
    """R_0 (n,), R_k (n, n_poles) and tau_k (n_poles,) of the trees behind n terminals."""
    omega = 2 * math.pi / period_s * np.arange(TREE_HARMONICS + 1)
    impedance = tree_impedance(radius, resistance, compliance, density, viscosity, omega)
    fits = [foster_fit(z, period_s) for z in impedance]
    return np.array([fit[0] for fit in fits]), np.array([fit[1] for fit in fits]), fits[0][2]


@effect(
    "structured-tree",
    "outflow",
    equation="Z -> (1 - s) Z + s Z_tree; daughters of 0.9 and 0.6 r, resistance and compliance as before",
    source="Olufsen et al. 2000, doi 10.1114/1.1326031",
    signature="less abrupt reflections: a smoother late systole, and a decay of many time constants",
    amplitudes=[Amplitude("share", "1", 0.7, 0.0, 1.0, (0.5, 1.0))],
    why="1 is the tree alone, 0 the Windkessel alone",
)
def structured_tree(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """Behind each outlet lies a tree of small arteries, which sends waves back."""
    net, share, at = case.network, values[0], case.network.terminals
    first, resistance, tau = _tree_sections(
        tuple(net.radius_out_cm[at].tolist()),
        tuple(total_resistance(case)[at].tolist()),
        tuple((case.c * net.C)[at].tolist()),
        net.density,
        net.viscosity,
        net.period_s,
    )
    psi1, rho = case.psi1.copy(), np.zeros((len(net.ids), len(tau)))
    kappa = np.ones_like(rho)
    psi1[at] = (1 - share) * psi1[at] + share * first / net.R1[at]
    rho[at] = resistance / (case.psi2 * net.R2)[at, None]
    held = resistance > 0
    kappa[at] = np.where(held, tau / np.where(held, resistance, 1) / (case.c * net.C)[at, None], 1.0)
    blended = _blended([(1 - share, *_sections(case)), (share, rho, kappa)])
    return replace(with_physics(case, **blended), psi1=psi1)


# ---------------------------------------------------------------------------------------------------
# Surroundings


@effect(
    "external-pressure",
    "surroundings",
    equation="p = wall(A) + p_ext in all vessels",
    source="Clark et al. 2011, doi 10.1152/japplphysiol.00775.2010 (vessels within the lung's tissue)",
    signature="vessels are wider or narrower at the same pressure; almost that of sensor-offset",
    amplitudes=[Amplitude("p_ext", "mmHg", 3.0, -12.0, 12.0, (3.0, -3.0))],
    why="pleural pressure at rest is about -4 mmHg; some above 0 under ventilation",
)
def external_pressure(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The vessels lie in a pressure other than that of the pressures' zero (the chest's)."""
    offset = np.full(len(case.network.ids), values[0] * case.conventions.mmhg)
    return with_offset(case, offset, offset)


# ---------------------------------------------------------------------------------------------------
# Inflow

_INFLOW = "Paun et al. 2020, doi 10.1098/rsif.2020.0886, takes the measured inflow as exact"


@effect(
    "inflow-gain",
    "inflow",
    equation="q(t) -> (1 + g) q(t)",
    source=_INFLOW,
    signature="scales pressure and flow; the base's stiffness and resistances take most of it up",
    amplitudes=[Amplitude("gain", "1", 0.15, -0.6, 0.6, (0.15, -0.15))],
    why="error of a flow from ultrasound: 10 to 20 %",
)
def inflow_gain(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The inflow is measured too small or too large by a factor."""
    return replace(case, inflow_ml_s=case.inflow_ml_s * (1 + values[0]))


@effect(
    "inflow-offset",
    "inflow",
    equation="q(t) -> q(t) + f mean(q)",
    source=_INFLOW,
    signature="a shift of the mean pressure against its pulse, which the resistances take up",
    amplitudes=[Amplitude("offset", "mean flow", 0.1, -0.5, 0.5, (0.1, -0.1))],
    why="diastolic flow is read as 0 to within a tenth of the mean",
)
def inflow_offset(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The inflow's zero is off."""
    return replace(case, inflow_ml_s=case.inflow_ml_s + values[0] * case.inflow_ml_s.mean())


@effect(
    "inflow-shift",
    "inflow",
    equation="q(t) -> q(t - s)",
    source=_INFLOW + "; flow and pressure are recorded one after the other and aligned",
    signature="the whole beat moves in time; the derivative of the pressure",
    amplitudes=[Amplitude("shift", "s", 0.003, -0.02, 0.02, (0.002, -0.002))],
    why="a few samples of the alignment of two records by their upstrokes",
)
def inflow_shift(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """Flow and pressure are not recorded at the same time."""
    delay = functools.partial(_delay, time_s=values[0])
    return replace(case, inflow_ml_s=filtered(case.inflow_ml_s, case.network.period_s, delay))


@effect(
    "inflow-bandwidth",
    "inflow",
    equation="tau dy/dt + y = q",
    source=_INFLOW,
    signature="a later, slower upstroke and a lower peak; like a catheter's resonance",
    amplitudes=[Amplitude("tau", "s", 0.003, 0.0, 0.03, (0.002, 0.008))],
    why="a corner at 53 Hz, near the sixth harmonic of a mouse's beat",
)
def inflow_bandwidth(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The flow that enters is smoother than the one recorded."""
    low_pass = functools.partial(_low_pass, time_s=values[0])
    return replace(case, inflow_ml_s=filtered(case.inflow_ml_s, case.network.period_s, low_pass))


# ---------------------------------------------------------------------------------------------------
# Sensor


@effect(
    "catheter-resonance",
    "sensor",
    equation="y'' + 2 z w y' + w^2 y = w^2 p, w = 2 pi f_n",
    source="Gardner 1981, doi 10.1097/00000542-198103000-00010",
    signature="overshoot and ringing after the upstroke and the incisura, or a lag when damped",
    amplitudes=[
        Amplitude("1/f_n", "s", 0.015, 0.0, 0.08, (0.01, 0.03)),
        Amplitude(
            "damping",
            "1",
            0.2,
            0.02,
            1.5,
            (0.3,),
            "catheters are mostly underdamped, 0.1 to 0.6",
            centre=0.3,
            zero_is_base=False,
        ),
    ],
    why="a resonance at 67 Hz; fluid-filled lines have theirs at some tens of Hz, the bound is 12 Hz",
)
def catheter_resonance(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The catheter is a mass on a spring."""
    response = functools.partial(_resonance, natural_period_s=values[0], damping=values[1])
    return with_wave(case, functools.partial(_filter, response=response, only_pressure=True))


@effect(
    "sensor-gain",
    "sensor",
    equation="p -> (1 + g) p",
    source="Gardner 1981, doi 10.1097/00000542-198103000-00010 (calibration of the transducer)",
    signature="scales the pressures; at one sensor the base's stiffness and resistances take it up",
    amplitudes=[Amplitude("gain", "1", 0.1, -0.5, 0.5, (0.1, -0.1))],
    why="a calibration is good to a tenth at worst",
)
def sensor_gain(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The pressures are recorded too small or too large by a factor."""
    return with_wave(case, functools.partial(_scale, gain=values[0]))


@effect(
    "sensor-offset",
    "sensor",
    equation="p -> p + p_0",
    source="Gardner 1981, doi 10.1097/00000542-198103000-00010 (levelling and zeroing of the transducer)",
    signature="a constant; the resistances take it up but for the vessels' width; almost external-pressure",
    amplitudes=[Amplitude("offset", "mmHg", 2.0, -10.0, 10.0, (2.0, -2.0))],
    why="2.7 cm of height between transducer and heart; drift of a day",
)
def sensor_offset(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The pressures' zero is off."""
    return with_wave(case, functools.partial(_add, amount_mmHg=values[0]))


@effect(
    "beat-jitter",
    "sensor",
    equation="y -> y * normal(0, sd) in time, around the beat",
    source="definition: the mean of copies shifted by normal(0, sd)",
    signature="lower peak, slower upstroke, shallower incisura; mean and phase unchanged",
    amplitudes=[Amplitude("sd", "s", 0.004, 0.0, 0.02, (0.002, 0.006))],
    why="beats of a mouse at rest differ by a few per cent of 0.11 s",
)
def beat_jitter(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The recorded beat is a mean of beats that were not aligned."""
    response = functools.partial(_jitter, sd_s=values[0])
    return with_wave(case, functools.partial(_filter, response=response, only_pressure=False))


# ---------------------------------------------------------------------------------------------------
# Noise

CATALOGUE["correlated-noise"] = Effect(
    "correlated-noise",
    "noise",
    statement="The errors of neighbouring samples are alike.",
    equation="cov(e(t), e(t + d)) = sd^2 exp(-|d|/length) or sd^2 exp(-(d/length)^2/2), around the beat",
    source="Kennedy & O'Hagan 2001, doi 10.1111/1467-9868.00294",
    signature="smooth wiggles without a cause; part of the errors, not of a solve",
    amplitudes=(
        Amplitude("sd", "mmHg", 0.5, 0.0, 5.0, (0.1,), "a few times the noise of a good catheter"),
        Amplitude(
            "length",
            "s",
            0.003,
            0.0002,
            0.03,
            (0.003,),
            "from a few samples to the length of an upstroke",
            centre=0.003,
            zero_is_base=False,
        ),
    ),
    places=everywhere,
    apply=None,
)


# ---------------------------------------------------------------------------------------------------
# Numerics


@effect(
    "coarse-grid",
    "numerics",
    equation="y -> y + a (y(2 dx) - y); a = -1/3 is Richardson's limit, 1 the doubled cells",
    source="Richardson 1911, doi 10.1098/rsta.1911.0009 (a scheme of second order)",
    signature="dispersion behind steep fronts",
    amplitudes=[Amplitude("blend", "1", 1.0, -2.0, 4.0, (-0.333, 1.0))],
    why="the error of cells between none (-1/3) and twice as long (1)",
)
def coarse_grid(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The grid is too coarse."""
    return replace(case, coarse_blend=case.coarse_blend + values[0])


# ---------------------------------------------------------------------------------------------------
# The catalogue as tables


@dataclass(frozen=True)
class Signature:
    """What one effect does to the pressure at the root's inlet, at its prior's scale.

    Parameters
    ----------
    effect : str
    place : Place
        That of the largest change.
    values : tuple of float
        Amplitudes; halved where the solve failed.
    mean_mmHg, rms_mmHg, largest_mmHg : float
        Of the change over the beat.
    left_mmHg : float
        Root mean square of what no small change of the base's parameters can imitate.
    """

    effect: str
    place: Place
    values: tuple[float, ...]
    mean_mmHg: float
    rms_mmHg: float
    largest_mmHg: float
    left_mmHg: float


def typical_values(made: Effect) -> tuple[float, ...]:
    """An effect's amplitudes at the scale of their priors, shapes at their centre."""
    return tuple(min(max(a.scale, a.low), a.high) if a.zero_is_base else a.centre for a in made.amplitudes)


def signatures(study: Study, base: str = "linear-constant", *, n_times: int = 256) -> list[Signature]:
    """Size of every effect in a study's network, at the start of a base.

    Parameters
    ----------
    study : Study
    base : str
    n_times : int
        Samples of the beat.

    Returns
    -------
    list of Signature
        For each effect that the base offers and a solve can show.

    Raises
    ------
    EffectError
        If the base's own solve fails.
    """
    chosen = get_base(base)
    start = chosen.start
    case = chosen.case(study, start)
    series = [(int(case.network.ids[0]), 0.0, "pressure_mmHg")]
    times = np.arange(n_times) * (study.period_s / n_times)

    def solve(changed: Case) -> tuple[Array, str | None]:
        values, reason = simulate(changed, series, times)
        return values[0], reason

    plain, reason = solve(case)
    if reason is not None:
        raise EffectError(f"base {base}: {reason}")
    columns = []
    for name, value in start.items():
        step = 1e-3 * value
        up, down = (solve(chosen.case(study, start | {name: value + s}))[0] for s in (step, -step))
        columns.append((up - down) / (2 * step) * value)
    directions = np.linalg.qr(np.array(columns).T)[0]

    rows = []
    for made in CATALOGUE.values():
        if made.apply is None or not made.offered(base):
            continue
        found = []
        for place in made.places(case.network):
            values = typical_values(made)
            for _ in range(6):
                changed, reason = solve(made.apply(case, values, place))
                if reason is None:
                    break
                values = (values[0] / 2, *values[1:])
            change = changed - plain
            left = change - directions @ (directions.T @ change)
            rms, rest = (float(np.sqrt(np.mean(x**2))) for x in (change, left))
            found.append(
                Signature(
                    made.name, place, values, float(change.mean()), rms, float(np.abs(change).max()), rest
                )
            )
        rows.append(max(found, key=lambda row: -1.0 if math.isnan(row.rms_mmHg) else row.rms_mmHg))
    return rows


def signature_table(study: Study, base: str = "linear-constant") -> str:
    """`signatures` as a table in Markdown."""
    lines = [
        "| effect | place | amplitude | mean change | rms change | rms left of it by the base's parameters |",
        "|---|---|---|---|---|---|",
    ]
    for row in signatures(study, base):
        values = ", ".join(
            f"{value:.3g} {amplitude.unit}".removesuffix(" 1")
            for value, amplitude in zip(row.values, get_effect(row.effect).amplitudes, strict=True)
        )
        numbers = f"{row.mean_mmHg:+.2f} | {row.rms_mmHg:.2f} | {row.left_mmHg:.3f}"
        lines.append(f"| `{row.effect}` | {row.place} | {values} | {numbers} |")
    return "\n".join(lines)


def prior_text(amplitude: Amplitude) -> str:
    """An amplitude's prior in words, such as "normal(0, 0.5) in [-1, 1]"."""
    bounds = f"[{amplitude.low:g}, {amplitude.high:g}]"
    return f"normal({amplitude.centre:g}, {amplitude.scale:g}) in {bounds} {amplitude.unit}".removesuffix(
        " 1"
    )


def catalogue_table() -> str:
    """The catalogue as a table in Markdown, a row for each amplitude."""

    def cell(text: str) -> str:
        return text.replace("|", "\\|")

    lines = [
        "| effect | family | what | equation | amplitude | prior | why | what it does to a beat | source |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for made in CATALOGUE.values():
        for k, amplitude in enumerate(made.amplitudes):
            what = (made.statement, f"`{cell(made.equation)}`") if k == 0 else ("", "")
            rest = (made.signature, made.source) if k == 0 else ("", "")
            name = f"`{made.name}`" if k == 0 else ""
            kind = made.family if k == 0 else ""
            cells = (name, kind, *what, amplitude.name, prior_text(amplitude), amplitude.why, *rest)
            lines.append("| " + " | ".join(cell(c) if not c.startswith("`") else c for c in cells) + " |")
    return "\n".join(lines)
