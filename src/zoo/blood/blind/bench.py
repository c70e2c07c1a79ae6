"""A study to come: its waveforms with effects, and what the refitted baseline leaves of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.blood.blind.networks import Sensor
from zoo.blood.effects import Case, Effect, EffectError, Place, apply_all, get_base, simulate
from zoo.blood.solver import SolverArgumentError, SolverOptions
from zoo.blood.study import Series, Study
from zoo.core.diagnosis.discrepancy import Errors, Harmonics
from zoo.core.diagnosis.screening import Forward, Hypothesis, Search, SearchError

Array = NDArray[np.float64]
Added = tuple[tuple[Effect, tuple[float, ...], Place], ...]

BASELINE = "linear-constant"
GENERATOR = SolverOptions(dx_cm=0.019, refine=2, cfl=0.8, tolerance_mmHg=2e-4)
"""Not the diagnosis' grid and time step: half and less of its cells, and another number of steps."""
SAMPLES = 512
WHITE_MMHG = 0.05
FLOW_NOISE = 0.01
"""Noise of a flow, as a part of its peak."""
BASELINE_ALONE = Hypothesis()


class _FixedEffects(Forward):
    """The baseline's waveforms with effects whose amplitudes stay as they are."""

    added: Added = ()

    def case(self, u: Array) -> Case:
        """The solve at these coordinates."""
        return apply_all(super().case(u), self.added)


def over_pressures(rms: Mapping[str, float]) -> float:
    """Rms over the pressures together, from the rms of each series by its label."""
    return math.sqrt(float(np.mean([x**2 for label, x in rms.items() if label.endswith("mmHg")])))


class Bench:
    """A study to come: solves its waveforms and refits the baseline to them, on the generator's grid.

    Parameters
    ----------
    study : Study
        Without series.
    theta : mapping
        The baseline's parameters.
    sensors : sequence of (vessel, position, quantity)

    Raises
    ------
    EffectError
        If the baseline cannot be solved.
    """

    def __init__(self, study: Study, theta: Mapping[str, float], sensors: Sequence[Sensor]) -> None:
        self.baseline, self.theta, self.sensors = get_base(BASELINE), dict(theta), list(sensors)
        self.times = np.arange(SAMPLES) * (study.period_s / SAMPLES)
        waves, reason = simulate(self.baseline.case(study, self.theta, GENERATOR), self.sensors, self.times)
        if reason is not None:
            raise EffectError(reason)
        self.clean = waves
        self.study = self.with_series(study, waves)
        self.labels = [s.label for s in self.study.series]
        self.harmonics = Harmonics(self.study)
        self.sigma = {
            q: WHITE_MMHG if q == "pressure_mmHg" else FLOW_NOISE * float(np.abs(waves[rows]).max())
            for q, rows in self.harmonics.rows.items()
        }
        self.start = np.array([p.outside(self.theta[p.name]) for p in self._forward(()).parameters])
        self._jacobian: Array | None = None

    def with_series(self, study: Study, waves: Array) -> Study:
        """The study with these waveforms for data."""
        series = [Series(v, x, q, row) for (v, x, q), row in zip(self.sensors, waves, strict=True)]
        return replace(study, time_s=np.asarray(self.times), series=tuple(series))

    def _forward(self, added: Added, hypothesis: Hypothesis = BASELINE_ALONE) -> _FixedEffects:
        forward = _FixedEffects(self.study, self.baseline, hypothesis, self.harmonics, GENERATOR)
        forward.added = added
        return forward

    def solve(self, added: Added) -> Array | None:
        """Waveforms with these effects, or None where the solve fails."""
        if not added:
            return self.clean
        try:
            case = apply_all(self.baseline.case(self.study, self.theta, GENERATOR), added)
            waves, reason = simulate(case, self.sensors, self.times)
        except (EffectError, SolverArgumentError):
            return None
        return None if reason is not None else waves

    def refit(
        self,
        data: Array,
        against: Array,
        *,
        added: Added = (),
        free: bool = False,
        noise: Mapping[str, Errors] | None = None,
    ) -> tuple[dict[str, float], dict[str, float]] | None:
        """Fit the baseline to data.

        Parameters
        ----------
        data, against : array (n_series, n_times)
            What is fitted, and what the fit is compared with.
        added : sequence of (Effect, values, Place)
            Effects that the baseline has besides; they stay as they are.
        free : bool
            Fit their amplitudes too; listed effects only.
        noise : mapping of quantity to Errors
            Of the data; white if absent.

        Returns
        -------
        rms : dict
            By series, of the difference, in the series' unit.
        values : dict
            Parameters.
        """
        forward, start, jacobian = self._forward(() if free else added), self.start, self._jacobian
        if free:
            forward = self._forward((), Hypothesis(tuple((effect.name, place) for effect, _, place in added)))
            start = np.concatenate([start, *(np.array(values) for _, values, _ in added)])
            jacobian = None
        S = self.harmonics.variances(noise or {q: Errors(sigma) for q, sigma in self.sigma.items()})
        search = Search(forward, self.harmonics(data), S)
        try:
            point = search.at(start, jacobian)
        except SearchError:
            return None
        if self._jacobian is None and not added:
            self._jacobian = point.jacobian
        point = search.descend(point, 12)
        if not added:
            point = search.polish(point, 4)
        left = against - self.harmonics.back(point.computed)
        rms = {k: float(np.sqrt(np.mean(row**2))) for k, row in zip(self.labels, left, strict=True)}
        return rms, {
            p.name: float(x) for p, x in zip(forward.parameters, forward.values(point.u), strict=True)
        }

    def discrepancy(self, waves: Array | None) -> float:
        """Rms over the pressures of noise-free waveforms minus the refitted baseline, mmHg."""
        found = None if waves is None else self.refit(waves, waves)
        return math.inf if found is None else over_pressures(found[0])
