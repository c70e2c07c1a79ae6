"""SINDy on what the base leaves, by PySINDy: dr/dt = f(r, inputs) or r = f(inputs), r = measured less base.

f is a polynomial of degree 2, sparse by sequential thresholds (STLSQ, its defaults), derivatives are smoothed
finite differences; all in units of their standard deviations. That of the two is kept which leaves less of
the fitted record when it is simulated; in the held-out record r starts from its start in the fitted one.
References: Kaheman et al. 2019, arXiv 1909.08574; PySINDy, doi 10.21105/joss.03994.
"""

from __future__ import annotations

import numpy as np
import pysindy as ps
from benchmarks.nature.other_tools import Answer, Array, Record, Series, rms

PACKAGES = ("pysindy",)
LARGEST = 100.0
"""Of a residual in standard deviations, where a simulation ends."""


def beyond(t: float, r: Array) -> float:
    """Zero where a simulation ends."""
    return float(LARGEST - np.abs(r).max())


beyond.terminal = True  # type: ignore[attr-defined]
SOLVER = {"method": "LSODA", "rtol": 1e-6, "atol": 1e-6, "events": beyond}


def answer(record: Record) -> Answer:
    """Fit both equations, and simulate the better one in the record that is held out."""
    part, base = record.fitted, record.compute(record.fitted, record.base)
    inputs, left = part.inputs(base), part.measured - base
    middle, spread, size = inputs.mean(axis=0), inputs.std(axis=0), left.std()
    drive, r, differences = (inputs - middle) / spread, left[:, None] / size, ps.SmoothedFiniteDifference()
    rate = differences(r, part.times).std()
    moving, still = (
        ps.SINDy(
            optimizer=ps.STLSQ(),
            feature_library=ps.PolynomialLibrary(degree=2),
            differentiation_method=differences,
        )
        for _ in range(2)
    )
    moving.fit(r, rate * part.times, u=drive, feature_names=["r", *record.inputs])
    still.fit(
        drive, part.times, x_dot=np.repeat(r, drive.shape[1], axis=1), feature_names=list(record.inputs)
    )

    def simulated(part: Series, base: Array) -> Array:
        t, drive = rate * part.times, (part.inputs(base) - middle) / spread
        at = lambda now: np.column_stack([np.interp(now, t, one) for one in drive.T])  # noqa: E731
        found = moving.simulate([r[0, 0]], t, u=at, integrator_kws=SOLVER)[:, 0]
        return size * np.append(found, np.full(len(t) - len(found), LARGEST))

    def computed(part: Series, base: Array) -> Array:
        return np.asarray(size * still.predict((part.inputs(base) - middle) / spread)[:, 0])

    ways = {"dr/dt": (simulated, moving), "r": (computed, still)}
    kept = min(ways, key=lambda name: rms(left - ways[name][0](part, base)))
    law, model = ways[kept]
    says = f"{kept} = {model.equations(2)[0]}".replace(" 1 ", " ")
    return Answer(says, record.predict(record.base, lambda base: law(record.held_out, base)))
