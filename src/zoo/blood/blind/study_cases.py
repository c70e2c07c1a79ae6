"""Studies with a withheld cause: the bench that solves them, the effect of a case, noise, and files."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.signal import lfilter

from zoo.blood.baseline import get_baseline
from zoo.blood.blind.networks import Sensor, inflow, loaded, rounded, sensors, tree
from zoo.blood.blood_flow import BloodFlow
from zoo.blood.case import UNITS
from zoo.blood.components import component_of
from zoo.blood.effects import CATALOGUE
from zoo.blood.network import with_nominal_loads
from zoo.blood.solver import SolverArgumentError, SolverOptions
from zoo.blood.study import Blood, Series, Study, load_study, save_study
from zoo.blood.units import MMHG, mmhg_to_cgs
from zoo.core.arrays import Array
from zoo.core.blindcheck.cases import NULL, BlindError, CaseKey
from zoo.core.blindcheck.drawing import LinearBaseline, draw_effect, told_of
from zoo.core.blindcheck.folders import MadeCase
from zoo.core.effects import AddedEffect, EffectError, with_effects
from zoo.core.forward import Outputs, SolveError
from zoo.core.parameters import pack

Added = tuple[tuple[AddedEffect, tuple[float, ...]], ...]

BASELINE = "linear-constant"
GENERATOR = SolverOptions(dx_cm=0.019, refine=2, cfl=0.8, tolerance_mmHg=2e-4)
"""Not the diagnosis' grid and time step: half and less of its cells, and another number of steps."""
SAMPLES = 512
PRESSURE = "pressure_mmHg"
DIGITS = {PRESSURE: 4, "flow_ml_s": 6}
"""Decimals of the data."""
WHITE_MMHG, FLOW_NOISE = 0.05, 0.01
"""White noise of the pressures; that of a flow, as a part of its peak."""
CORRELATED_MMHG, CORRELATED_S = 0.04, (2e-3, 6e-3)
GAP_OVER_NOISE = (0.5, 20.0)
"""What the refitted baseline leaves of the pressures (rms, without noise) over their noise, in a case with an
effect. What is drawn outside is drawn again."""
THETA = {"f3": (3.5e4, 7e4), "psi1": (0.2, 0.5), "psi2": (0.7, 1.1), "c": (0.8, 1.8)}
"""The baseline's parameters are drawn around the published ones."""
NETWORKS = ("mouse", "tree")
LAYOUTS = ("MPA", "MPA+daughters", "MPA+distal", "MPA+flow", "MPA+flows")
DRAWS, TRIES, BENCHES = 12, 60, 4
"""Draws of one effect before another is tried, draws on one network, and networks, before giving up."""


def stream(secret: str, *words: Any) -> np.random.Generator:
    """Random numbers for one purpose in one case.

    Their seed is SHA-256 of the secret and the purpose: who guesses one stream from what a case shows, such
    as the radii of its network, learns nothing of another one or of the secret.
    """
    digest = hashlib.sha256(json.dumps([secret, *words]).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest))


class Bench:
    """A study to come: solves its waveforms on the generator's grid, and says what the baseline leaves.

    Parameters
    ----------
    study : Study
        Without series.
    theta : mapping
        The baseline's parameters.
    placed : sequence of Sensor

    Raises
    ------
    EffectError
        If the baseline cannot be solved.
    """

    def __init__(self, study: Study, theta: Mapping[str, float], placed: Sequence[Sensor]) -> None:
        self.theta, self.sensors = dict(theta), list(placed)
        self.times: Array = np.asarray(np.arange(SAMPLES) * (study.period_s / SAMPLES), dtype=np.float64)
        self.flow: BloodFlow = get_baseline(BASELINE).forward(study, options=GENERATOR)
        self.values = pack(self.flow.parameters, self.theta)
        try:
            self.clean = self.flow.solve(
                self.flow.configure(self.values), Outputs(tuple(self.sensors), self.times)
            )
        except SolveError as error:
            raise EffectError(str(error)) from None
        self.study = self.with_series(study, self.clean)
        self.flow = get_baseline(BASELINE).forward(self.study, options=GENERATOR)
        self.pressures = [i for i, s in enumerate(self.study.series) if s.quantity == PRESSURE]
        peaks = np.abs(self.clean).max(axis=1)
        self.sigma = np.array([WHITE_MMHG if i in self.pressures else 0.0 for i in range(len(peaks))])
        flows = self.sigma == 0
        self.sigma[flows] = FLOW_NOISE * peaks[flows].max(initial=0.0)
        self._linear: LinearBaseline | None = None

    def with_series(self, study: Study, waves: Array) -> Study:
        """The study with these waveforms for data."""
        series = [Series(*sensor, row) for sensor, row in zip(self.sensors, waves, strict=True)]
        return replace(study, time_s=np.asarray(self.times), series=tuple(series))

    def solve(self, added: Added) -> Array | None:
        """Waveforms with these effects, or None where the solve fails."""
        try:
            more = with_effects(self.flow, [one for one, _ in added])
            return more.solve(more.configure(np.concatenate([self.values, *(x for _, x in added)])))
        except (EffectError, SolveError, SolverArgumentError):
            return None

    def gap(self, waves: Array | None) -> float:
        """Rms over the pressures of what the refitted baseline leaves of noise-free waveforms, mmHg."""
        if waves is None:
            return math.inf
        if self._linear is None:
            self._linear = LinearBaseline(self.flow, self.values)
        left = self._linear.left(waves, self.sigma)
        return float(np.sqrt(np.mean(left[self.pressures] ** 2)))


def draw_bench(
    rng: np.random.Generator,
    name: str,
    *,
    networks: Sequence[str] = NETWORKS,
    layouts: Sequence[str] = LAYOUTS,
    vessels: tuple[int, int] = (5, 15),
) -> tuple[Bench, dict[str, str]]:
    """A study whose baseline solves, and its tags; a tree has a mean of 10 to 20 mmHg at its root."""
    for _ in range(TRIES):
        kind = str(rng.choice(networks))
        if kind == "mouse":
            rows: list[Any] = [rounded(v) for v in with_nominal_loads(load_study("demo"))]
        else:
            odd = range(vessels[0] + (vessels[0] + 1) % 2, vessels[1] + 1, 2)
            rows = tree(rng, int(rng.choice(odd)))
        layout = str(rng.choice(layouts))
        period, time, flow = inflow(rng)
        theta = {one: float(f"{rng.uniform(*limits):.6g}") for one, limits in THETA.items()}
        tau, wanted = rng.uniform(1, 2) * period, rng.uniform(10, 20)
        resistance = mmhg_to_cgs(wanted, MMHG) / float(flow.mean())
        placed: list[Sensor] = []
        for _ in range(6):
            tied = tuple(rows) if kind == "mouse" else loaded(rows, resistance, tau)
            bare = Study(
                name, period, Blood(1.055, 0.049), tied, time, flow, np.array([]), (), source="blind"
            )
            placed = placed or sensors(rng, tied, layout)
            try:
                bench = Bench(bare, theta, placed)
            except EffectError:
                break
            mean = float(bench.clean[0].mean())
            if kind == "mouse" or 10 <= mean <= 20:
                series = {1: "one", 2: "two"}.get(len(placed), "three or more")
                return bench, {"network": kind, "layout": layout, "series": series}
            resistance *= max(0.3, min(3.0, 1 + (wanted - mean) / wanted))
    raise BlindError(f"{name}: {TRIES} networks could not be solved; make another set")


@dataclass(frozen=True)
class Cause:
    """What is wrong in a case.

    Parameters
    ----------
    kind, label, accepted, components
        As in `CaseKey`.
    added : Added
        All effects.
    waves : array (n_series, n_times)
        Without noise, in each series' unit.
    gap : float
        What the refitted baseline leaves of them.
    drawn : mapping
        What else the key says.
    """

    kind: str
    label: str
    accepted: tuple[str, ...]
    components: tuple[str, ...]
    added: Added
    waves: Array
    gap: float
    drawn: Mapping[str, Any] = field(default_factory=dict)


def draw_listed(
    rng: np.random.Generator, bench: Bench, names: Sequence[str], limits: tuple[float, float]
) -> Cause | None:
    """An effect of the catalogue at a location and of a size from its prior; None if nothing is in range.

    Parameters
    ----------
    rng : numpy.random.Generator
    bench : Bench
    names : sequence of str
        The first is tried first, then any.
    limits : (float, float)
        Of the gap, mmHg.
    """
    redrawn: Counter[str] = Counter()
    for tried in range(TRIES):
        if tried % DRAWS == 0:
            name = str(rng.choice(names)) if tried else names[0]
        effect = CATALOGUE[name]
        made, values = draw_effect(effect, bench.flow, rng)
        if effect.apply is None:  # correlated errors
            noise = np.zeros_like(bench.clean)
            shape = (len(bench.pressures), SAMPLES)
            noise[bench.pressures] = values[0] * periodic_noise(rng, values[1], bench.study.period_s, shape)
            waves: Array | None = bench.clean + noise
        else:
            waves = bench.solve(((made, values),))
        gap = bench.gap(waves)
        if waves is not None and limits[0] <= gap <= limits[1]:
            part = component_of(effect)
            told, added = {"redrawn": {} | redrawn}, ((made, values),)
            return Cause("listed", name, (name,), (part,) if part else (), added, waves, gap, told)
        redrawn[f"{name} {'below' if gap < limits[0] else 'above'}"] += 1
    return None


def nothing(bench: Bench) -> Cause:
    """No cause."""
    return Cause("none", NULL, (), (), (), bench.clean, 0.0)


def correlation(rng: np.random.Generator) -> tuple[float, float]:
    """Size (mmHg) and time (s) of the correlated part of a case's noise; 0 in half of the cases."""
    size = CORRELATED_MMHG if rng.random() < 0.5 else 0.0
    return size, float(f"{rng.uniform(*CORRELATED_S):.6g}")


def periodic_noise(
    rng: np.random.Generator, length_s: float, period_s: float, shape: tuple[int, int]
) -> Array:
    """Unit noise whose covariance is exp(-|t - t'|/length) around the beat."""
    n = shape[1]
    step = np.minimum(np.arange(n), n - np.arange(n)) * (period_s / n)
    power = np.clip(np.fft.rfft(np.exp(-step / length_s)).real, 0, None)
    return np.asarray(np.fft.irfft(np.fft.rfft(rng.standard_normal(shape)) * np.sqrt(power), n))


def autoregressive(rng: np.random.Generator, tau_s: float, step_s: float, shape: tuple[int, int]) -> Array:
    """Unit noise of first order, stationary from its first sample."""
    keep = math.exp(-step_s / tau_s)
    white = rng.standard_normal(shape)
    rest, _ = lfilter([math.sqrt(1 - keep**2)], [1.0, -keep], white[:, 1:], axis=1, zi=keep * white[:, :1])
    return np.concatenate([white[:, :1], rest], axis=1)


def case_of(
    bench: Bench,
    cause: Cause,
    rng: np.random.Generator,
    correlated: tuple[float, float],
    tags: Mapping[str, str],
) -> MadeCase:
    """Files and key of a case: the cause's waveforms with noise.

    Parameters
    ----------
    bench : Bench
    cause : Cause
    rng : numpy.random.Generator
        Of the noise.
    correlated : (float, float)
        Size (mmHg) and time (s) of the correlated part of the pressures' noise.
    tags : mapping
        As in `CaseKey`.
    """
    size, tau = correlated
    noise = rng.standard_normal(cause.waves.shape) * bench.sigma[:, None]
    step = bench.study.period_s / SAMPLES
    rest = autoregressive(rng, tau, step, cause.waves.shape)
    noise[bench.pressures] += size * rest[bench.pressures]
    digits = [DIGITS[q] for _, _, q in bench.sensors]
    data = np.array([np.round(row, d) for row, d in zip(cause.waves + noise, digits, strict=True)])
    # errors that are the effect are no part of what an answer should fit
    exact = bench.clean if any(one.effect.apply is None for one, _ in cause.added) else cause.waves
    told: dict[str, Any] = {}
    if cause.kind == "listed":
        told = told_of(*cause.added[0])
        if cause.label in ("correlated-noise", "coarse-grid"):  # their size depends on more than the effect
            told["parameter"] = None
    effects = [
        {"effect": one.name, "vessel": one.location.part, "subtree": one.location.subtree}
        | {"amplitudes": {p.name: x for p, x in zip(one.effect.parameters, values, strict=True)}}
        for one, values in cause.added
    ]
    drawn = {
        "effects": effects,
        "base_parameters": bench.theta,
        "white": {UNITS[q]: float(s) for (_, _, q), s in zip(bench.sensors, bench.sigma, strict=True)},
        "correlated": {"mmHg": size, "s": tau},
    }
    study = bench.with_series(bench.study, data)
    key = CaseKey(
        case=study.name,
        kind=cause.kind,
        label=cause.label,
        accepted=cause.accepted,
        components=cause.components,
        noise=math.hypot(float(bench.sigma[bench.pressures].max()), size),
        gap=cause.gap,
        truth=tuple(
            tuple(float(f"{x:.{d + 1}f}") for x in row) for row, d in zip(exact, digits, strict=True)
        ),
        tags=dict(tags),
        drawn=drawn | dict(cause.drawn),
        **told,
    )
    return MadeCase(key, study_files(study))


def study_files(study: Study) -> dict[str, str]:
    """Files of a case by name."""
    with TemporaryDirectory() as folder:
        save_study(study, folder)
        return {path.name: path.read_text(encoding="utf-8") for path in sorted(Path(folder).iterdir())}
