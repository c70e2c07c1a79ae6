"""Cells and time steps that give a stated accuracy, for any network.

All vessels share one time step, T/N. The scheme of Lax and Wendroff is most accurate where a wave crosses
nearly a whole cell in a step, so each vessel has as many cells as its own largest wave speed allows,

    n_v = max(1, floor(0.9 N L_v/(T max(|u| + c)_v))),

and N is the only number to choose. It is raised until refinement by two says that the error is small
enough. A vessel so short that waves cross it in less than a step of T/N has one cell, and sets the steps; the
cells of the others stay those of N.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from zoo.blood.case import Case, Place, simulate, solver_of
from zoo.blood.solve_errors import CFLError
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import Study, StudyError
from zoo.blood.study.schema import checked_numerics
from zoo.core.arrays import Array
from zoo.core.forward import SolveError, content_key

ACCURACY_PERCENT = 0.03
"""Of each series' range: the largest root mean square over a beat of the discretisation error."""
NOISE_SHARE = 1 / 3
"""Of a known noise's standard deviation, likewise."""
COURANT = 0.9
"""(abs(u) + c) dt/dx in the vessel where it is largest; the solver takes more steps above 0.95."""
SOFTER = 0.8
"""The error is also looked at with walls of this part of the stiffness, where waves are shorter."""
REMAINDER = 1.5
"""Error over the difference from cells and steps of half the size; 4/3 at second order, 2 at first."""
TOLERANCE_SHARE = 0.25
"""Accepted distance from the periodic state, as a part of the error that is asked for."""
GIVEN_CELLS_MMHG = 2e-3
"""The same where cells are given and no error is asked for."""
FIRST_STEPS = 64
STEP_UNIT = 32
MOST_WORK = 6e8
"""Nodes times steps that one trial may cost, about two seconds of a core."""
TRIALS = 12
TOO_COARSE = 1.5
"""Error over its limit above which a grid that was chosen elsewhere is warned about."""
GIVEN_UP = 1024
"""Steps at which a case that fails is one that has no solution, and not one on too few cells."""
SAMPLES = 128
"""Times in a beat at which the error is looked at where the study has none."""


@dataclass(frozen=True)
class Resolution:
    """Numerical settings, and the error that refinement showed.

    Parameters
    ----------
    options : SolverOptions
    cells : tuple of int
        Of each vessel, in the order of ``Network.ids``.
    error_percent : float
        Estimated error: root mean square over a beat, in percent of the series' range, of the series that is
        nearest to its limit or furthest above it. NaN where cells were given and nothing was estimated.
    limit_percent : float
        What was asked of that series.
    worst : str
        Its label.
    """

    options: SolverOptions
    cells: tuple[int, ...]
    error_percent: float = math.nan
    limit_percent: float = math.nan
    worst: str = ""

    @property
    def met(self) -> bool:
        """Whether the error is as small as asked, as far as it was estimated."""
        return not self.error_percent > self.limit_percent

    @property
    def text(self) -> str:
        """One line: cells, steps and error."""
        n, least, most = sum(self.cells), min(self.cells), max(self.cells)
        each = f"{least} to {most} each" if least < most else f"{least} each"
        steps = self.options.steps_per_beat or self.options.least_steps
        line = f"grid: {n} cells in {len(self.cells)} vessels ({each}), "
        line += f"{steps} steps a beat" if steps else "steps from the wave speed"
        if math.isnan(self.error_percent):
            return f"{line}; error not estimated, since the cells were given"
        line += f"; estimated error {self.error_percent:.2g} % of the pulse ({self.worst})"
        if self.met:
            return line
        return (
            f"{line}, more than the {self.limit_percent:.2g} % asked for: accept it with a larger "
            "accuracy_percent (--accuracy), or give shorter cells, dx_cm"
        )

    def record(self) -> dict[str, Any]:
        """For a run's record: the line, and the error if it was estimated."""
        if math.isnan(self.error_percent):
            return {"grid": self.text}
        return {"grid": self.text, "error_percent": self.error_percent}


def resolve(
    study: Study,
    case: Case,
    series: Sequence[Place] = (),
    times_s: Array | None = None,
    *,
    share: float = 1.0,
) -> Resolution:
    """The numerical settings of a study, from its table [numerics] and what is observed.

    Cells are those of `dx_cm` where it is given, and those of the published program where the conventions
    truncate lengths. Otherwise they are chosen, at the parameters of `case`.

    Parameters
    ----------
    study : Study
    case : Case
        The solve at the parameters at which the error is looked at.
    series : sequence of (vessel id, position, quantity)
        Where; pressures at all ends of vessels and flows at all inlets if there are none.
    times_s : array (n_times,)
        When; 128 times of the beat if absent.
    share : float
        Factor of the distance from the periodic state that is accepted.

    Returns
    -------
    Resolution

    Raises
    ------
    zoo.blood.study.StudyError
        If a field of the table is unknown or out of range.
    SolveError
        If cells are to be chosen and the case cannot be solved.
    """
    given = checked_numerics(f"study {study.name!r}: numerics", study.numerics)
    plain: dict[str, Any] = {name: given[name] for name in ("steps_per_beat", "max_beats") if name in given}
    if case.conventions.truncate_lengths and "accuracy_percent" in given:
        raise StudyError(
            f"study {study.name!r}: numerics: accuracy_percent = {given['accuracy_percent']}: the convention "
            "truncate_lengths has cells of its own; leave it out, or set truncate_lengths = false"
        )
    if "dx_cm" in given or case.conventions.truncate_lengths:
        options = SolverOptions(dx_cm=given.get("dx_cm", SolverOptions.dx_cm), **plain)
        tolerance = given.get("tolerance_mmHg", GIVEN_CELLS_MMHG) * share
        options = replace(options, tolerance_mmHg=tolerance)
        cells, _ = solver_of(replace(case, options=options), (), np.empty(0)).grid()
        return Resolution(options, tuple(int(n) for n in cells))
    if not series:
        net = case.network
        series = [(int(v), x, "pressure_mmHg") for v in net.ids for x in (0.0, 1.0)]
        series += [(int(v), 0.0, "flow_ml_s") for v in net.ids]
    if times_s is None or len(times_s) == 0:
        times_s = np.asarray(np.arange(SAMPLES) * (case.network.period_s / SAMPLES), dtype=np.float64)
    accuracy, noise = given.get("accuracy_percent", ACCURACY_PERCENT), dict(study.noise_sd)
    key = _key(case, tuple(series), times_s, accuracy, sorted(noise.items()), sorted(plain.items()))
    if key not in _CHOSEN:
        _CHOSEN[key] = _chosen(case, tuple(series), times_s, accuracy, noise, plain)
    found = _CHOSEN[key]
    tolerance = given.get("tolerance_mmHg") or found.options.tolerance_mmHg or GIVEN_CELLS_MMHG
    tolerance *= share
    return replace(found, options=replace(found.options, tolerance_mmHg=tolerance))


def resolve_solver(study: Study, solver: Solver, **parameters: Any) -> Resolution:
    """As `resolve`, of a solver of the study at parameters of `Solver.solve`, (n_vessels,) each."""
    same = ["network", "inflow_time_s", "inflow_ml_s", "inlet_pressure_mmHg"]
    same += ["conventions", "wall", "options", "physics"]
    case = Case(**{name: getattr(solver, name) for name in same}, **parameters)
    series = [(s.vessel, s.position, s.quantity) for s in study.series]
    return resolve(study, case, series, study.time_s)


_CHOSEN: dict[str, Resolution] = {}
"""What was chosen in this process, by all that a choice depends on."""


def _key(case: Case, series: tuple[Place, ...], times_s: Array, *settings: Any) -> str:
    fields = [*vars(case.network).items(), *vars(case.physics).items()]
    arrays = [value for _, value in fields if isinstance(value, np.ndarray)]
    numbers = [(name, "array" if isinstance(value, np.ndarray) else value) for name, value in fields]
    arrays += [*case.parameters.values(), case.inflow_ml_s, case.inlet_pressure_mmHg, times_s]
    return content_key(repr((case.wall, case.conventions, series, settings, numbers)), *arrays)


def _chosen(
    case: Case,
    series: tuple[Place, ...],
    times_s: Array,
    accuracy_percent: float,
    noise_sd: Mapping[str, float],
    given: Mapping[str, Any],
) -> Resolution:
    """Raise the steps until the error is small enough, or a trial would take too long."""
    plain = dict(given)
    fixed = int(plain.pop("steps_per_beat", 0))
    period, length = case.network.period_s, case.network.length_cm
    speed, waves = _look(case, series, times_s, plain)
    if np.ptp(case.inlet) == 0 and case.physics.stiffness_wave is None:
        waves = np.stack([0.0 * waves[:, 0], waves[:, 0]], axis=1)  # no pulse: of the level itself
    limits, ranges = _limits((*series, _root(case)), waves, accuracy_percent, noise_sd)
    pressures = [limits[i] for i, (_, _, quantity) in enumerate(series) if quantity == "pressure_mmHg"]
    tolerance = TOLERANCE_SHARE * float(min(pressures, default=limits[-1]))
    limits, ranges = limits[:-1], ranges[:-1]
    crossed = period * speed / length / COURANT  # steps in which a wave crosses each vessel once
    if fixed and fixed < crossed.max():
        short = int(case.network.ids[int(np.argmax(crossed))])
        raise SolveError(
            f"steps_per_beat = {fixed}: waves cross vessel {short} in less than a step; give at least "
            f"{math.ceil(crossed.max())}, or leave it out",
            "bad-argument",
        )

    if 2 * crossed.max() > SolverOptions.max_steps:
        stiff = int(np.argmax(crossed))
        raise CFLError(
            f"waves cross vessel {int(case.network.ids[stiff])} at {speed[stiff] / 100:.3g} m/s, "
            f"{crossed[stiff]:.3g} times in a beat, and at most {SolverOptions.max_steps // 2} steps are "
            "taken; give it a softer wall, which changes little where it is nearly rigid, or a greater length"
        )

    def options(steps: float) -> SolverOptions:
        cells = tuple(int(n) for n in np.maximum(1, np.floor(steps / crossed + 1e-9)))
        whole = math.ceil(max(steps, crossed.max()) / STEP_UNIT - 1e-9) * STEP_UNIT
        taken = {"steps_per_beat": fixed} if fixed else {"least_steps": whole}
        return SolverOptions(cells=cells, tolerance_mmHg=tolerance, **taken, **plain)

    steps = float(fixed or FIRST_STEPS)
    for trial in range(1, TRIALS + 1):
        now = options(steps)
        try:
            errors = _errors(case, series, times_s, now)
        except SolveError:  # waves that few cells do not show may empty a vessel that more cells do not
            steps *= 1.5
            if fixed or trial == TRIALS or steps > GIVEN_UP:
                raise
            continue
        over, worst, error, limit = _worst(errors, limits, ranges)
        found = Resolution(now, now.cells, error, limit, _words(series[worst]))
        if over <= 1 or fixed or trial == TRIALS:
            return found
        before, steps = steps, steps * min(max(1.05 * math.sqrt(over), 1.15), 3.0)
        steps = min(steps, SolverOptions.max_steps / 2)
        while _work(options(steps)) > MOST_WORK:
            steps *= 0.95
        if steps < 1.1 * before:
            return found
    raise AssertionError("the last trial returns")


def _worst(errors: Array, limits: Array, ranges: Array) -> tuple[float, int, float, float]:
    """The largest error over its limit, of which series; error and limit in per cent of its range."""
    worst = int(np.argmax(errors / limits))
    error, limit = (100 * float(x[worst] / ranges[worst]) for x in (errors, limits))
    return float(errors[worst] / limits[worst]), worst, error, limit


def _work(options: SolverOptions) -> float:
    """Nodes times steps of a trial: six beats at two stiffnesses, on this grid and on one twice as fine."""
    if 2 * options.least_steps > options.max_steps:
        return math.inf
    return (sum(options.cells) + len(options.cells)) * options.least_steps * 5 * 6 * 2


def _words(place: Place) -> str:
    vessel, position, quantity = place
    return f"{quantity.split('_')[0]} at {position:g} of v{vessel}"


def _root(case: Case) -> Place:
    """The pressure at the root's inlet."""
    return int(case.network.ids[0]), 0.0, "pressure_mmHg"


def _look(
    case: Case, series: tuple[Place, ...], times_s: Array, plain: Mapping[str, Any]
) -> tuple[Array, Array]:
    """On few cells: wave speeds (n_vessels,), and series with the root's pressure (n_series + 1, n_times)."""
    length = case.network.length_cm
    totals, tried = [64, 256, 1024], 0
    while totals:
        total, tried = totals.pop(0), tried + 1
        cells = tuple(int(n) for n in np.maximum(1, np.rint(total * length / length.sum())))
        coarse = replace(case, options=SolverOptions(cells=cells, tolerance_mmHg=0.5, **plain))
        try:
            looked = solver_of(coarse, (), np.empty(0)).solve(**case.parameters)
            break
        except CFLError:  # waves too fast for more cells, as in walls that are nearly rigid
            if tried > 1:
                raise
            totals = [len(length)]
        except SolveError:
            if not totals:
                raise
    return looked.fastest_cm_s, simulate(coarse, (*series, _root(case)), times_s)


def _limits(
    series: Sequence[Place], waves: Array, accuracy_percent: float, noise_sd: Mapping[str, float]
) -> tuple[Array, Array]:
    """The largest error of each series that is asked for, and its range, both in the series' unit."""
    ranges = np.maximum(np.ptp(waves, axis=1), 1e-9 * np.abs(waves).max(axis=1) + 1e-300)
    limits = accuracy_percent / 100 * ranges
    for i, (vessel, position, quantity) in enumerate(series):
        label = f"v{vessel}@{repr(float(position)).removesuffix('.0')} {quantity}"
        known = noise_sd.get(label, noise_sd.get(quantity))
        if known is not None:
            limits[i] = min(limits[i], NOISE_SHARE * known)
    return limits, ranges


def coarse_at(study: Study, case: Case, series: Sequence[Place], times_s: Array) -> str:
    """A warning if cells and steps that were chosen elsewhere are too coarse for a solve; else empty.

    The error of each series is estimated as when they were chosen, and compared with what is asked of it.

    Parameters
    ----------
    study : Study
    case : Case
        With the options that were chosen.
    series : sequence of (vessel id, position, quantity)
    times_s : array (n_times,)

    Returns
    -------
    str
        One sentence with the error, its limit and what makes it smaller.
    """
    given = checked_numerics(f"study {study.name!r}: numerics", study.numerics)
    if "dx_cm" in given or case.conventions.truncate_lengths:
        return ""
    places = tuple(series)
    try:
        waves = simulate(case, places, times_s)
        errors = _errors(case, places, times_s, case.options, softer=())
    except SolveError:
        return ""
    asked = given.get("accuracy_percent", ACCURACY_PERCENT)
    limits, ranges = _limits(places, waves, asked, study.noise_sd)
    over, worst, error, limit = _worst(errors, limits, ranges)
    if over <= TOO_COARSE:
        return ""
    return (
        f"cells and steps were chosen at the medians of the priors; here the discretisation error is "
        f"{error:.2g} % of the pulse ({_words(places[worst])}), not the {limit:.2g} % asked for: "
        f"--accuracy {0.8 * asked / over:.1g}, or a prior of the stiffness nearer to it, makes it smaller"
    )


def _errors(
    case: Case,
    series: tuple[Place, ...],
    times_s: Array,
    options: SolverOptions,
    softer: tuple[float, ...] = (SOFTER,),
) -> Array:
    """Estimated root mean square error of each series, at the stiffness or a softer one."""
    tolerance = options.tolerance_mmHg
    fine = replace(options, refine=2, tolerance_mmHg=None if tolerance is None else 0.2 * tolerance)
    worst = np.zeros(len(series))
    for part in (1.0, *softer):
        try:
            pair = [
                simulate(replace(case, options=o, stiffness=part * case.stiffness), series, times_s)
                for o in (options, fine)
            ]
        except SolveError:
            if part == 1.0:
                raise
            continue  # walls that are too soft to be solved say nothing of the grid
        rms = np.sqrt(np.mean(np.square(pair[0] - pair[1]), axis=1))
        worst = np.maximum(worst, REMAINDER * rms)
    return worst
