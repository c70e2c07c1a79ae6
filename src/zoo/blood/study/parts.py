"""What a study is made of: blood, vessels, series; frozen values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

QUANTITIES = ("pressure_mmHg", "flow_ml_s", "area_cm2")


class StudyError(ValueError):
    """A study that cannot be used: one line with the file, row, field, value and remedy."""


def read_only(values: ArrayLike, dtype: Any = np.float64) -> Any:
    """A read-only array that nobody else can write to; copied unless it is one already."""
    array = np.asarray(values)
    own = array.base is None and array.flags.c_contiguous and not array.flags.writeable
    if not own or array.dtype != dtype:
        array = np.array(values, dtype=dtype, order="C")
        array.flags.writeable = False
    return array


class ReadOnlyArrays:
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
    """

    id: int
    name: str
    length_cm: float
    radius_cm: float
    radius_out_cm: float
    parent: int | None = None
    windkessel: Windkessel | None = None


@dataclass(frozen=True)
class Blood:
    """Density in g/cm3 and dynamic viscosity in g/(cm s)."""

    density_g_cm3: float
    viscosity_g_cm_s: float


@dataclass(frozen=True, eq=False)
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
        In the quantity's unit, at the study's ``time_s``.
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
