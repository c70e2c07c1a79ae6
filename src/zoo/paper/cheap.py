"""A study and settings of the solver with which a solve takes a fraction of a millisecond."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zoo.blood.ejection import PERIOD_S, ejection
from zoo.blood.prior_tables import PAPER_SET
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Blood, Series, Study, Vessel, Windkessel
from zoo.core.posterior.ranks import CalibrationError

CHEAP_STEPS = {"linear": 256, "tangent": 1024}


def cheap_study(n_times: int = 32, sites: Sequence[tuple[int, float]] = ((1, 0.0),)) -> Study:
    """A trunk (vessel 1) with two branches (2, 3), our own inflow, and pressures of 0 mmHg, to be replaced.

    Parameters
    ----------
    n_times : int
        Samples in the beat of 0.11 s.
    sites : sequence of (vessel, position)
        Where pressure is observed.
    """
    time_s, flow_ml_s = ejection(64)
    vessels = (
        Vessel(1, "trunk", 0.40, 0.047, 0.045),
        Vessel(2, "left", 0.40, 0.034, 0.034, 1, Windkessel(3.3e4, 1.43e5, 5.9e-7)),
        Vessel(3, "right", 0.35, 0.037, 0.037, 1, Windkessel(2.7e4, 1.17e5, 7.2e-7)),
    )
    series = tuple(Series(vessel, x, "pressure_mmHg", np.zeros(n_times)) for vessel, x in sites)
    observed_s = np.arange(n_times) * PERIOD_S / n_times
    return Study(
        "cheap", PERIOD_S, Blood(1.055, 0.049), vessels, time_s, flow_ml_s, observed_s, series,
        priors={"set": PAPER_SET},
    )  # fmt: skip


def cheap_options(wall: str = "linear") -> SolverOptions:
    """Coarse settings for `cheap_study`: two cells a vessel, and a fixed time step.

    The number of steps is fixed because one that followed the parameters would make the waves jump by more
    than the Gaussian process' noise of 0.0019 mmHg.

    Parameters
    ----------
    wall : {"linear", "tangent"}
    """
    if wall not in CHEAP_STEPS:
        raise CalibrationError(f"wall = {wall!r}: must be one of {', '.join(CHEAP_STEPS)}")
    return SolverOptions(dx_cm=0.2, steps_per_beat=CHEAP_STEPS[wall], tolerance_mmHg=1e-4)
