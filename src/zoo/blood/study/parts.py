"""What a study is made of: blood, vessels, series; frozen values."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from zoo.blood.outlet_tables import StructuredTree
from zoo.core.arrays import Array, Brief
from zoo.core.words import OneLineError

QUANTITIES = ("pressure_mmHg", "flow_ml_s", "area_cm2")


class StudyError(OneLineError, ValueError):
    """A study that cannot be used: one line with the file, row, field, value and remedy."""


def read_only(values: ArrayLike, dtype: Any = np.float64) -> Any:
    """A read-only array that nobody else can write to; copied unless it is one already."""
    array = np.asarray(values)
    own = array.base is None and array.flags.c_contiguous and not array.flags.writeable
    if not own or array.dtype != dtype:
        array = np.array(values, dtype=dtype, order="C")
        array.flags.writeable = False
    return array


class ReadOnlyArrays(Brief):
    """Pickles of frozen dataclasses come back with their arrays read-only."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
        self.__dict__.update(state)


@dataclass(frozen=True)
class Windkessel:
    """Three-element load of a terminal vessel: R1 in series with R2 parallel to C (eq. 3.7).

    Parameters
    ----------
    R1, R2 : float
        dyn s/cm5.
    C : float
        cm5/dyn.
    """

    R1: float
    R2: float
    C: float


@dataclass(frozen=True)
class Stenosis:
    """A narrow stretch of a vessel by its empirical loss of pressure.

        dp = Kv mu/D0 U + Kt rho/2 (A0/A1 - 1)^2 U abs(U),   U = q/A0,

    beside what the vessel loses without it. The inertia is the vessel's own, Ku rho length dU/dt with Ku = 1
    (Young and Tsai found 1.2).

    Parameters
    ----------
    radius_cm : float
        Of the narrowest place, at rest: A1 = pi radius^2; A0 and D0 are the vessel's there.
    length_cm : float
    position : float
        Of its middle along the vessel, 0 at the inlet and 1 at the outlet.
    Kt : float
    Kv : float or None
        None: 32 (0.83 length + 3.28 radius)/D0 (A0/A1)^2.

    References
    ----------
    Young and Tsai 1973, doi 10.1016/0021-9290(73)90099-7.
    """

    radius_cm: float
    length_cm: float
    position: float = 0.5
    Kt: float = 1.52
    Kv: float | None = None

    def constants(self, radius_cm: float) -> tuple[float, float]:
        """Kt and Kv where the vessel's radius is this."""
        ratio, viscous_length = (
            (radius_cm / self.radius_cm) ** 2,
            0.83 * self.length_cm + 3.28 * self.radius_cm,
        )
        return self.Kt, 16 * viscous_length / radius_cm * ratio**2 if self.Kv is None else self.Kv


@dataclass(frozen=True)
class Vessel:
    """One vessel of the tree, at rest.

    Parameters
    ----------
    id : int
        Number in the study's files.
    name : str
    length_cm : float
    radius_cm, radius_out_cm : float
        At the inlet and at the outlet, linear between.
    parent : int or None
        Id of the vessel that feeds it; None for the root.
    windkessel : Windkessel or None
        Nominal load of a terminal; None there means that it is derived from the observations.
    impedance : tuple of (float, float), StructuredTree or None
        Of the outlet instead of a Windkessel: real and imaginary parts at the harmonics of the beat from 0
        up, dyn s/cm5, pressure above that behind the outlet over flow; or that of a tree of small arteries.
    resistance : float or None
        dyn s/cm5, R in p - p_out = R q: a single resistance as the outlet instead of a Windkessel.
    stiffness_g_cm_s2, stiffness_out_g_cm_s2 : float or None
        chi at the inlet and at the outlet, linear between; the same at both ends where only the first is
        given.
    youngs_modulus_g_cm_s2, wall_thickness_cm, wall_thickness_out_cm : float or None
        E, and h at the inlet and at the outlet, linear between, instead of chi: chi(x) = E h(x)/r(x).
    outflow_pressure_mmHg : float or None
        p_out behind the outlet of a terminal, mmHg; None: the study's.
    external_pressure_mmHg : float or None
        Outside the vessel, mmHg; None: the study's.
    radius_pressure_mmHg : float or None
        Inside less outside pressure at which the vessel has its radii, mmHg; None: the study's.
    stenosis : Stenosis or None
        A narrow stretch.
    """

    id: int
    name: str
    length_cm: float
    radius_cm: float
    radius_out_cm: float
    parent: int | None = None
    windkessel: Windkessel | None = None
    impedance: tuple[tuple[float, float], ...] | StructuredTree | None = None
    resistance: float | None = None
    stiffness_g_cm_s2: float | None = None
    stiffness_out_g_cm_s2: float | None = None
    youngs_modulus_g_cm_s2: float | None = None
    wall_thickness_cm: float | None = None
    wall_thickness_out_cm: float | None = None
    outflow_pressure_mmHg: float | None = None
    external_pressure_mmHg: float | None = None
    radius_pressure_mmHg: float | None = None
    stenosis: Stenosis | None = None

    @property
    def physics(self) -> dict[str, float]:
        """The fields from `resistance` to `radius_pressure_mmHg` that are given."""
        given = {name: getattr(self, name) for name in VESSEL_PHYSICS}
        return {name: float(value) for name, value in given.items() if value is not None}

    @property
    def has_load(self) -> bool:
        """Whether an outlet is given: then none is derived."""
        return not (self.windkessel is None and self.resistance is None and self.impedance is None)

    @property
    def stiffness(self) -> tuple[float, float] | None:
        """Stiffness chi in p = (4/3) chi (sqrt(A/A0) - 1) at the inlet and at the outlet, g/(cm s2).

        It is what is given, or chi = E h/r: Poisson's ratio 1/2 gives p = (4/3) (E h/r) (sqrt(A/A0) - 1).
        None where the vessel has neither.

        References
        ----------
        Boileau et al. 2015, doi 10.1002/cnm.2732.

        Examples
        --------
        >>> Vessel(1, "a", 1.0, 0.5, 0.4, youngs_modulus_g_cm_s2=4e6, wall_thickness_cm=0.05).stiffness
        (400000.0, 500000.0)
        """
        if self.stiffness_g_cm_s2 is not None:
            end = self.stiffness_out_g_cm_s2
            return self.stiffness_g_cm_s2, self.stiffness_g_cm_s2 if end is None else end
        if self.youngs_modulus_g_cm_s2 is None or self.wall_thickness_cm is None:
            return None
        h = self.wall_thickness_cm
        h_out = h if self.wall_thickness_out_cm is None else self.wall_thickness_out_cm
        return (
            self.youngs_modulus_g_cm_s2 * h / self.radius_cm,
            self.youngs_modulus_g_cm_s2 * h_out / self.radius_out_cm,
        )


VESSEL_PHYSICS = tuple(field.name for field in fields(Vessel) if field.default is None)[3:-1]
"""Fields of a vessel that are one number."""


@dataclass(frozen=True)
class Blood:
    """What flows, and how it is spread over a cross-section.

    Parameters
    ----------
    density_g_cm3 : float
    viscosity_g_cm_s : float
        Dynamic.
    velocity_profile_order : float or None
        zeta of a profile u ~ 1 - (r/R)^zeta, whose friction is -2 (zeta + 2) pi nu q/A; 2 is a parabola.
        None: a flat profile with a Stokes layer, eq. (3.1).
    momentum_correction : float
        alpha, factor of q^2/A; 1 is that of a flat profile.
    """

    density_g_cm3: float
    viscosity_g_cm_s: float
    velocity_profile_order: float | None = None
    momentum_correction: float = 1.0

    @property
    def physics(self) -> dict[str, float]:
        """The fields after the first two that are not at their default."""
        order, alpha = self.velocity_profile_order, float(self.momentum_correction)
        given = {} if order is None else {"velocity_profile_order": float(order)}
        return given if alpha == 1 else {**given, "momentum_correction": alpha}


@dataclass(frozen=True, eq=False, repr=False)
class Series(ReadOnlyArrays):
    """One observed quantity at one place over the beat.

    Parameters
    ----------
    vessel : int
        Id.
    position : float
        Along the vessel, 0 at the inlet and 1 at the outlet.
    quantity : {"pressure_mmHg", "flow_ml_s", "area_cm2"}
    value : array (n_times,)
        In the quantity's unit, at the study's ``time_s``; NaN where it was not measured.
    """

    vessel: int
    position: float
    quantity: str
    value: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", read_only(self.value))

    @property
    def label(self) -> str:
        """Such as "v1@0 pressure_mmHg"."""
        return f"v{self.vessel}@{repr(float(self.position)).removesuffix('.0')} {self.quantity}"

    @property
    def n_samples(self) -> int:
        """How many values were measured."""
        return int(np.sum(~np.isnan(self.value)))
