"""A study to come: its waveforms with effects, and what the refitted baseline leaves of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.blood.baseline import get_baseline
from zoo.blood.blind.networks import Sensor
from zoo.blood.blind.truths import PLACES
from zoo.blood.case import WAVE_SAMPLES, Case
from zoo.blood.forward import study_data
from zoo.blood.solver import SolverArgumentError, SolverOptions
from zoo.blood.study import Series, Study
from zoo.core.diagnosis.hypothesis import Hypothesis, HypothesisModel
from zoo.core.diagnosis.search import Search, SearchError
from zoo.core.effects import Effect, EffectError, Location, in_order
from zoo.core.errors.spectral import GroupErrors, Harmonics
from zoo.core.forward import Outputs, SolveError
from zoo.core.parameters import pack

Array = NDArray[np.float64]
Added = tuple[tuple[Effect, tuple[float, ...], Location], ...]

BASELINE = "linear-constant"
GENERATOR = SolverOptions(dx_cm=0.019, refine=2, cfl=0.8, tolerance_mmHg=2e-4)
"""Not the diagnosis' grid and time step: half and less of its cells, and another number of steps."""
SAMPLES = 512
STATES = ("area_cm2", "flow_ml_s")
WHITE_MMHG = 0.05
FLOW_NOISE = 0.01
"""Noise of a flow, as a part of its peak."""


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
        self.theta, self.sensors = dict(theta), list(sensors)
        self.times: Array = np.asarray(np.arange(SAMPLES) * (study.period_s / SAMPLES), dtype=np.float64)
        baseline = get_baseline(BASELINE)
        bare = baseline.forward(study, options=GENERATOR)
        self.values = pack(bare.parameters, self.theta)
        try:
            waves = bare.solve(bare.configure(self.values), Outputs(tuple(self.sensors), self.times))
        except SolveError as error:
            raise EffectError(str(error)) from None
        self.clean = waves
        self.study = self.with_series(study, waves)
        self.flow = baseline.forward(self.study, options=GENERATOR)
        self.labels = [s.label for s in self.study.series]
        self.errors = Harmonics().bind(study_data(self.study))
        self.sigma = {
            q: WHITE_MMHG if q == "pressure_mmHg" else FLOW_NOISE * float(np.abs(waves[rows]).max())
            for q, rows in self.errors.rows.items()
        }
        self._jacobian: Array | None = None

    def with_series(self, study: Study, waves: Array) -> Study:
        """The study with these waveforms for data."""
        series = [Series(v, x, q, row) for (v, x, q), row in zip(self.sensors, waves, strict=True)]
        return replace(study, time_s=np.asarray(self.times), series=tuple(series))

    def solve(self, added: Added) -> Array | None:
        """Waveforms with these effects, or None where the solve fails."""
        if not added:
            return self.clean
        try:
            return self.flow.solve(self.case(added))
        except (EffectError, SolveError, SolverArgumentError):
            return None

    def case(self, added: Added = ()) -> Case:
        """The solve of the baseline's true parameters with these effects."""
        case = self.flow.configure(self.values)
        for i in in_order(self.flow, [effect.at(location) for effect, _, location in added]):
            effect, values, location = added[i]
            assert effect.apply is not None
            case = effect.apply(case, values, location)
        return case

    def change(self, waves: Array) -> float:
        """Rms over the pressures of waveforms minus the baseline's own, before any refit, mmHg."""
        return over_pressures(self._rms(waves - self.clean))

    def _rms(self, difference: Array) -> dict[str, float]:
        """Of each series, in its unit."""
        return {k: float(np.sqrt(np.mean(row**2))) for k, row in zip(self.labels, difference, strict=True)}

    def refit(
        self,
        data: Array,
        against: Array,
        noise: Mapping[str, GroupErrors] | None = None,
        added: Added = (),
    ) -> tuple[dict[str, float], dict[str, float]] | None:
        """Fit the baseline to data, or the baseline with effects, from their true values on.

        Parameters
        ----------
        data, against : array (n_series, n_times)
            What is fitted, and what the fit is compared with.
        noise : mapping of quantity to GroupErrors
            Of the data; white if absent.
        added : Added
            Effects whose parameters are fitted too.

        Returns
        -------
        rms : dict
            By series, of the difference, in the series' unit.
        values : dict
            Parameters.
        """
        hypothesis = Hypothesis(tuple(effect.at(location) for effect, _, location in added))
        forward = HypothesisModel(self.flow, hypothesis, self.errors)
        values = [*self.values, *(x for _, own, _ in added for x in own)]
        start = np.array([p.coordinate(float(x)) for p, x in zip(forward.parameters, values, strict=True)])
        S = self.errors.variances(noise or {q: GroupErrors(sigma) for q, sigma in self.sigma.items()})
        search = Search(forward, self.errors.flat(data), S)
        try:
            point = search.at(start, None if added else self._jacobian)
        except SearchError:
            return None
        if self._jacobian is None and not added:
            self._jacobian = point.jacobian
        point = search.refine(search.descend(point, 12), 4)
        found = zip(forward.parameters, forward.theta(point.u), strict=True)
        return self._rms(against - self.errors.unflat(point.computed)), {p.name: float(x) for p, x in found}

    def states(self, added: Added) -> Array:
        """Area (cm2) and flow (ml/s) at three places of every vessel, (n_vessels, 3, 2, n_times)."""
        places = [(int(i), x, q) for i in self.flow.network.ids for x in PLACES for q in STATES]
        case = self.case(added)
        found = self.flow.solve(replace(case, waves=()), Outputs(tuple(places), self.times))
        return found.reshape(len(self.flow.network.ids), len(PLACES), len(STATES), -1)

    def pressures(self, added: Added) -> Array:
        """The series before any sensor, (n_series, n)."""
        case = replace(self.case(added), waves=())
        times = np.arange(WAVE_SAMPLES) * (self.study.period_s / WAVE_SAMPLES)
        return self.flow.solve(case, Outputs(tuple(self.sensors), np.asarray(times)))

    def linear_discrepancy(self, waves: Array) -> float:
        """What `discrepancy` is where the baseline is linear in its parameters, mmHg; costs no solve."""
        if self._jacobian is None:
            self.refit(self.clean, self.clean)
        S = self.errors.variances({q: GroupErrors(sigma) for q, sigma in self.sigma.items()})
        scaled = 1 / np.sqrt(S)
        J, r = self._jacobian, self.errors.flat(waves) - self.errors.flat(self.clean)
        if J is None:
            return math.inf
        step, *_ = np.linalg.lstsq(J * scaled[:, None], r * scaled, rcond=None)
        return over_pressures(self._rms(self.errors.unflat(r - J @ step)))

    def discrepancy(self, waves: Array | None) -> float:
        """Rms over the pressures of noise-free waveforms minus the refitted baseline, mmHg."""
        found = None if waves is None else self.refit(waves, waves)
        return math.inf if found is None else over_pressures(found[0])
