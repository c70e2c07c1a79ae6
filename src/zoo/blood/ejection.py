"""An inflow of one beat with the facts of the measured one, for studies that are made up."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammaln

from zoo.core.arrays import Array

PERIOD_S = 0.11
PEAK_ML_S, PEAK_TIME_S, EJECTION_S, MEAN_ML_S = 0.55, 0.0215, 0.058, 0.169


def ejection(n: int = 1024) -> tuple[Array, Array]:
    """Inflow of one beat with the facts of the measured one, and a shape of its own.

    q = peak (1 - cos(pi x/2)^(2 m)), x = t/0.0215 s while it rises and (0.058 s - t)/(0.058 s - 0.0215 s)
    while it falls, zero after; m such that the mean is 0.169 ml/s: 1 - Gamma(m + 1/2)/(sqrt(pi) Gamma(m + 1))
    = 0.169 T/(0.55 0.058). It starts and ends without a corner, which a
    scheme of second order would answer with wiggles.

    Parameters
    ----------
    n : int
        Samples in the period of 0.11 s.

    Returns
    -------
    time_s, flow_ml_s : array (n,)
    """
    share = MEAN_ML_S * PERIOD_S / (PEAK_ML_S * EJECTION_S)
    m = brentq(lambda m: 1 - np.exp(gammaln(m + 0.5) - gammaln(m + 1)) / np.sqrt(np.pi) - share, 0.2, 20.0)
    time = np.arange(n) * PERIOD_S / n
    x = np.minimum(time / PEAK_TIME_S, (EJECTION_S - time) / (EJECTION_S - PEAK_TIME_S))
    return time, PEAK_ML_S * (1 - np.cos(np.pi / 2 * np.clip(x, 0, 1)) ** (2 * m))
