"""The blind check: cases whose effect is withheld, diagnosed without their key, scored against it.

`make` writes studies, each with an effect that its files do not tell, and the key apart; `run` diagnoses
them and sees no key; `score` compares. docs/blind.md says how cases are drawn and what each score means.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
import os
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, truncnorm

from zoo.blood.effects import (
    CATALOGUE,
    Amplitude,
    Case,
    Effect,
    EffectError,
    Place,
    apply_all,
    effects_for,
    everywhere,
    get_base,
    get_effect,
    simulate,
    with_physics,
)
from zoo.blood.network import R1_SHARE, with_nominal_loads
from zoo.blood.solver import SolverArgumentError, SolverOptions
from zoo.blood.study import Blood, Series, Study, StudyError, Vessel, Windkessel, load_study
from zoo.blood.units import MMHG, mmhg_to_cgs
from zoo.core.diagnosis.diagnosis import (
    UNITS,
    DiagnosisError,
    DiagnosisFile,
    HypothesisResult,
    diagnose,
    read_diagnosis,
)
from zoo.core.diagnosis.discrepancy import Errors, Harmonics
from zoo.core.diagnosis.screening import (
    CORRELATED,
    NO_GAP,
    UNLISTED,
    Forward,
    Hypothesis,
    Search,
    SearchError,
)
from zoo.core.inference.record import versions
from zoo.core.inference.workers import each
from zoo.paper.synthetic import PERIOD_S, ejection

Array = NDArray[np.float64]
Added = tuple[tuple[Effect, tuple[float, ...], Place], ...]

FORMAT = 1
BASE = "linear-constant"
GENERATOR = SolverOptions(dx_cm=0.019, refine=2, cfl=0.8, tolerance_mmHg=2e-4)
"""Not the diagnosis' grid and time step: half and less of its cells, and another number of steps."""
THETA = {"f3": (3.5e4, 7e4), "psi1": (0.2, 0.5), "psi2": (0.7, 1.1), "c": (0.8, 1.8)}
"""The base's parameters are drawn around the published ones."""
GAP_MMHG = (0.15, 1.0)
"""Gap after refitting the base (rms over the pressures, without noise) that a case may have."""
NONE_SHARE, OUTSIDE_SHARE = 1 / 8, 1 / 5
KINDS = ("none", "outside", "listed")
LAYOUTS = ("MPA", "MPA+daughters", "MPA+distal", "MPA+flow")
NETWORKS = ("mouse", "tree")
WHITE_MMHG, CORRELATED_MMHG, CORRELATED_S = 0.05, 0.04, (2e-3, 6e-3)
FLOW_NOISE = 0.01
"""Noise of a flow, as a part of its peak."""
SAMPLES, INFLOW_SAMPLES = 512, 1024
DIGITS = {"pressure_mmHg": 4, "flow_ml_s": 6}
SECOND = "second-effect"
KEY_DIGEST = "KEY.sha256"
TRIES = 60
"""Effects, networks or parameters to draw before giving up."""
_TIME = 1577836800
"""Time stamp of every file of a case: when one was made tells how long its solves took."""


class BlindError(ValueError):
    """Cases, answers or a key that cannot be used; the text says why and what to change."""


# ---------------------------------------------------------------------------------------------------
# Effects that no catalogue holds


def active_tone(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The walls stiffen within the beat, by a smooth bump in systole."""
    phase = np.arange(256) / 256
    bump = np.where(np.abs(phase - 0.3) < 0.25, np.cos(2 * np.pi * (phase - 0.3)) ** 2, 0.0)
    return with_physics(case, stiffness_wave=1 + values[0] * bump)


def _closure(flow: Array) -> int:
    """First sample after the peak at which the inflow is below 2 % of it."""
    peak = int(np.argmax(flow))
    below = np.flatnonzero(flow[peak:] < 0.02 * flow[peak])
    return min(peak + int(below[0]) if len(below) else peak, len(flow) - 8)


def leaking_valve(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """A share of the stroke flows back through the inlet's valve in diastole."""
    flow = case.inflow_ml_s
    start = _closure(flow)
    back = np.zeros(len(flow))
    back[start:] = np.sin(np.pi * np.arange(len(flow) - start) / (len(flow) - start)) ** 2
    return replace(case, inflow_ml_s=flow - values[0] * flow.mean() * back / back.mean())


def valve_click(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The inflow rings just after the valve closes."""
    flow = case.inflow_ml_s
    since = (np.arange(len(flow)) - _closure(flow)) / len(flow)
    ring = np.where(since > 0, np.sin(2 * np.pi * 9 * since) * np.exp(-np.clip(since, 0, None) / 0.05), 0.0)
    return replace(case, inflow_ml_s=flow + values[0] * float(flow.max()) * ring)


def _outside(
    name: str, family: str, change: Callable[..., Case], equation: str, amplitude: Amplitude
) -> Effect:
    text = (change.__doc__ or "").strip()
    return Effect(name, family, text, equation, "zoo.blood.blind", "", (amplitude,), everywhere, change)


OUTSIDE: dict[str, Effect] = {
    made.name: made
    for made in (
        _outside(
            "active-tone",
            "wall",
            active_tone,
            "chi -> chi (1 + a b(t)), b a bump from 0.05 to 0.55 beats",
            Amplitude("rise", "1", 0.2, 0.0, 1.0, (0.2,)),
        ),
        _outside(
            "leaking-valve",
            "inflow",
            leaking_valve,
            "q -> q - f mean(q) w(t), w in diastole, of mean 1",
            Amplitude("share", "1", 0.1, 0.0, 0.6, (0.1,)),
        ),
        _outside(
            "valve-click",
            "inflow",
            valve_click,
            "q -> q + a max(q) sin(2 pi 9 s) exp(-s/0.05), s the beats since closure",
            Amplitude("size", "peak flow", 0.1, 0.0, 0.8, (0.1,)),
        ),
    )
}
"""Not in `zoo.blood.effects.CATALOGUE`, so that no diagnosis can name them; `second-effect` is two listed ones."""


# ---------------------------------------------------------------------------------------------------
# Studies before they have data


def _inflow(rng: np.random.Generator) -> tuple[float, Array, Array]:
    """Period, times and flow: the demo's beat with another length, width and peak."""
    period = round(float(rng.uniform(0.09, 0.13)), 4)
    width, peak = rng.uniform(0.9, 1.1), rng.uniform(0.85, 1.15)
    time, flow = ejection(16 * INFLOW_SAMPLES)
    phase = np.arange(INFLOW_SAMPLES) / INFLOW_SAMPLES
    shape = np.interp(phase / width, time / PERIOD_S, flow, right=0.0)
    return period, phase * period, np.round(peak * shape, 6)


def _rounded(vessel: Vessel) -> Vessel:
    """The vessel as its file tells it."""
    load = vessel.windkessel
    return replace(
        vessel,
        name=f"v{vessel.id}",
        length_cm=round(vessel.length_cm, 4),
        radius_cm=round(vessel.radius_cm, 5),
        radius_out_cm=round(vessel.radius_out_cm, 5),
        windkessel=load and Windkessel(*(float(f"{x:.8e}") for x in vars(load).values())),
    )


def tree(rng: np.random.Generator, n_vessels: int) -> list[tuple[int, int | None, float, float]]:
    """A random bifurcating tree: id, parent, length (cm) and radius (cm) of each vessel.

    Daughters of radii 1 : a, a in [0.65, 1], and r_p^3 = r_1^3 + r_2^3 (Murray), with 5 % of scatter; lengths
    of 5 to 15 radii.

    Parameters
    ----------
    rng : numpy.random.Generator
    n_vessels : int
        Odd.

    References
    ----------
    Murray 1926, doi 10.1073/pnas.12.3.207.
    """
    found = [(1, None, 0.0, float(rng.uniform(0.042, 0.055)))]  # type: list[tuple[int, int | None, float, float]]
    leaves = [0]
    while len(found) < n_vessels:
        weight = np.array([found[i][3] ** 2 for i in leaves])
        at = leaves.pop(int(rng.choice(len(leaves), p=weight / weight.sum())))
        ratio = rng.uniform(0.65, 1.0)
        first = found[at][3] / (1 + ratio**3) ** (1 / 3)
        for radius in rng.permutation([first, ratio * first]):
            leaves.append(len(found))
            scatter = math.exp(0.05 * rng.standard_normal())
            found.append((len(found) + 1, found[at][0], 0.0, float(radius) * scatter))
    return [
        (i, parent, max(0.05, radius * float(rng.uniform(5, 15))), radius) for i, parent, _, radius in found
    ]


def _loaded(
    rows: Sequence[tuple[int, int | None, float, float]], resistance: float, tau: float
) -> tuple[Vessel, ...]:
    """Vessels whose terminals share a total resistance (dyn s/cm5) by their areas; R C = tau (s) in each."""
    feeding = {parent for _, parent, _, _ in rows}
    area = sum(radius**2 for i, _, _, radius in rows if i not in feeding)
    vessels = []
    for i, parent, length, radius in rows:
        total = resistance * area / radius**2
        load = Windkessel(R1_SHARE * total, (1 - R1_SHARE) * total, tau / total)
        vessels.append(
            _rounded(Vessel(i, f"v{i}", length, radius, radius, parent, None if i in feeding else load))
        )
    return tuple(vessels)


def _places(rng: np.random.Generator, vessels: Sequence[Vessel], layout: str) -> list[tuple[int, float, str]]:
    """Where the sensors of a layout are: vessel, position, quantity."""
    pressure = "pressure_mmHg"
    children: dict[int | None, list[int]] = {}
    for v in vessels:
        children.setdefault(v.parent, []).append(v.id)
    root = children[None][0]
    found = [(root, 0.0, pressure)]
    daughters = children[root]
    if layout == "MPA+daughters":
        found += [(daughter, 0.5, pressure) for daughter in daughters]
    elif layout == "MPA+distal":
        for daughter in daughters[:2]:
            below, ends = [daughter], []
            while below:
                at = below.pop()
                below += children.get(at, [])
                ends += [] if at in children else [at]
            found.append((int(rng.choice(sorted(ends))), 0.5, pressure))
    elif layout == "MPA+flow":
        found.append((int(rng.choice(daughters)), 0.5, "flow_ml_s"))
    return found


@dataclass(frozen=True)
class Draw:
    """What cases are drawn from.

    Parameters
    ----------
    n, seed : int
    effects : tuple of str
        Of the catalogue.
    networks : tuple of str
        "mouse", "tree".
    layouts : tuple of str
        Of `LAYOUTS`.
    vessels : (int, int)
        Least and largest number of vessels of a tree.
    """

    n: int
    seed: int
    effects: tuple[str, ...]
    networks: tuple[str, ...] = NETWORKS
    layouts: tuple[str, ...] = LAYOUTS
    vessels: tuple[int, int] = (5, 15)

    @property
    def digest(self) -> str:
        """Of everything that shapes the cases."""
        content = json.dumps([FORMAT, asdict(self)], sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()[:16]

    def plan(self) -> list[tuple[str, str]]:
        """Kind and effect of each case; the effect is the first to be tried.

        Every effect comes once before one comes twice, in an order that the seed shuffles.
        """
        rng = np.random.default_rng([self.seed, self.n])
        none, outside = round(self.n * NONE_SHARE), round(self.n * OUTSIDE_SHARE)
        kinds = ["none"] * none + ["outside"] * outside + ["listed"] * (self.n - none - outside)

        def names(known: Sequence[str], wanted: int) -> list[str]:
            rounds = -(-wanted // len(known)) if wanted else 0
            return [str(x) for _ in range(rounds) for x in rng.permutation(known)][:wanted]

        found = [NO_GAP] * none + names((*OUTSIDE, SECOND), outside)
        found += names(self.effects, self.n - none - outside)
        return [(kinds[i], found[i]) for i in rng.permutation(self.n)]


# ---------------------------------------------------------------------------------------------------
# The gap that an effect leaves


BASE_ALONE = Hypothesis()


class _Fixed(Forward):
    """The base's waveforms with effects whose amplitudes stay as they are."""

    added: Added = ()

    def case(self, u: Array) -> Case:
        """The solve at these coordinates."""
        return apply_all(super().case(u), self.added)


def _pooled(rms: Mapping[str, float]) -> float:
    """Over the pressures."""
    return math.sqrt(float(np.mean([x**2 for label, x in rms.items() if label.endswith("mmHg")])))


class Bench:
    """A study to come: solves its truth and refits the base to it, on the generator's grid.

    Parameters
    ----------
    study : Study
        Without series.
    theta : mapping
        The base's parameters.
    places : sequence of (vessel, position, quantity)

    Raises
    ------
    EffectError
        If the base cannot be solved.
    """

    def __init__(
        self, study: Study, theta: Mapping[str, float], places: Sequence[tuple[int, float, str]]
    ) -> None:
        self.base, self.theta, self.places = get_base(BASE), dict(theta), list(places)
        self.times = np.arange(SAMPLES) * (study.period_s / SAMPLES)
        waves, reason = simulate(self.base.case(study, self.theta, GENERATOR), self.places, self.times)
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
        series = [Series(v, x, q, row) for (v, x, q), row in zip(self.places, waves, strict=True)]
        return replace(study, time_s=np.asarray(self.times), series=tuple(series))

    def _forward(self, added: Added, hypothesis: Hypothesis = BASE_ALONE) -> _Fixed:
        forward = _Fixed(self.study, self.base, hypothesis, self.harmonics, GENERATOR)
        forward.added = added
        return forward

    def truth(self, added: Added) -> Array | None:
        """Waveforms with these effects, or None where the solve fails."""
        if not added:
            return self.clean
        try:
            case = apply_all(self.base.case(self.study, self.theta, GENERATOR), added)
            waves, reason = simulate(case, self.places, self.times)
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
        """Fit the base to data.

        Parameters
        ----------
        data, against : array (n_series, n_times)
            What is fitted, and what the fit is compared with.
        added : sequence of (Effect, values, Place)
            Effects that the base has besides; they stay as they are.
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

    def gap(self, waves: Array | None) -> float:
        """Rms over the pressures of what the refitted base leaves of noise-free waveforms, mmHg."""
        found = None if waves is None else self.refit(waves, waves)
        return math.inf if found is None else _pooled(found[0])


def _prior_draw(rng: np.random.Generator, amplitude: Amplitude) -> float:
    low, high = ((x - amplitude.centre) / amplitude.scale for x in (amplitude.low, amplitude.high))
    return float(truncnorm.rvs(low, high, amplitude.centre, amplitude.scale, random_state=rng))


def visible(
    gap: Callable[[float], float],
    amplitude: Amplitude,
    value: float,
    limits: tuple[float, float],
    target: float,
) -> tuple[float | None, float, float]:
    """The amplitude nearest to one drawn whose gap lies within limits.

    Parameters
    ----------
    gap : function
        From an amplitude to the gap after refitting the base, mmHg; infinite where the solve fails.
    amplitude : Amplitude
    value : float
        Drawn; the side of 0 on which to look first.
    limits : (float, float)
        mmHg.
    target : float
        mmHg, within them: what to head for when the drawn amplitude's gap is outside.

    Returns
    -------
    value : float or None
        None if no amplitude in [low, high] gives such a gap.
    smallest, largest : float
        Of the gaps that were seen.
    """
    seen: list[float] = []
    for sign in (math.copysign(1.0, value), -math.copysign(1.0, value)):
        end = amplitude.high if sign > 0 else -amplitude.low
        if end <= 0:
            continue
        low, high, solved = max(0.0, amplitude.low if sign > 0 else -amplitude.high), end, True
        x = abs(value)
        for _ in range(14):
            found = gap(sign * x)
            if math.isfinite(found):
                seen.append(found)
            if limits[0] <= found <= limits[1]:
                return sign * x, min(seen), max(seen)
            if found < limits[0]:
                if x >= high and solved:
                    break  # the bound itself does not show it
                low = x
            else:
                high, solved = x, False
            if high - low < 0.01 * high:
                break
            x = x * target / max(found, 1e-9) if math.isfinite(found) else 0.0
            x = min(x, high) if solved else x
            if not low < x < high and not (solved and x == high):
                x = math.sqrt(max(low, 0.003 * high) * high)
    return None, min(seen, default=math.inf), max(seen, default=0.0)


def _periodic_noise(
    rng: np.random.Generator, length_s: float, period_s: float, shape: tuple[int, int]
) -> Array:
    """Unit noise whose covariance is exp(-|t - t'|/length) around the beat."""
    n = shape[1]
    step = np.minimum(np.arange(n), n - np.arange(n)) * (period_s / n)
    power = np.clip(np.fft.rfft(np.exp(-step / length_s)).real, 0, None)
    return np.asarray(np.fft.irfft(np.fft.rfft(rng.standard_normal(shape)) * np.sqrt(power), n))


def _autoregressive(rng: np.random.Generator, tau_s: float, step_s: float, shape: tuple[int, int]) -> Array:
    """Unit noise of first order, stationary from its first sample."""
    keep = math.exp(-step_s / tau_s)
    noise = rng.standard_normal(shape)
    for i in range(1, shape[1]):
        noise[:, i] = keep * noise[:, i - 1] + math.sqrt(1 - keep**2) * noise[:, i]
    return noise


# ---------------------------------------------------------------------------------------------------
# One case


@dataclass(frozen=True)
class _Job:
    draw: Draw
    index: int
    kind: str
    first: str
    folder: Path

    @property
    def name(self) -> str:
        return f"case-{self.index + 1:03d}"


def _network(rng: np.random.Generator, draw: Draw) -> tuple[str, list[Any]]:
    """Kind of network, and vessels: those of the mouse, or the rows of a tree without loads."""
    kind = str(rng.choice(draw.networks))
    if kind == "mouse":
        return kind, [_rounded(v) for v in with_nominal_loads(load_study("demo"))]
    low, high = draw.vessels
    return kind, tree(rng, int(rng.choice(range(low + (low + 1) % 2, high + 1, 2))))


def _bench(rng: np.random.Generator, job: _Job) -> tuple[Bench, dict[str, Any]]:
    """A study whose base solves, with a mean pressure of 10 to 20 mmHg at the root of a generated tree."""
    for _ in range(TRIES):
        kind, rows = _network(rng, job.draw)
        layout = str(rng.choice(job.draw.layouts))
        period, time, flow = _inflow(rng)
        theta = {name: float(f"{rng.uniform(*limits):.6g}") for name, limits in THETA.items()}
        tau, wanted = rng.uniform(1, 2) * period, rng.uniform(10, 20)
        resistance = mmhg_to_cgs(wanted, MMHG) / float(flow.mean())
        places: list[tuple[int, float, str]] = []
        for _ in range(6):
            vessels = tuple(rows) if kind == "mouse" else _loaded(rows, resistance, tau)
            study = Study(
                job.name, period, Blood(1.055, 0.049), vessels, time, flow, np.array([]), (), source="blind"
            )
            try:
                bench = Bench(study, theta, places or _places(rng, vessels, layout))
            except EffectError:
                break
            places, mean = bench.places, float(bench.clean[0].mean())
            if kind == "mouse" or 10 <= mean <= 20:
                network = {"kind": kind, "vessels": len(vessels)}
                return bench, {"network": network, "layout": layout, "base_parameters": theta}
            resistance *= max(0.3, min(3.0, 1 + (wanted - mean) / wanted))
    raise BlindError(f"{job.name}: {TRIES} networks could not be solved; give another seed")


def _side(name: str, place: Place, why: str, smallest: float, largest: float) -> dict[str, Any]:
    """What was drawn and cannot be used, for the key."""
    gaps = [x if math.isfinite(x) else None for x in (smallest, largest)]
    return {"effect": name, **place._asdict(), "why": why, "gaps_mmHg": gaps}


class _Drawn:
    """Draws effects for a bench until one can be seen; keeps a list of those that cannot."""

    def __init__(self, rng: np.random.Generator, bench: Bench) -> None:
        self.rng, self.bench = rng, bench
        self.invisible: list[dict[str, Any]] = []
        self.noise = np.zeros_like(bench.clean)
        """Correlated errors of unit size, (n_series, n_times); zero unless they are the effect."""

    def try_one(self, effect: Effect, limits: tuple[float, float] = GAP_MMHG) -> tuple[Added, Array] | None:
        """The effect at a place and amplitudes from its prior, scaled where needed; its waveforms."""
        bench, rng = self.bench, self.rng
        network = bench.base.case(bench.study, bench.theta).network
        places = effect.places(network)
        place = places[int(rng.integers(len(places)))]
        values = [_prior_draw(rng, a) for a in effect.amplitudes]
        target = math.exp(rng.uniform(math.log(1.1 * limits[0]), math.log(0.9 * limits[1])))
        rest = tuple(float(f"{x:.6g}") for x in values[1:])
        noise = self.noise
        if effect.apply is None:
            pressure = np.array([[float(q == "pressure_mmHg")] for _, _, q in bench.places])
            noise = pressure * _periodic_noise(rng, rest[0], bench.study.period_s, bench.clean.shape)

        def waves(x: float) -> Array | None:
            if effect.apply is None:
                return np.asarray(bench.clean + x * noise)
            return bench.truth(((effect, (float(f"{x:.6g}"), *rest), place),))

        found, smallest, largest = visible(
            lambda x: bench.gap(waves(x)), effect.amplitudes[0], values[0], limits, target
        )
        if found is None:
            why = (
                "invisible" if largest < limits[0] else "too large" if smallest > limits[1] else "not solved"
            )
            self.invisible.append(_side(effect.name, place, why, smallest, largest))
            return None
        size = float(f"{found:.6g}")
        made = waves(size)
        assert made is not None
        return ((effect, (size, *rest), place),), made


def _draw_effect(drawn: _Drawn, job: _Job) -> tuple[str, Added, Array]:
    """Name, effects and noise-free waveforms of a case that is not of kind "none"."""
    names = [job.first]
    others: Sequence[str] = (*OUTSIDE, SECOND) if job.kind == "outside" else job.draw.effects
    for _ in range(TRIES):
        name = names.pop() if names else str(drawn.rng.choice(others))
        if name == SECOND:
            two = _two(drawn, job.draw.effects)
            if two is not None:
                return name, *two
            continue
        effect = OUTSIDE[name] if job.kind == "outside" else get_effect(name)
        found = drawn.try_one(effect)
        if found is not None:
            return name, *found
    raise BlindError(f"{job.name}: none of {TRIES} effects that were drawn can be seen; give other effects")


def _two(drawn: _Drawn, effects: Sequence[str]) -> tuple[Added, Array] | None:
    """Two listed effects, each of which could be seen alone, and whose sum can."""
    listed = [n for n in effects if CATALOGUE[n].apply is not None]
    limits = (GAP_MMHG[0], 0.6 * GAP_MMHG[1])
    both: list[Added] = []
    for _ in range(TRIES // 3):
        name = str(drawn.rng.choice(listed))
        if both and name == both[0][0][0].name:
            continue
        found = drawn.try_one(CATALOGUE[name], limits)
        if found is None:
            continue
        if not both:
            both.append(found[0])
            continue
        added = (*both[0], *found[0])
        waves = drawn.bench.truth(added)
        gap = drawn.bench.gap(waves)
        if waves is not None and GAP_MMHG[0] <= gap <= GAP_MMHG[1]:
            return added, waves
    return None


def _case(job: _Job) -> dict[str, Any]:
    """Draw a case, write its files, and return its entry of the key."""
    rng = np.random.default_rng([job.draw.seed, job.draw.n, job.index])
    for attempt in range(4):
        bench, entry = _bench(rng, job)
        drawn = _Drawn(rng, bench)
        try:
            name, added, waves = (NO_GAP, (), bench.clean) if job.kind == "none" else _draw_effect(drawn, job)
            break
        except BlindError:
            if attempt == 3:
                raise
    pressure = np.array([q == "pressure_mmHg" for _, _, q in bench.places])[:, None]
    step = bench.study.period_s / SAMPLES
    tau = float(f"{rng.uniform(*CORRELATED_S):.6g}") if rng.random() < 0.5 else 0.0
    noise = rng.standard_normal(waves.shape) * np.array([[bench.sigma[q]] for _, _, q in bench.places])
    if tau:
        noise += CORRELATED_MMHG * pressure * _autoregressive(rng, tau, step, waves.shape)
    digits = [DIGITS[q] for _, _, q in bench.places]
    data = np.array([np.round(row, d) for row, d in zip(waves + noise, digits, strict=True)])
    study = bench.with_series(bench.study, data)
    write_case(study, job.folder / job.name)
    # both fits see the data; what they miss is counted without the noise
    errors = {q: Errors(sigma) for q, sigma in bench.sigma.items()}
    if tau:
        errors["pressure_mmHg"] = Errors(WHITE_MMHG, CORRELATED_MMHG / WHITE_MMHG, tau)
    before = bench.refit(data, waves, noise=errors)
    solved = tuple(a for a in added if a[0].apply is not None)
    if len(solved) < len(added):  # noise that is the effect is taken off
        data, waves = data - (waves - bench.clean), bench.clean
    after = bench.refit(data, waves, added=solved, free=bool(solved) and job.kind == "listed", noise=errors)
    if before is None:
        raise BlindError(f"{job.name}: the base could not be fitted; give another seed")
    first = added[0] if added else None
    return {
        "case": job.name,
        "format": FORMAT,
        "draw": job.draw.digest,
        "seed": job.draw.seed,
        "kind": job.kind,
        "effect": name,
        "amplitude": first[1][0] if first else None,
        "place": first[2].vessel if first else None,
        "effects": [
            {
                "effect": effect.name,
                **place._asdict(),
                "amplitudes": {a.name: x for a, x in zip(effect.amplitudes, values, strict=True)},
                "units": {a.name: a.unit for a in effect.amplitudes},
            }
            for effect, values, place in added
        ],
        "base": BASE,
        **entry,
        "noise": {
            "white": {UNITS[q]: float(s) for q, s in bench.sigma.items()},
            "correlated_mmHg": CORRELATED_MMHG if tau else 0.0,
            "correlation_time_s": tau,
        },
        "gap_mmHg": {
            "before": _pooled(before[0]),
            "after": _pooled(after[0]) if after else None,
            "before_per_series": before[0],
            "after_per_series": after[0] if after else None,
        },
        "base_fit": before[1],
        "invisible": drawn.invisible,
        "digest": study.checksum,
    }


def write_case(study: Study, folder: Path) -> None:
    """Write a case: `save_study`'s format with as many digits and columns in every case."""
    folder.mkdir(parents=True, exist_ok=True)

    def write(name: str, lines: Iterable[str]) -> None:
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")

    write(
        "study.toml",
        (
            f'name = "{study.name}"',
            'network = "network.toml"',
            'inflow = "inflow.csv"',
            'observations = "observations.csv"',
            f"period_s = {study.period_s:.4f}",
            'conventions = "printed"',
        ),
    )
    blood = study.blood
    lines = ["[blood]", f"density_g_cm3 = {blood.density_g_cm3:.3f}"]
    lines += [f"viscosity_g_cm_s = {blood.viscosity_g_cm_s:.3f}"]
    for v in study.vessels:
        lines += ["", "[[vessel]]", f"id = {v.id}", f'name = "{v.name}"']
        lines += [f"length_cm = {v.length_cm:.4f}", f"radius_cm = {v.radius_cm:.5f}"]
        lines += [] if v.parent is None else [f"parent = {v.parent}"]
        if v.windkessel is not None:
            load = ", ".join(f"{name} = {x:.8e}" for name, x in vars(v.windkessel).items())
            lines.append(f"windkessel = {{ {load} }}")
    write("network.toml", lines)
    pairs = zip(study.inflow_time_s, study.inflow_ml_s, strict=True)
    write("inflow.csv", ("time_s,flow_ml_s", *(f"{t:.8f},{q:.6f}" for t, q in pairs)))
    rows = [
        f"{s.vessel},{s.position:.1f},{s.quantity},{t:.8f},{x:10.{DIGITS[s.quantity]}f}"
        for s in study.series
        for t, x in zip(study.time_s, s.value, strict=True)
    ]
    write("observations.csv", ("vessel,position,quantity,time_s,value", *rows))
    try:
        same = load_study(folder).checksum == study.checksum
    except StudyError as error:
        raise BlindError(f"{folder}: what was written cannot be read: {error}") from None
    if not same:
        raise BlindError(f"{folder}: what was written reads back as another study")


def _seal(folder: Path, names: Sequence[str]) -> None:
    """Give all files one time stamp, in the order of the names: times of writing tell times of solving."""
    for name in names:
        for path in (*sorted((folder / name).iterdir()), folder / name):
            os.utime(path, (_TIME, _TIME))
    for path in (folder / KEY_DIGEST, folder):
        os.utime(path, (_TIME, _TIME))


# ---------------------------------------------------------------------------------------------------
# make


def make(
    folder: str | Path,
    n: int = 40,
    seed: int = 1,
    key: str | Path = "key.json",
    *,
    effects: Sequence[str] | None = None,
    networks: Sequence[str] = NETWORKS,
    layouts: Sequence[str] = LAYOUTS,
    vessels: tuple[int, int] = (5, 15),
    cores: int = 2,
    done: Callable[[str], None] = lambda case: None,
) -> Path:
    """Write studies with a withheld effect each, and the key apart.

    A draw depends only on the arguments up to `vessels`. Cases that an interrupted call wrote are kept.

    Parameters
    ----------
    folder : path
        For the cases, and the key's SHA-256.
    n : int
        Cases: an eighth without an effect, a fifth with one that the catalogue does not hold.
    seed : int
    key : path
        JSON file outside the folder.
    effects : sequence of str, optional
        Of the catalogue; all that fit the base if absent.
    networks : sequence of str
        "mouse", "tree".
    layouts : sequence of str
        Of `LAYOUTS`.
    vessels : (int, int)
        Least and largest number of vessels of a generated tree.
    cores : int
        Processes.
    done : callable
        Told the name of each finished case.

    Returns
    -------
    Path
        The key's.

    Raises
    ------
    BlindError
        If an argument is out of range, or folder and key hold another draw.
    """
    folder, key = Path(folder), Path(key)
    if n < 1 or n > 999 or cores < 1 or seed < 0:
        raise BlindError(
            f"n = {n}, seed = {seed}, cores = {cores}: give n from 1 to 999, seed >= 0, cores >= 1"
        )
    for what, given, some in (("networks", networks, NETWORKS), ("layouts", layouts, LAYOUTS)):
        if not given or set(given) - set(some):
            raise BlindError(f"{what} = {', '.join(given)}: give some of {', '.join(some)}")
    names = effects_for(BASE, effects)
    if len(names) < 2:
        raise BlindError(f"effects = {', '.join(names)}: give two or more, or what is withheld is known")
    if not 3 <= vessels[0] <= vessels[1] or (vessels[0] == vessels[1] and vessels[0] % 2 == 0):
        raise BlindError(
            f"vessels = {vessels[0]}, {vessels[1]}: give limits of at least 3 with an odd number between them"
        )
    if folder.resolve() in key.resolve().parents:
        raise BlindError(f"{key}: lies inside {folder}, where the cases are; put the key elsewhere")
    if not key.resolve().parent.is_dir():
        raise BlindError(f"{key}: folder {key.parent} does not exist; create it or choose another path")
    if folder.exists() and not folder.is_dir():
        raise BlindError(f"{folder}: is a file; give a folder")
    draw = Draw(n, seed, names, tuple(networks), tuple(layouts), (vessels[0], vessels[1]))
    jobs = [_Job(draw, i, *kind, folder) for i, kind in enumerate(draw.plan())]
    part = key.with_name(key.name + ".part")
    entries = {entry["case"]: entry for entry in (*_entries(key), *_lines(part))}
    strange = [e for e in entries.values() if e.get("draw") != draw.digest]
    known = {job.name for job in jobs}
    if strange:
        raise BlindError(f"{key}: is the key of another draw; give another --key, or remove it")
    if folder.is_dir():
        rest = sorted(p.name for p in folder.iterdir() if p.name not in known | {KEY_DIGEST})
        if rest:
            raise BlindError(f"{folder}: holds {rest[0]}, which is none of these cases; give an empty folder")
    if (folder / KEY_DIGEST).is_file() and not entries:
        raise BlindError(
            f"{folder}: holds cases whose key is not {key}; give an empty folder, or the key that is theirs"
        )
    folder.mkdir(parents=True, exist_ok=True)
    waiting = []
    for job in jobs:
        if job.name in entries and _written(folder / job.name, entries[job.name]["digest"]):
            done(job.name)
        else:
            waiting.append(job)
    with part.open("a", encoding="utf-8") as record:
        for _, entry in _each(_case, waiting, cores):
            entries[entry["case"]] = entry
            record.write(json.dumps(entry) + "\n")
            record.flush()
            done(entry["case"])
    text = json.dumps([entries[job.name] for job in jobs], indent=1) + "\n"
    _replace(key, text)
    _replace(folder / KEY_DIGEST, f"{hashlib.sha256(text.encode()).hexdigest()}  key.json\n")
    part.unlink()
    _seal(folder, [job.name for job in jobs])
    return key


def _each(work: Callable[[Any], Any], jobs: Sequence[Any], cores: int) -> Iterable[tuple[Any, Any]]:
    try:
        yield from each(work, jobs, cores)
    except BrokenProcessPool:
        raise BlindError(
            "a process ended before its case was done; the same command goes on with the rest"
        ) from None


def _replace(path: Path, text: str) -> None:
    """Write a file so that a kill leaves the old one or the new one."""
    new = path.with_name(path.name + ".new")
    new.write_text(text, encoding="utf-8")
    new.replace(path)


def _entries(key: Path) -> list[dict[str, Any]]:
    """Of a key that is there."""
    if not key.exists():
        return []
    try:
        found = json.loads(key.read_text(encoding="utf-8"))
        if not isinstance(found, list) or not all(isinstance(e, dict) and "case" in e for e in found):
            raise ValueError
    except (OSError, ValueError):
        raise BlindError(f"{key}: is there and is no key; give another --key") from None
    return found


def _lines(part: Path) -> list[dict[str, Any]]:
    """Of an unfinished key; a last line that was cut off is left out."""
    found = []
    for line in part.read_text(encoding="utf-8").splitlines() if part.exists() else []:
        try:
            found.append(json.loads(line))
        except ValueError:
            break
    return found


def _written(folder: Path, checksum: str) -> bool:
    try:
        return load_study(folder).checksum == checksum
    except StudyError:
        return False


# ---------------------------------------------------------------------------------------------------
# run


@dataclass(frozen=True)
class Ran:
    """What `run` did: names of cases that are diagnosed (before or now), and of those that failed."""

    diagnosed: tuple[str, ...]
    kept: tuple[str, ...]
    failed: Mapping[str, str]  # name -> reason


@dataclass(frozen=True)
class _Task:
    case: Path
    answer: Path
    base: str
    confirm: bool
    max_effects: int
    seed: int
    effects: tuple[str, ...] | None = None


def _no_key(folder: Path) -> None:
    """Refuse a folder that holds a key, beside the cases or inside one; nowhere else is looked."""
    for place in (folder, *sorted(p for p in folder.iterdir() if p.is_dir())):
        for path in sorted(place.iterdir()):
            if "key" in path.name.lower() and path.suffix.lower() == ".json":
                raise BlindError(
                    f"{path}: a key lies with the cases; move it elsewhere, a diagnosis must not see it"
                )


def _answered(task: _Task, study: Study) -> bool:
    """Whether a diagnosis of this study by this version is there."""
    try:
        found = read_diagnosis(task.answer)
        tree_there = bool(_case_facts(task.answer))
    except (DiagnosisError, BlindError):
        return False
    record = found.record
    return (
        tree_there
        and found.study_checksum == study.checksum
        and found.base == get_base(task.base).name
        and record.get("versions", {}).get("zoo") == versions()["zoo"]
        and record.get("seed") == task.seed
        and (found.confirmation is not None or not task.confirm)
    )


def _diagnose(task: _Task) -> str:
    """Diagnose a case; an empty text, or why it failed."""
    failed = task.answer / "failed.txt"
    task.answer.mkdir(parents=True, exist_ok=True)
    failed.unlink(missing_ok=True)
    try:
        study = load_study(task.case)
        facts = {
            "checksum": study.checksum,
            "parents": {str(v.id): v.parent for v in study.vessels},
            "series": [s.label for s in study.series],
        }
        (task.answer / "case.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
        found = diagnose(
            study,
            task.base,
            confirm=task.confirm,
            max_effects=task.max_effects,
            effects=task.effects,
            cores=1,
            seed=task.seed,
            folder=task.answer / "posteriors" if task.confirm else None,
        )
        found.save(task.answer)
    except Exception as error:
        (task.answer / "diagnosis.json").unlink(missing_ok=True)
        reason = " ".join(str(error).split()) or type(error).__name__
        failed.write_text(f"{reason}\n\n{traceback.format_exc()}", encoding="utf-8")
        return reason
    return ""


def run(
    cases: str | Path,
    answers: str | Path,
    *,
    base: str = BASE,
    confirm: bool = False,
    max_effects: int = 3,
    effects: Sequence[str] | None = None,
    seed: int = 1,
    cores: int = 2,
    done: Callable[[str], None] = lambda case: None,
) -> Ran:
    """Diagnose every case of a folder, each in a process of its own; no key is read or looked for.

    A case whose diagnosis.json is of the same data, base, seed and version is left as it is, so that an
    interrupted run goes on. One that fails has failed.txt instead.

    Parameters
    ----------
    cases : path
        Folder of studies.
    answers : path
        A folder for each case: diagnosis.json (`Diagnosis.save`), case.json.
    base : str
    confirm : bool
        Sample the leading explanations' posteriors too.
    max_effects, effects, seed
        As in `zoo.core.diagnosis.diagnosis.diagnose`.
    cores : int
        Processes.
    done : callable
        Told the name of each case that is finished.

    Returns
    -------
    Ran

    Raises
    ------
    BlindError
        If the folder holds a key or no study, or answers and cases are one folder.
    """
    cases, answers = Path(cases), Path(answers)
    if not cases.is_dir():
        raise BlindError(f"{cases}: no such folder; give one of `zoo blind make`")
    for what, count, least in (("cores", cores, 1), ("max_effects", max_effects, 1), ("seed", seed, 0)):
        if count < least:
            raise BlindError(f"{what} = {count}: must be at least {least}")
    base, chosen = get_base(base).name, None if effects is None else tuple(effects)
    _no_key(cases)
    if cases.resolve() in (answers.resolve(), *answers.resolve().parents):
        raise BlindError(f"{answers}: lies inside {cases}, the cases; give another folder for the answers")
    if answers.exists() and not answers.is_dir():
        raise BlindError(f"{answers}: is a file; give a folder")
    found = sorted(p for p in cases.iterdir() if (p / "study.toml").is_file())
    if not found:
        raise BlindError(f"{cases}: holds no folder with a study.toml; give one of `zoo blind make`")
    answers.mkdir(parents=True, exist_ok=True)
    if (cases / KEY_DIGEST).is_file():
        _replace(answers / KEY_DIGEST, (cases / KEY_DIGEST).read_text(encoding="utf-8"))
    kept, waiting = [], []
    for case in found:
        task = _Task(case, answers / case.name, base, confirm, max_effects, seed, chosen)
        try:
            ready = _answered(task, load_study(case))
        except StudyError:
            ready = False
        if ready:
            kept.append(case.name)
            done(case.name)
        else:
            waiting.append(task)
    failed = {}
    for task, reason in _each(_diagnose, waiting, cores):
        if reason:
            failed[task.case.name] = reason
        done(task.case.name)
    diagnosed = tuple(case.name for case in found if case.name not in failed)
    return Ran(diagnosed, tuple(kept), dict(sorted(failed.items())))


def _case_facts(answer: Path) -> dict[str, Any]:
    """Checksum, tree and series of an answered case."""
    path = answer / "case.json"
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        found["parents"] = {int(i): parent for i, parent in found["parents"].items()}
    except (OSError, ValueError, KeyError, AttributeError):
        raise BlindError(f"{path}: is missing or broken; make it again with `zoo blind run`") from None
    return dict(found)


# ---------------------------------------------------------------------------------------------------
# What is true


EVERYWHERE = Place()


@dataclass(frozen=True)
class TrueEffect:
    """An effect that a case was made with; its amplitude in the catalogue's unit, None where it has none."""

    name: str
    place: Place = EVERYWHERE
    amplitude: float | None = None


@dataclass(frozen=True)
class Truth:
    """What a key says about a case.

    Parameters
    ----------
    case : str
    kind : {"none", "outside", "listed"}
    label : str
        "no-gap", the effect's name, or "second-effect".
    effects : tuple of TrueEffect
    layout, network : str
    noise : float
        Sd of white and correlated noise together, mmHg.
    before, after : float or None
        Gap of the refitted base without and with the true effect, rms over the pressures, mmHg.
    digest : str
        Of the study; empty where the key has none.
    """

    case: str
    kind: str
    label: str
    effects: tuple[TrueEffect, ...]
    layout: str
    network: str
    noise: float
    before: float
    after: float | None
    digest: str = ""

    @property
    def names(self) -> frozenset[str]:
        """Explanations that are right: those of the effects, "no-gap", or "unlisted"."""
        if self.kind == "none":
            return frozenset((NO_GAP,))
        if self.kind == "outside" and self.label != SECOND:
            return frozenset((UNLISTED,))
        return frozenset(e.name for e in self.effects)

    @property
    def accepted(self) -> frozenset[str]:
        """What a probability may stand for: of two effects, also that neither explains the data alone."""
        return self.names | {UNLISTED} if self.label == SECOND else self.names

    @property
    def shrinkage(self) -> float | None:
        """Part of the gap that the true effect removes; None for what is no listed part of a solve."""
        solved = self.kind == "listed" and self.effects[0].name != CORRELATED
        if not solved or self.after is None or not self.before > 0:
            return None
        return 1 - self.after / self.before


def _own_truth(entry: Mapping[str, Any]) -> Truth:
    """From an entry of a key of `make`."""
    effects = tuple(
        TrueEffect(e["effect"], Place(e["vessel"], e["subtree"]), next(iter(e["amplitudes"].values())))
        for e in entry["effects"]
    )
    noise, network = entry["noise"], entry["network"]
    return Truth(
        entry["case"],
        entry["kind"],
        entry["effect"],
        effects,
        entry["layout"],
        network["kind"],
        math.hypot(noise["white"].get("mmHg", 0.0), noise["correlated_mmHg"]),
        entry["gap_mmHg"]["before"],
        entry["gap_mmHg"]["after"],
        entry["digest"],
    )


OTHER_NAMES = {
    "junction-loss": "minor-losses",
    "catheter-gain": "sensor-gain",
    "catheter-offset": "sensor-offset",
    "nonlinear-wall": "tangent-wall",
}
"""Effects of keys that were not made here -> those of the catalogue."""
_AMPLITUDES: dict[str, Callable[[float], float]] = {
    "distributed-outflow": lambda sections: sections - 1,
    "velocity-profile": lambda zeta: 2 / zeta,
}
"""Amplitudes of such keys -> those of the catalogue; others are the same."""


def _other_truth(entry: Mapping[str, Any]) -> Truth:
    """From a key that was made elsewhere: a file for each case, names with underscores."""
    name = (entry["effect"] or NO_GAP).replace("_", "-")
    kind = "none" if name == NO_GAP else "listed" if entry["in_library"] else "outside"
    name = OTHER_NAMES.get(name, name) if kind == "listed" else name
    if kind == "listed" and name not in CATALOGUE:
        raise BlindError(
            f"key of {entry['case']}: effect {entry['effect']!r}: is not in the catalogue; "
            "add its name to zoo.blood.blind.OTHER_NAMES"
        )
    effects: tuple[TrueEffect, ...] = ()
    if kind != "none":
        extra = entry.get("extra") or {}
        amplitude = _AMPLITUDES.get(name, float)(float(entry["amplitude"]))
        effects = (TrueEffect(name, Place(extra.get("vessel"), bool(extra.get("subtree"))), amplitude),)
    noise = math.hypot(entry["noise"]["white_sd_mmHg"], entry["noise"]["ar1_sd_mmHg"])

    def rms(values: Sequence[float]) -> float:
        return float(np.mean(np.square(values)))

    before = math.sqrt(rms(entry["base_fit"]["rms_noisefree_mmHg"]))
    after = math.sqrt(max(0.0, rms(entry["refit_with_true_effect"]["rms_noisy_mmHg"]) - noise**2))
    return Truth(entry["case"], kind, name, effects, entry["layout"], "mouse", noise, before, after)


def read_key(key: str | Path, answers: str | Path) -> tuple[list[Truth], bool]:
    """Read a key: a file of `make`, checked against the digest beside the answers, or a folder of others.

    Returns
    -------
    list of Truth
    bool
        Whether it was checked: a folder of keys that were not made here has no digest.

    Raises
    ------
    BlindError
        If it cannot be read, or is not the one that the cases came with.
    """
    key, digest = Path(key), Path(answers) / KEY_DIGEST
    if key.is_dir():
        if digest.is_file():
            raise BlindError(f"{key}: is a folder, but the cases came with a key of one file; give that one")
        files = sorted(key.glob("*.json"))
        if not files:
            raise BlindError(f"{key}: holds no .json; give a key, or a folder with one for each case")
        return [_entry(_other_truth, path.read_bytes(), path) for path in files], False
    try:
        content = key.read_bytes()
    except OSError as error:
        raise BlindError(
            f"{key}: cannot be read ({error.strerror}); give the key of `zoo blind make`"
        ) from None
    if not digest.is_file():
        raise BlindError(f"{digest}: is missing, the key cannot be checked; make it with `zoo blind run`")
    wanted = digest.read_text(encoding="utf-8").split()[:1]
    if [hashlib.sha256(content).hexdigest()] != wanted:
        raise BlindError(
            f"{key}: is not the key of these cases, or was changed: its SHA-256 is not that in {digest}; "
            "give the file that `zoo blind make` wrote with them"
        )
    return [_entry(_own_truth, json.dumps(e).encode(), key) for e in json.loads(content)], True


def _entry(read: Callable[[Mapping[str, Any]], Truth], content: bytes, path: Path) -> Truth:
    try:
        return read(json.loads(content))
    except (KeyError, TypeError, ValueError, IndexError) as error:
        if isinstance(error, BlindError):
            raise
        raise BlindError(f"{path}: is no key of cases ({type(error).__name__}: {error})") from None


# ---------------------------------------------------------------------------------------------------
# score

FLOOR = 1e-6
"""Least probability that the log score counts: one that was called impossible costs 13.8."""
BIN_EDGES = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 0.97, 1.0)
"""Of the reliability diagram."""
FULL_BIN = 8
"""Cases from which a bin of the reliability diagram counts."""
GAP_EDGES = (0.0, 0.15, 0.25, 0.4, 0.65, 1.0, math.inf)
CURVE_BINS = 6
WITHIN = 0.1
"""How near a stated shrinkage must be to the true one."""
MAJORITY = 0.5


@dataclass(frozen=True)
class CaseScore:
    """One case: what is true, what was answered, how near that is.

    Attributes
    ----------
    rank, group_rank : int or None
        Of the best-placed true explanation and of its group; None without an answer.
    leader, leader_probability : str, float
        First explanation, and the probability of its group.
    right : bool
        The leader's group holds what is accepted as true.
    first, group_first : bool
        The true effect, or its group, is ranked first.
    probability, group_probability : float
        Of what is true; with all that the study cannot tell from it.
    log_score, brier : float
        log p, and the sum over explanations of (p - 1[true])^2; `group_`: a group counts as one explanation;
        `uniform_`: of a guess that gives every explanation the same probability.
    distance : int or None
        Vessels between the true place and the leader's; None if one of them has no place.
    shrinkage, shrinkage_true, shrinkage_low, shrinkage_high : float or None
        Stated with its 95 % interval, and true.
    amplitude, amplitude_sd, amplitude_true : float or None
        Of the true effect, whatever leads.
    """

    case: str
    kind: str
    truth: str
    layout: str
    network: str
    gap: float
    noise: float
    answered: bool
    leader: str = ""
    leader_probability: float = 0.0
    right: bool = False
    rank: int | None = None
    group_rank: int | None = None
    first: bool = False
    group_first: bool = False
    false_alarm: bool | None = None
    called_unlisted: bool | None = None
    probability: float = 0.0
    group_probability: float = 0.0
    log_score: float | None = None
    group_log_score: float | None = None
    uniform_log_score: float | None = None
    uniform_group_log_score: float | None = None
    brier: float | None = None
    group_brier: float | None = None
    uniform_brier: float | None = None
    uniform_group_brier: float | None = None
    place: int | None = None
    leader_place: int | None = None
    distance: int | None = None
    shrinkage: float | None = None
    shrinkage_low: float | None = None
    shrinkage_high: float | None = None
    shrinkage_true: float | None = None
    amplitude: float | None = None
    amplitude_sd: float | None = None
    amplitude_true: float | None = None
    seconds: float = math.nan

    @property
    def gap_over_noise(self) -> float:
        """Gap over the sd of the noise."""
        return self.gap / self.noise

    @property
    def shrinkage_within(self) -> bool | None:
        """Whether the stated shrinkage is near the true one."""
        if self.shrinkage is None or self.shrinkage_true is None:
            return None
        return abs(self.shrinkage - self.shrinkage_true) <= WITHIN

    @property
    def shrinkage_covered(self) -> bool | None:
        """Whether its interval holds the true one."""
        if self.shrinkage_low is None or self.shrinkage_high is None or self.shrinkage_true is None:
            return None
        return self.shrinkage_low <= self.shrinkage_true <= self.shrinkage_high

    @property
    def amplitude_covered(self) -> bool | None:
        """Whether the stated amplitude's 95 % interval holds the true one."""
        if self.amplitude is None or self.amplitude_sd is None or self.amplitude_true is None:
            return None
        return abs(self.amplitude - self.amplitude_true) <= 1.96 * self.amplitude_sd


@dataclass(frozen=True)
class Rate:
    """A count out of n, its share, and the 95 % interval of Wilson; NaN of nothing."""

    count: int
    n: int

    @property
    def share(self) -> float:
        """count/n."""
        return self.count / self.n if self.n else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Of the share (Wilson 1927, doi 10.1080/01621459.1927.10502953)."""
        if not self.n:
            return math.nan, math.nan
        z2 = 1.96**2
        centre = (self.share + z2 / (2 * self.n)) / (1 + z2 / self.n)
        half = math.sqrt(z2 * (self.share * (1 - self.share) / self.n + z2 / (4 * self.n**2))) / (
            1 + z2 / self.n
        )
        return max(0.0, centre - half), min(1.0, centre + half)

    def record(self) -> dict[str, Any]:
        """For score.json."""
        low, high = self.interval
        return {"count": self.count, "n": self.n, "share": self.share, "low": low, "high": high}


@dataclass(frozen=True)
class ReliabilityBin:
    """Stated probabilities of one bin: how many came true, and the 95 % range if they are what they say."""

    low: float
    high: float
    n: int
    right: int
    stated: float
    band: tuple[int, int]

    @property
    def inside(self) -> bool:
        """Whether the count lies in the range."""
        return self.band[0] <= self.right <= self.band[1]


def reliability(stated: Sequence[float], right: Sequence[bool]) -> list[ReliabilityBin]:
    """Stated probabilities against how often they came true, by bins of `BIN_EDGES` that hold any.

    Parameters
    ----------
    stated : sequence of float
    right : sequence of bool

    Returns
    -------
    list of ReliabilityBin
        The range is that of a binomial count with the bin's mean stated probability.
    """
    p, hits = np.clip(np.asarray(stated, dtype=float), 0, 1), np.asarray(right, dtype=bool)
    at = np.clip(np.searchsorted(BIN_EDGES, p, side="right") - 1, 0, len(BIN_EDGES) - 2)
    found = []
    for i in range(len(BIN_EDGES) - 1):
        inside = at == i
        n = int(inside.sum())
        if n:
            mean = float(p[inside].mean())
            low, high = (int(x) for x in binom.interval(0.95, n, mean))
            found.append(
                ReliabilityBin(
                    BIN_EDGES[i], BIN_EDGES[i + 1], n, int(hits[inside].sum()), mean, (max(low, 0), high)
                )
            )
    return found


@dataclass(frozen=True, eq=False)
class Score:
    """Score of a set of answers.

    Attributes
    ----------
    cases : tuple of CaseScore
    summary : dict
        Of all cases.
    by : dict
        "layout", "effect", "gap", "network", "kind" -> value -> summary.
    reliability : list of ReliabilityBin
        Of the leading group's probability, a case each.
    reliability_all : list of ReliabilityBin
        Of every group's probability of at least 1 %.
    curve : list of dict
        Effect or its group ranked first against gap over noise, listed effects only.
    confusion : dict
        What is true -> what was ranked first -> how often.
    key_checked : bool
        Whether the key was checked against a digest.
    without_key : int
        Answers that the key says nothing about.
    """

    cases: tuple[CaseScore, ...]
    summary: dict[str, Any]
    by: dict[str, dict[str, dict[str, Any]]]
    reliability: list[ReliabilityBin]
    reliability_all: list[ReliabilityBin]
    curve: list[dict[str, Any]]
    confusion: dict[str, dict[str, int]]
    key_checked: bool
    without_key: int = 0

    def record(self) -> dict[str, Any]:
        """Content of score.json, without NaN."""
        cases = [
            asdict(c)
            | {
                name: getattr(c, name)
                for name in ("gap_over_noise", "shrinkage_within", "shrinkage_covered", "amplitude_covered")
            }
            for c in self.cases
        ]
        bins = {
            name: [asdict(b) | {"inside": b.inside} for b in getattr(self, name)]
            for name in ("reliability", "reliability_all")
        }
        found: dict[str, Any] = _without_nan(
            {
                "format": FORMAT,
                "versions": versions(),
                "key_checked": self.key_checked,
                "answers_without_key": self.without_key,
                "summary": self.summary,
                "by": self.by,
                **bins,
                "curve": self.curve,
                "confusion": self.confusion,
                "cases": cases,
            }
        )
        return found


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _without_nan(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def tree_distance(parents: Mapping[int, int | None], a: int, b: int) -> int:
    """Branchings between two vessels of a tree: 0 for the same, 1 for parent and daughter, 2 for sisters.

    Parameters
    ----------
    parents : mapping
        Id of each vessel -> that of the vessel that feeds it, None for the root.
    a, b : int
        Ids.
    """

    def path(vessel: int | None) -> list[int]:
        found = []
        while vessel is not None:
            found.append(vessel)
            vessel = parents[vessel]
        return found

    up, other = path(a), path(b)
    shared = next(v for v in up if v in other)
    return up.index(shared) + other.index(shared)


def _scores(p: float, others: Iterable[float], share: float, parts: int) -> tuple[float, float, float, float]:
    """Log and Brier score, and those of a uniform guess that gives `share` to what is true and the rest to
    `parts` others alike."""
    uniform = (share - 1) ** 2 + ((1 - share) ** 2 / parts if parts else 0.0)
    return (
        math.log(max(p, FLOOR)),
        (p - 1) ** 2 + sum(x**2 for x in others),
        math.log(share),
        uniform,
    )


def score_case(truth: Truth, found: DiagnosisFile | None, parents: Mapping[int, int | None]) -> CaseScore:
    """Score one answer.

    Parameters
    ----------
    truth : Truth
    found : DiagnosisFile or None
        None where the diagnosis failed.
    parents : mapping
        The tree: id of each vessel -> that of its parent.

    Returns
    -------
    CaseScore
    """
    place = truth.effects[0].place.vessel if len(truth.effects) == 1 else None
    blank = CaseScore(
        truth.case, truth.kind, truth.label, truth.layout, truth.network, truth.before, truth.noise,
        found is not None, place=place,
        false_alarm=False if truth.kind == "none" else None,
        called_unlisted=False if truth.kind == "outside" else None,
    )  # fmt: skip
    if found is None:
        return blank
    hypotheses = found.hypotheses
    by_name = {h.name: h for h in hypotheses}
    names = [h.name for h in hypotheses]
    leader = hypotheses[0]
    groups = list(dict.fromkeys(h.group for h in hypotheses))
    total = {g: sum(h.probability for h in hypotheses if h.group == g) for g in groups}
    true = [by_name[n] for n in truth.names if n in by_name]
    accepted = [by_name[n] for n in truth.accepted if n in by_name]
    true_groups = {h.group for h in accepted}

    # explanations that this study cannot show have no probability, and no share in a uniform guess
    visible = [h for h in hypotheses if h.name not in found.invisible]
    k = len(visible)
    p = sum(h.probability for h in accepted)
    share = max(1, sum(h in visible for h in accepted)) / k
    others = [h.probability for h in hypotheses if h not in accepted]
    one = _scores(p, others, share, k - sum(h in visible for h in accepted))
    p_group = sum(total[g] for g in true_groups)
    inside = [h for h in visible if h.group in true_groups]
    outer = [total[g] for g in groups if g not in true_groups]
    rest = len({h.group for h in visible} - true_groups)
    group = _scores(p_group, outer, max(1, len(inside)) / k, rest)

    called = None
    if truth.kind == "outside":
        listed = [h.probability for h in hypotheses if h.name not in (NO_GAP, UNLISTED)]
        called = leader.name == UNLISTED or UNLISTED in found.cause or max(listed, default=0.0) <= MAJORITY
        called = called or (truth.label == SECOND and leader.name in truth.names)
    distance = None
    if place is not None and leader.place is not None:
        distance = tree_distance(parents, place, leader.place)
    low, high = found.gap.removed_interval
    effect = _true_hypothesis(truth, by_name)
    return replace(
        blank,
        leader=leader.name,
        leader_probability=min(1.0, total[leader.group]),
        right=leader.group in true_groups,
        rank=min((names.index(h.name) + 1 for h in true), default=len(names) + 1),
        group_rank=min((groups.index(h.group) + 1 for h in true), default=len(groups) + 1),
        first=leader.name in truth.names,
        group_first=leader.group in {h.group for h in true},
        false_alarm=leader.name != NO_GAP if truth.kind == "none" else None,
        called_unlisted=called,
        probability=min(1.0, p),
        group_probability=min(1.0, p_group),
        log_score=one[0],
        brier=one[1],
        uniform_log_score=one[2],
        uniform_brier=one[3],
        group_log_score=group[0],
        group_brier=group[1],
        uniform_group_log_score=group[2],
        uniform_group_brier=group[3],
        leader_place=leader.place,
        distance=distance,
        shrinkage=found.gap.removed if truth.shrinkage is not None else None,
        shrinkage_low=low if truth.shrinkage is not None else None,
        shrinkage_high=high if truth.shrinkage is not None else None,
        shrinkage_true=truth.shrinkage,
        amplitude=effect.amplitude.mean if effect and effect.amplitude else None,
        amplitude_sd=effect.amplitude.sd if effect and effect.amplitude else None,
        amplitude_true=truth.effects[0].amplitude if effect else None,
        seconds=float(found.record.get("screening_seconds", math.nan)),
    )


_NO_AMPLITUDE = (CORRELATED, "coarse-grid")
"""The size of a free discrepancy has no interval; that of a grid's error depends on whose grid it is."""


def _true_hypothesis(truth: Truth, by_name: Mapping[str, HypothesisResult]) -> HypothesisResult | None:
    """The answer about the true effect, if it stands at the true place."""
    if truth.kind != "listed" or truth.effects[0].name in _NO_AMPLITUDE:
        return None
    effect = truth.effects[0]
    found = by_name.get(effect.name)
    same = found is not None and (found.place, found.subtree) == tuple(effect.place)
    return found if same else None


def _rate(flags: Iterable[bool | None]) -> dict[str, Any]:
    """Of those that are not None."""
    given = [flag for flag in flags if flag is not None]
    return Rate(sum(given), len(given)).record()


def _mean(values: Iterable[float | None]) -> float:
    given = [v for v in values if v is not None]
    return float(np.mean(given)) if given else math.nan


def summarise(cases: Sequence[CaseScore]) -> dict[str, Any]:
    """Rates with their 95 % intervals, and mean scores, of some cases.

    Parameters
    ----------
    cases : sequence of CaseScore

    Returns
    -------
    dict
        JSON's types; docs/blind.md says what each is.
    """
    listed = [c for c in cases if c.kind == "listed"]
    placed = [c for c in listed if c.place is not None and c.answered]
    named = [c for c in placed if c.leader_place is not None]
    ratios = [
        c.amplitude / c.amplitude_true
        for c in cases
        if c.amplitude is not None and c.amplitude_true is not None
    ]
    scores = (
        "log_score", "uniform_log_score", "group_log_score", "uniform_group_log_score",
        "brier", "uniform_brier", "group_brier", "uniform_group_brier",
    )  # fmt: skip
    return {
        "n": len(cases),
        "failed": sum(not c.answered for c in cases),
        "effect_first": _rate(c.first for c in listed),
        "effect_or_group_first": _rate(c.group_first for c in listed),
        "right": _rate(c.right for c in cases),
        "mean_rank": _mean(c.rank for c in listed),
        "mean_group_rank": _mean(c.group_rank for c in listed),
        "false_alarms": _rate(c.false_alarm for c in cases),
        "outside_called_unlisted": _rate(c.called_unlisted for c in cases),
        "second_effect_one_of_two_first": _rate(c.group_first for c in cases if c.truth == SECOND),
        "shrinkage_within_10_points": _rate(c.shrinkage_within for c in cases),
        "shrinkage_interval_holds_truth": _rate(c.shrinkage_covered for c in cases),
        "amplitude_interval_holds_truth": _rate(c.amplitude_covered for c in cases),
        "amplitude_ratio_median": float(np.median(ratios)) if ratios else math.nan,
        "place_named": _rate(c.leader_place is not None for c in placed),
        "place_exact": _rate(c.distance == 0 for c in named),
        "place_within_1": _rate(c.distance is not None and c.distance <= 1 for c in named),
        "place_mean_distance": _mean(c.distance for c in named),
        **{name: _mean(getattr(c, name) for c in cases) for name in scores},
        "screening_seconds": float(np.nansum([c.seconds for c in cases])),
    }


def _gap_name(gap: float) -> str:
    i = int(np.searchsorted(GAP_EDGES, gap, side="right")) - 1
    low, high = GAP_EDGES[i], GAP_EDGES[i + 1]
    return f"{low:g} to {high:g}" if math.isfinite(high) else f"over {low:g}"


def _curve(cases: Sequence[CaseScore]) -> list[dict[str, Any]]:
    """Share of true effects (or their groups) ranked first, by bins of gap over noise of as many cases."""
    listed = sorted((c for c in cases if c.kind == "listed"), key=lambda c: c.gap_over_noise)
    bins = max(1, min(CURVE_BINS, len(listed) // FULL_BIN))
    found = []
    for part in np.array_split(np.arange(len(listed)), bins) if listed else []:
        x = [listed[i].gap_over_noise for i in part]
        found.append(
            {"from": x[0], "to": x[-1], "median": float(np.median(x))}
            | _rate(listed[i].group_first for i in part)
        )
    return found


def assemble(
    cases: Sequence[CaseScore],
    stated: Sequence[tuple[float, bool]] = (),
    *,
    key_checked: bool = False,
    without_key: int = 0,
) -> Score:
    """Put the scores of cases together.

    Parameters
    ----------
    cases : sequence of CaseScore
    stated : sequence of (float, bool)
        Probability of every group of every case, and whether it holds what is true.
    key_checked : bool
    without_key : int

    Returns
    -------
    Score
    """
    keys: dict[str, Callable[[CaseScore], str]] = {
        "kind": lambda c: c.kind,
        "layout": lambda c: c.layout,
        "effect": lambda c: c.truth,
        "gap": lambda c: "no effect" if c.kind == "none" else _gap_name(c.gap),
        "network": lambda c: c.network,
    }
    by: dict[str, dict[str, dict[str, Any]]] = {}
    for name, value in keys.items():
        order = sorted({value(c) for c in cases}, key=lambda v: _order(v, cases, value, name))
        by[name] = {v: summarise([c for c in cases if value(c) == v]) for v in order}
    confusion: dict[str, dict[str, int]] = {}
    for c in cases:
        row = confusion.setdefault(c.truth, {})
        said = c.leader if c.answered else "failed"
        row[said] = row.get(said, 0) + 1
    given = [c for c in cases if c.answered]
    kept = [(p, right) for p, right in stated if p >= 0.01]
    return Score(
        tuple(cases),
        summarise(cases),
        by,
        reliability([c.leader_probability for c in given], [c.right for c in given]),
        reliability([p for p, _ in kept], [right for _, right in kept]),
        _curve(cases),
        confusion,
        key_checked,
        without_key,
    )


def _order(
    value: str, cases: Sequence[CaseScore], of: Callable[[CaseScore], str], name: str
) -> tuple[float, str]:
    """Gaps by size, all else by name."""
    if name != "gap" or value == "no effect":
        return (-1.0 if value == "no effect" else 0.0), value
    return min(c.gap for c in cases if of(c) == value), value


def score(answers: str | Path, key: str | Path, out: str | Path) -> Score:
    """Score answers against a key, and write score.json, cases.csv and score.md.

    Parameters
    ----------
    answers : path
        From `run`.
    key : path
        From `make`; or a folder with keys that were made elsewhere, a file for each case.
    out : path
        Folder.

    Returns
    -------
    Score

    Raises
    ------
    BlindError
        If the key is not that of the cases, or an answer is about other data.
    """
    answers, out = Path(answers), Path(out)
    if not answers.is_dir():
        raise BlindError(f"{answers}: no such folder; give the answers of `zoo blind run`")
    truths, checked = read_key(key, answers)
    there = {p.name for p in answers.iterdir() if p.is_dir()}
    if not there & {t.case for t in truths}:
        raise BlindError(f"{answers}: holds no answer to a case of {key}; give the answers to these cases")
    if out.exists() and not out.is_dir():
        raise BlindError(f"{out}: is a file; give a folder")
    cases, stated = [], []
    for truth in truths:
        folder = answers / truth.case
        if not (folder / "diagnosis.json").is_file():
            if not (folder / "failed.txt").is_file():
                raise BlindError(
                    f"{folder}: neither diagnosis.json nor failed.txt; finish `zoo blind run` first"
                )
            cases.append(score_case(truth, None, {}))
            continue
        found = read_diagnosis(folder)
        if truth.digest and found.study_checksum != truth.digest:
            raise BlindError(f"{folder}: diagnosis.json is about other data than the case; run it again")
        cases.append(score_case(truth, found, _case_facts(folder)["parents"]))
        total: dict[int, float] = {}
        right: dict[int, bool] = {}
        for h in found.hypotheses:
            total[h.group] = total.get(h.group, 0.0) + h.probability
            right[h.group] = right.get(h.group, False) or h.name in truth.accepted
        stated += [(total[g], right[g]) for g in total]
    others = len(there - {t.case for t in truths})
    found_score = assemble(cases, stated, key_checked=checked, without_key=others)
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(found_score.record(), indent=1, ensure_ascii=False)
    _replace(out / "score.json", text + "\n")
    _replace(out / "score.md", score_table(found_score))
    with (out / "cases.csv").open("w", encoding="utf-8", newline="") as file:
        rows = found_score.record()["cases"]
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return found_score


HEADLINES = (
    ("effect_or_group_first", "true effect, or the group that holds it, ranked first"),
    ("effect_first", "true effect ranked first"),
    ("false_alarms", "no-effect cases called a gap"),
    ("outside_called_unlisted", "outside cases called unlisted, or no listed effect above 50 %"),
    ("second_effect_one_of_two_first", "of two effects, one (or its group) ranked first"),
    ("shrinkage_within_10_points", "stated shrinkage within 10 points of the true one"),
    ("shrinkage_interval_holds_truth", "its 95 % interval holds the true one"),
    ("amplitude_interval_holds_truth", "95 % interval of the amplitude holds the true one"),
    ("place_exact", "vessel named is the true one"),
    ("place_within_1", "vessel named is the true one or next to it"),
)
"""Rates of a summary, in words."""


def rate_text(rate: Mapping[str, Any]) -> str:
    """Such as "95 % (38 of 40; 84 to 99 %)"."""
    if not rate["n"]:
        return "–"
    low, high = (f"{100 * rate[x]:.0f}" for x in ("low", "high"))
    return f"{100 * rate['share']:.0f} % ({rate['count']} of {rate['n']}; {low} to {high} %)"


def score_table(score: Score) -> str:
    """A score in Markdown: rates, mean scores, reliability, and the rates by layout, gap, effect, network."""
    s = score.summary
    lines = [f"{s['n']} cases, {s['failed']} without an answer.", "", "| | |", "|---|---|"]
    lines += [f"| {words} | {rate_text(s[name])} |" for name, words in HEADLINES]
    lines += [
        f"| log score by explanation (uniform guess) | {s['log_score']:.2f} ({s['uniform_log_score']:.2f}) |",
        f"| log score by group | {s['group_log_score']:.2f} ({s['uniform_group_log_score']:.2f}) |",
        f"| Brier score by explanation | {s['brier']:.3f} ({s['uniform_brier']:.3f}) |",
        f"| Brier score by group | {s['group_brier']:.3f} ({s['uniform_group_brier']:.3f}) |",
        f"| screening, minutes of one core | {s['screening_seconds'] / 60:.1f} |",
        "",
        "| stated probability of the leading group | cases | mean stated | right | 95 % range if reliable |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {b.low:g} to {b.high:g} | {b.n} | {b.stated:.3f} | {b.right} | {b.band[0]} to {b.band[1]} |"
        for b in score.reliability
    ]
    for what, rows in score.by.items():
        lines += ["", f"| {what} | cases | effect or group first | right | shrinkage within 10 points |"]
        lines += ["|---|---|---|---|---|"]
        for value, part in rows.items():
            rates = ("effect_or_group_first", "right", "shrinkage_within_10_points")
            cells = " | ".join(rate_text(part[name]) for name in rates)
            lines.append(f"| {value} | {part['n']} | {cells} |")
    return "\n".join(lines) + "\n"
