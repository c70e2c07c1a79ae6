"""Named conversions: cgs inside, mmHg and ml/s at the edge (1 ml/s is 1 cm3/s)."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

MMHG = 1333.22
"""dyn/cm2 in 1 mmHg, as Paun et al. 2020 (doi 10.1098/rsif.2020.0886) print it below eq. (3.1)."""

Number = TypeVar("Number", float, NDArray[np.float64])


def mmhg_to_cgs(pressure: Number, mmhg: float = MMHG) -> Number:
    """Pressure in dyn/cm2 from mmHg: p_cgs = mmhg p.

    Parameters
    ----------
    pressure : float or array
        mmHg.
    mmhg : float
        dyn/cm2 in 1 mmHg.

    Returns
    -------
    float or array
        dyn/cm2.
    """
    return pressure * mmhg


def cgs_to_mmhg(pressure: Number, mmhg: float = MMHG) -> Number:
    """Pressure in mmHg from dyn/cm2: p = p_cgs / mmhg.

    Parameters
    ----------
    pressure : float or array
        dyn/cm2.
    mmhg : float
        dyn/cm2 in 1 mmHg.

    Returns
    -------
    float or array
        mmHg.
    """
    return pressure / mmhg
