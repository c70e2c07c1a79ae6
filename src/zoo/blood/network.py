"""The vessel tree as flat arrays, and the nominal loads of terminals that a study gives none for."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.blood.outlet_tables import StructuredTree, circuit_of, least_real_part, tree_table
from zoo.blood.solve_errors import ArgumentError
from zoo.blood.study import (
    Blood,
    LoadWarning,
    ReadOnlyArrays,
    Study,
    StudyError,
    Vessel,
    Windkessel,
    check_physics,
    read_only,
    root_pressure,
)
from zoo.blood.study import sort_vessels as _sort_vessels
from zoo.blood.study.loading import NO_MEAN_FLOW
from zoo.blood.study.resampling import beat_mean
from zoo.blood.units import MMHG, mmhg_to_cgs
from zoo.core.arrays import Array, real_array, real_number, refuse_where, whole_array, whole_number

R1_SHARE = 0.2
"""R1/(R1 + R2) of a derived load."""
FASTEST_CM_S = 100.0
"""Mean velocity in a terminal above which its derived load is warned about."""
QUIET_SHARE = 0.05
"""Diastole is where the inflow stays below this share of its peak."""
MIN_DIASTOLE_SAMPLES = 8
_LARGEST = 2**31 - 1
_INTEGERS = ("ids", "parent")
_SIZES = ("length_cm", "radius_in_cm", "radius_out_cm")
_LOADS = ("R1", "R2", "C")
_STIFFNESSES = ("stiffness_in", "stiffness_out")
_RESPONSES = ("response_cosine", "response_sine")
_NUMBERS = ("density", "viscosity", "period_s")


@dataclass(frozen=True, eq=False, repr=False)
class Network(ReadOnlyArrays):
    """The vessel tree as arrays, parents before their children; read-only.

    Parameters
    ----------
    ids : int array (n,)
        Ids of the vessels; the order of the study, apart from parents that stood after their children.
    parent : int array (n,)
        Index of the vessel that feeds it, -1 for the root, which is vessel 0.
    length_cm, radius_in_cm, radius_out_cm : array (n,)
        cm, at rest.
    R1, R2 : array (n,)
        Nominal resistances of the terminals, dyn s/cm5; NaN elsewhere. A single resistance is R1, with R2 =
        0.
    C : array (n,)
        Nominal compliance of the terminals, cm5/dyn; 0 beside a single resistance, NaN elsewhere.
    density : float
        g/cm3.
    viscosity : float
        g/(cm s).
    period_s : float
        s.
    stiffness_in, stiffness_out : array (n,) or None
        Stiffness chi that the study gives, at the vessels' ends, g/(cm s2); None where it gives none.
    response_cosine, response_sine : array (n, m) or None
        a_k and b_k, dyn/cm5, read at terminals: to a unit of volume an outlet responds, beside R1, R2 and C,
        with the pressure psi1 exp(-t/tau) sum_k (a_k cos(2 pi k t/T) + b_k sin(2 pi k t/T)), T the beat and
        tau = T `zoo.blood.outlet_tables.MEMORY_BEATS`. Given together.
    trees : tuple of (StructuredTree or None)
        Behind each vessel, if these outlets are made from trees; `with_impedances` makes them.

    Raises
    ------
    StudyError
        If the arrays do not have one length, are not made of numbers, or are no tree.
    zoo.blood.solve_errors.ArgumentError
        A StudyError and a SolverArgumentError: if a value is out of range.
    """

    ids: NDArray[np.int32]
    parent: NDArray[np.int32]
    length_cm: Array
    radius_in_cm: Array
    radius_out_cm: Array
    R1: Array
    R2: Array
    C: Array
    density: float
    viscosity: float
    period_s: float
    stiffness_in: Array | None = None
    stiffness_out: Array | None = None
    response_cosine: Array | None = None
    response_sine: Array | None = None
    trees: tuple[StructuredTree | None, ...] | None = None

    def __post_init__(self) -> None:
        for name in (*_INTEGERS, *_SIZES, *_LOADS, *_STIFFNESSES):
            value = getattr(self, name)
            if name in _INTEGERS and getattr(value, "dtype", None) == np.int32 and value.ndim == 1:
                array: Any = value
            elif name in _INTEGERS:
                array = whole_array(f"network: {name}", value, error=StudyError)
            elif value is None and name in _STIFFNESSES:
                continue
            else:
                array = real_array(f"network: {name}", value, ndim=1, error=StudyError)
            object.__setattr__(self, name, read_only(array, array.dtype))
            if len(array) != len(self.ids):
                raise StudyError(
                    f"network: {name} has {len(array)} values for {len(self.ids)} ids: give one for each "
                    "vessel"
                )
        for name in _NUMBERS:
            words = "a positive and finite number"
            value = real_number(
                f"network: {name}", getattr(self, name), words, above=0.0, error=ArgumentError
            )
            object.__setattr__(self, name, value)
        for name in _RESPONSES:
            if getattr(self, name) is not None:
                array = real_array(f"network: {name}", getattr(self, name), ndim=2, error=StudyError)
                object.__setattr__(self, name, read_only(array))
        self._check_tree()
        self._check_values()

    def _check_tree(self) -> None:
        n = len(self.ids)
        if n == 0:
            raise StudyError("network: ids = []: must hold a vessel; add the root")
        if len(set(self.ids.tolist())) < n:
            values, counts = np.unique(self.ids, return_counts=True)
            raise StudyError(f"network: ids: {values[counts > 1][0]} stands twice; give each vessel its own")
        wrong = (self.parent < 0) | (self.parent >= np.arange(n))
        wrong[0] = self.parent[0] != -1
        if wrong.any():
            at = int(np.argmax(wrong))
            words = (
                "the index of a vessel that stands before it" if at else "-1, the first vessel is the root"
            )
            raise StudyError(
                f"network: parent[{at}] = {self.parent[at]}: must be {words}; order the vessels so"
            )

    def _check_values(self) -> None:
        def positive(name: str, where: NDArray[np.bool_] | bool = True) -> None:
            values = getattr(self, name)
            good = (values > 0) & (values < np.inf)
            if good.all():
                return
            bad = where & ~good
            refuse_where(f"network: {name}", values, bad, "positive and finite", error=ArgumentError)

        for name in (*_SIZES, *(name for name in _STIFFNESSES if getattr(self, name) is not None)):
            positive(name)
        both = self._responses
        shapes = [None if one is None else one.shape for one in both]
        if shapes[0] != shapes[1] or (shapes[0] is not None and shapes[0][0] != len(self.ids)):
            raise ArgumentError(
                f"network: response_cosine and response_sine have shapes {shapes[0]} and {shapes[1]}: give "
                f"both, with one row for each of {len(self.ids)} vessels"
            )
        for name, one in zip(_RESPONSES, both, strict=True):
            if one is not None:
                refuse_where(f"network: {name}", one, ~np.isfinite(one), "finite", error=ArgumentError)
        terminal = np.ones(len(self.ids), dtype=bool)
        terminal[self.parent[1:]] = False
        positive("R1", terminal)
        positive("R2", terminal & (self.R2 != 0))
        positive("C", terminal & (self.R2 != 0))

    @classmethod
    def from_vessels(cls, vessels: Sequence[Vessel], blood: Blood, period_s: float) -> Network:
        """Arrays of a list of vessels.

        Parameters
        ----------
        vessels : sequence of Vessel
            One tree; every terminal with a Windkessel.
        blood : Blood
        period_s : float
            s.

        Returns
        -------
        Network

        Raises
        ------
        StudyError
            If the vessels are not one tree, a size is not positive, a terminal has neither Windkessel nor
            resistance, or what is said of walls and outlets cannot be (`zoo.blood.study.check_physics`).
        """
        order = _sort_vessels(vessels)
        ordered = [vessels[i] for i in order]
        index = {v.id: i for i, v in enumerate(ordered)}
        feeding = {v.parent for v in ordered}
        _positive("blood", {name: value for name, value in vars(blood).items() if value is not None})
        _positive("beat", {"period_s": period_s})
        loads = []
        for v in ordered:
            sizes = {name: getattr(v, name) for name in ("length_cm", "radius_cm", "radius_out_cm")}
            _positive(f"vessel {v.id}", sizes)
            if not v.has_load and v.id not in feeding:
                raise StudyError(
                    f"network: vessel {v.id}: windkessel: is missing at a terminal; give R1, R2 and C, or a "
                    "resistance, in cgs"
                )
            if v.windkessel is not None:
                _positive(f"vessel {v.id}: windkessel", vars(v.windkessel))
            alone = Windkessel(v.resistance or 1.0, 0.0, 0.0) if v.resistance or v.impedance else None
            loads.append(v.windkessel or alone or Windkessel(math.nan, math.nan, math.nan))
        check_physics(ordered)
        ends = np.array([v.stiffness for v in ordered if v.stiffness])
        return cls(
            ids=np.array([v.id for v in ordered], np.int32),
            parent=np.array([-1 if v.parent is None else index[v.parent] for v in ordered], np.int32),
            length_cm=np.array([v.length_cm for v in ordered]),
            radius_in_cm=np.array([v.radius_cm for v in ordered]),
            radius_out_cm=np.array([v.radius_out_cm for v in ordered]),
            R1=np.array([load.R1 for load in loads]),
            R2=np.array([load.R2 for load in loads]),
            C=np.array([load.C for load in loads]),
            density=float(blood.density_g_cm3),
            viscosity=float(blood.viscosity_g_cm_s),
            period_s=float(period_s),
            stiffness_in=ends[:, 0] if len(ends) else None,
            stiffness_out=ends[:, 1] if len(ends) else None,
        ).with_impedances([v.impedance for v in ordered])

    def with_impedances(
        self, given: Sequence[Sequence[tuple[float, float]] | StructuredTree | None]
    ) -> Network:
        """The same with outlets of these impedances.

        Parameters
        ----------
        given : sequence of (sequence of (float, float), StructuredTree or None), of length n
            As in `zoo.blood.study.Vessel`; None leaves the outlet as it is.

        Returns
        -------
        Network
            With R1, R2 and C of `zoo.blood.outlet_tables.circuit_of`, and what these lack in
            `response_cosine` and `response_sine`.
        """
        tables = {i: self._table(i, one) for i, one in enumerate(given) if one is not None}
        if not tables:
            return self
        loads = np.array([self.R1, self.R2, self.C])
        responses = self.responses(max(map(len, tables.values())))
        for i, Z in tables.items():
            loads[:, i], *response = circuit_of(Z, self.period_s)
            responses[:, i] = 0.0
            responses[:, i, : len(Z)] = response
        trees = tuple(one if isinstance(one, StructuredTree) else None for one in given)
        cosine, sine = responses
        return replace(
            self,
            R1=loads[0],
            R2=loads[1],
            C=loads[2],
            response_cosine=cosine,
            response_sine=sine,
            trees=trees,
        )

    def _table(self, i: int, given: Sequence[tuple[float, float]] | StructuredTree) -> NDArray[np.complex128]:
        """Impedance of vessel i's outlet at harmonics of the beat."""
        if not isinstance(given, StructuredTree):
            return np.array([complex(*pair) for pair in given])
        radius = float(self.radius_out_cm[i])
        wrong = given.fault(radius)
        if wrong:
            raise ArgumentError(f"network: vessel {int(self.ids[i])}: tree: {wrong}")
        return tree_table(given, radius, self.density, self.viscosity, self.period_s)

    def with_tree_factors(self, factors: Mapping[str, float]) -> Network:
        """The same with the fields of all trees times factors, by the names of `TREE_FACTORS`.

        Raises
        ------
        zoo.blood.solve_errors.ArgumentError
            If a tree cannot be.
        """
        if self.trees is None:
            return self
        return self.with_impedances([tree and tree.scaled(factors) for tree in self.trees])

    def responses(self, width: int) -> Array:
        """`response_cosine` and `response_sine`, (2, n, m), m at least `width`; 0 where there are none."""
        own = [np.zeros((len(self.ids), 0)) if one is None else one for one in self._responses]
        return np.array([np.pad(one, ((0, 0), (0, max(0, width - one.shape[1])))) for one in own])

    @property
    def _responses(self) -> list[Array | None]:
        return [getattr(self, name) for name in _RESPONSES]

    @classmethod
    def from_study(cls, study: Study) -> Network:
        """Arrays of a study's vessels; terminals without a Windkessel get a nominal one.

        It is derived by `nominal_windkessel` from the pressure observed in the root, the mean inflow and
        the decay of the diastolic pressure.

        Parameters
        ----------
        study : Study

        Returns
        -------
        Network

        Raises
        ------
        StudyError
            If the vessels are not one tree, or a nominal load is needed and cannot be derived.

        Warns
        -----
        zoo.blood.study.LoadWarning
            If an outlet by its impedance gives energy at some frequency.
        """
        check_physics(study.vessels, radius_pressure_mmHg=study.radius_pressure_mmHg)
        network = cls.from_vessels(with_nominal_loads(study), study.blood, study.period_s)
        _warn_of_energy(study, network)
        return network

    def index(self, vessel_id: int) -> int:
        """Index of a vessel in the arrays, from its id.

        Raises
        ------
        StudyError
            If there is no such vessel.
        """
        whole_number(
            "vessel", vessel_id, -_LARGEST, _LARGEST, words="a whole number, a vessel's id", error=StudyError
        )
        found = np.flatnonzero(self.ids == vessel_id)
        if len(found) == 0:
            known = ", ".join(str(i) for i in sorted(self.ids.tolist()))
            raise StudyError(f"vessel = {vessel_id}: not in the network; use one of {known}")
        return int(found[0])

    @property
    def terminals(self) -> NDArray[np.intp]:
        """Indices of the vessels that feed no other."""
        return np.setdiff1d(np.arange(len(self.ids)), self.parent)

    def children(self, i: int) -> NDArray[np.intp]:
        """Indices of the vessels that vessel `i` (an index) feeds."""
        return np.flatnonzero(self.parent == i)


def _positive(where: str, values: dict[str, Any]) -> None:
    for name, value in values.items():
        if not 0 < value < math.inf:
            raise StudyError(f"network: {where}: {name} = {value!r}: must be positive and finite; correct it")


def stiffness_profile(
    radius_cm: ArrayLike, f1: float, f2: float, f3: float, radius_unit_cm: float = 1.0
) -> Array:
    """Stiffness as a function of the radius at rest: chi = f1 exp(f2 r0/u) + f3 (eq. 3.5).

    Parameters
    ----------
    radius_cm : array (n,)
        r0, cm.
    f1, f3 : float
        g/(cm s2).
    f2 : float
        Per u.
    radius_unit_cm : float
        u, cm: 1 as printed, 0.1 in the published code.

    Returns
    -------
    array (n,)
        chi, g/(cm s2).

    References
    ----------
    Paun et al. 2020, eq. (3.5), doi 10.1098/rsif.2020.0886.
    """
    radius = np.asarray(radius_cm, dtype=np.float64)
    return np.asarray(f1 * np.exp(f2 * radius / radius_unit_cm) + f3)


def poiseuille_split(vessels: Sequence[Vessel]) -> dict[int, float]:
    """Share of the root's mean flow in each vessel, split at each junction by Poiseuille's conductance.

    q_k / q_parent = G_k / sum of G over the siblings, where G is the conductance of a vessel with all that it
    feeds, 1/G = 1/g + 1/(sum of G over its daughters), and g = r^4/L of the vessel alone; in a tapered one
    r^4/L becomes 1/integral of dx/r^4 = 3 r1^3 r2^3 / (L (r1^2 + r1 r2 + r2^2)). So the split does not depend
    on where a tree is cut into vessels.

    Parameters
    ----------
    vessels : sequence of Vessel
        One tree.

    Returns
    -------
    dict of int to float
        Id -> share; 1 at the root, and the terminals add up to 1.

    Raises
    ------
    StudyError
        If the vessels are not one tree.

    References
    ----------
    Qureshi et al. 2018, doi 10.1007/s10237-018-1078-8.
    """
    ordered = [vessels[i] for i in _sort_vessels(vessels)]
    conductance: dict[int, float] = {}
    total: dict[int | None, float] = {}
    for v in reversed(ordered):  # what a vessel feeds stands after it
        r1, r2 = v.radius_cm, v.radius_out_cm
        resistance = v.length_cm * (r1**2 + r1 * r2 + r2**2) / (3 * r1**3 * r2**3)
        behind = 1 / total[v.id] if v.id in total else 0.0
        conductance[v.id] = 1 / (resistance + behind)
        total[v.parent] = total.get(v.parent, 0.0) + conductance[v.id]
    share: dict[int, float] = {}
    for v in ordered:
        share[v.id] = 1.0 if v.parent is None else share[v.parent] * conductance[v.id] / total[v.parent]
    return share


def diastolic_tau(
    time_s: ArrayLike,
    pressure: ArrayLike,
    inflow_time_s: ArrayLike,
    inflow: ArrayLike,
    period_s: float,
) -> float:
    """Time constant of the exponential decay of the pressure in diastole: p = p0 exp(-t/tau).

    Diastole is the longest part of the beat in which abs(inflow) stays below `QUIET_SHARE` of its peak, which
    may reach over the end of the beat, and ends where the pressure is lowest in it. Least squares on log p.

    Parameters
    ----------
    time_s : array (n,)
        Times of the pressure, s, ascending, over one period.
    pressure : array (n,)
        Any unit, from a zero that is the pressure behind the Windkessels.
    inflow_time_s, inflow : array (m,)
        Times (s) and flow into the root, any unit, over one period.
    period_s : float
        s.

    Returns
    -------
    float
        tau, s.

    Raises
    ------
    StudyError
        If the inflow is never quiet for long enough, the pressure is not positive, or it does not fall.

    References
    ----------
    Qureshi et al. 2018, doi 10.1007/s10237-018-1078-8.
    """
    t, p, q = (np.asarray(a, dtype=np.float64) for a in (time_s, pressure, inflow))
    at_pressure = np.interp(t, np.asarray(inflow_time_s, dtype=np.float64), np.abs(q), period=period_s)
    still = at_pressure < QUIET_SHARE * np.max(np.abs(q))
    n = len(t)
    best, run, start = 0, 0, 0
    for i in range(2 * n):
        run = run + 1 if still[i % n] else 0
        if min(run, n) > best:
            best, start = run, i - run + 1
    rows = np.arange(start, start + best)
    if best >= MIN_DIASTOLE_SAMPLES:
        rows = rows[: int(np.argmin(p[rows % n])) + 1]
    if len(rows) < MIN_DIASTOLE_SAMPLES or best == n:
        raise StudyError(
            f"diastole: {len(rows)} of {n} pressure samples are usable, the inflow being below "
            f"{QUIET_SHARE:g} of its peak: the time constant (R1 + R2) C cannot be fitted; "
            "give every terminal a windkessel"
        )
    falling = p[rows % n]
    if np.min(falling) <= 0:
        raise StudyError(
            f"diastole: pressure = {np.min(falling):.6g}: must be positive for an exponential decay; "
            "correct its zero, or give every terminal a windkessel"
        )
    slope = float(np.polyfit(t[rows % n] + rows // n * period_s, np.log(falling), 1)[0])
    if not slope < 0:
        raise StudyError(
            f"diastole: d(log p)/dt = {slope:.6g} 1/s: the pressure does not fall; give every terminal "
            "a windkessel"
        )
    return -1.0 / slope


def nominal_windkessel(
    vessels: Sequence[Vessel],
    mean_pressure_mmHg: float,
    mean_flow_ml_s: float,
    tau_s: float,
    *,
    mmhg: float = MMHG,
) -> dict[int, Windkessel]:
    """Nominal loads of all terminals: R1 + R2 = mean pressure / mean flow of the vessel, C = tau/(R1 + R2).

    R1/(R1 + R2) = 0.2, and the flow of a vessel is its share of the root's by `poiseuille_split`.

    Parameters
    ----------
    vessels : sequence of Vessel
        One tree.
    mean_pressure_mmHg : float
        In the root, taken for that in the terminals, above that behind the outlets; mmHg.
    mean_flow_ml_s : float
        Into the root, ml/s.
    tau_s : float
        Time constant of the diastolic pressure, s.
    mmhg : float
        dyn/cm2 in 1 mmHg.

    Returns
    -------
    dict of int to Windkessel
        Id of each terminal -> load in cgs.

    Raises
    ------
    StudyError
        If the vessels are not one tree, or a mean or tau is not positive.

    References
    ----------
    Qureshi et al. 2018, doi 10.1007/s10237-018-1078-8.
    """
    _positive(
        "nominal windkessel",
        {"mean_pressure_mmHg": mean_pressure_mmHg, "mean_flow_ml_s": mean_flow_ml_s, "tau_s": tau_s},
    )
    share = poiseuille_split(vessels)
    feeding = {v.parent for v in vessels}
    loads = {}
    for v in vessels:
        if v.id not in feeding:
            total = mmhg_to_cgs(mean_pressure_mmHg, mmhg) / (mean_flow_ml_s * share[v.id])
            loads[v.id] = Windkessel(R1_SHARE * total, (1 - R1_SHARE) * total, tau_s / total)
    return loads


def with_nominal_loads(study: Study) -> tuple[Vessel, ...]:
    """A study's vessels, where terminals without a Windkessel have got their nominal one.

    Parameters
    ----------
    study : Study

    Returns
    -------
    tuple of Vessel
        In the study's order.

    Raises
    ------
    StudyError
        If a load is needed and no pressure of the root is observed, or `diastolic_tau` cannot be fitted.

    Warns
    -----
    zoo.blood.study.LoadWarning
        If the blood would flow faster than `FASTEST_CM_S` through a terminal in the mean.
    """
    feeding = {v.parent for v in study.vessels}
    bare = [v.id for v in study.vessels if v.id not in feeding and not v.has_load]
    if not bare:
        return study.vessels
    file = f"{study.source}: study {study.name!r}: network.toml"
    if study.inlet_pressure_mmHg.size:
        raise StudyError(f"{file}: vessel {bare[0]}: windkessel: {NO_MEAN_FLOW}")
    where = f"{file}: vessel {bare[0]}: windkessel: is nominal or absent"
    observed = root_pressure(study.vessels, study.series)
    if observed is None:
        raise StudyError(f"{where}, and no pressure_mmHg of the root is observed; add one of the two")
    behind = {v.id: study.pressure_mmHg("outflow", v) for v in study.vessels if v.id in bare}
    different = next((v for v in bare if behind[v] != behind[bare[0]]), None)
    if different is not None:
        raise StudyError(
            f"{where}, and cannot be derived: outflow_pressure_mmHg = {behind[different]!r} of vessel "
            f"{different} is not that of vessel {bare[0]}, {behind[bare[0]]!r}; give these vessels a "
            "windkessel"
        )
    there = ~np.isnan(observed.value)
    times, above = study.time_s[there], observed.value[there] - behind[bare[0]]
    mean = beat_mean(times, above, study.period_s)
    flow = float(study.inflow_ml_s.mean())
    try:
        tau = diastolic_tau(times, above, study.inflow_time_s, study.inflow_ml_s, study.period_s)
        loads = nominal_windkessel(study.vessels, mean, flow, tau, mmhg=study.conventions.mmhg)
    except StudyError as error:
        total = mean * study.conventions.mmhg / flow if flow > 0 else 0.0
        whole = f"; R1 + R2 of all, mean pressure over flow, is {total:.4g} dyn s/cm5" if total > 0 else ""
        raise StudyError(
            f"{where}, and cannot be derived from the observed pressure: {error}{whole}"
        ) from None
    _warn_of_speed(study, bare, file)
    return tuple(replace(v, windkessel=loads[v.id]) if v.id in bare else v for v in study.vessels)


def _warn_of_energy(study: Study, network: Network) -> None:
    """Warn of each outlet by its impedance that has a negative real part between harmonics or above them."""
    cosine, sine = network.response_cosine, network.response_sine
    for v in study.vessels:
        if v.impedance is None or cosine is None or sine is None:
            continue
        i = network.index(v.id)
        loads = np.array([network.R1[i], network.R2[i], network.C[i]])
        frequency, real = least_real_part(loads, cosine[i], sine[i], study.period_s)
        if real < 0:
            warnings.warn(
                f"{study.source}: study {study.name!r}: network.toml: vessel {v.id}: impedance: the outlet "
                f"that meets it at the harmonics of the beat has the real part {real:.4g} dyn s/cm5 at "
                f"{frequency:.4g} Hz, between them or above the last, and gives energy there: the periodic "
                "solution is right, but may take many beats, or none; give more harmonics, or smoother ones",
                LoadWarning,
                stacklevel=3,
            )


def _warn_of_speed(study: Study, bare: Sequence[int], file: str) -> None:
    """Warn of the terminal with a derived load through which the blood would flow fastest, if too fast."""
    mean, share = float(study.inflow_ml_s.mean()), poiseuille_split(study.vessels)
    speed = {
        v.id: mean * share[v.id] / (math.pi * min(v.radius_cm, v.radius_out_cm) ** 2)
        for v in study.vessels
        if v.id in bare
    }
    fast = sorted((i for i in bare if speed[i] > FASTEST_CM_S), key=lambda i: -speed[i])
    if not fast:
        return
    others = f" (and {len(fast) - 1} more terminals)" if len(fast) > 1 else ""
    warnings.warn(
        f"{file}: vessel {fast[0]}{others}: its nominal load is for {100 * share[fast[0]]:.3g} % of "
        f"the inflow, a mean velocity of {speed[fast[0]] / 100:.3g} m/s, and should be at most "
        f"{FASTEST_CM_S / 100:g} m/s; correct its radius_cm, or give it a windkessel",
        LoadWarning,
        stacklevel=3,
    )
