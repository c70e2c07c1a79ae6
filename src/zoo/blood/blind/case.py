"""One case: a network, an effect, noise, and what the key says about them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.blood.blind.bench import BASELINE, SAMPLES, WHITE_MMHG, Added, Bench, over_pressures
from zoo.blood.blind.causes import CAUSES
from zoo.blood.blind.draw import Draw
from zoo.blood.blind.effect_draw import TRIES, EffectDraw, another, location_fields
from zoo.blood.blind.files import DIGITS, case_files
from zoo.blood.blind.networks import Sensor, inflow, loaded, rounded, sensors, tree
from zoo.blood.blind.noise import autoregressive
from zoo.blood.blind.truths import Visited, true_functions
from zoo.blood.case import UNITS
from zoo.blood.network import with_nominal_loads
from zoo.blood.study import Blood, Study, load_study
from zoo.blood.units import MMHG, mmhg_to_cgs
from zoo.core.blindcheck.keys import PAIR
from zoo.core.blindcheck.sealing import BlindError, MadeCase
from zoo.core.diagnosis.hypothesis import NULL
from zoo.core.effects import Effect, EffectError, Location
from zoo.core.errors.spectral import GroupErrors

Array = NDArray[np.float64]

CORRELATED_MMHG, CORRELATED_S = 0.04, (2e-3, 6e-3)
COLOURED, COLOURED_S = (0.3, 2.0), (1e-3, 8e-3)
"""Of strongly coloured noise: its size over that of the white part, and its time."""
THETA = {"f3": (3.5e4, 7e4), "psi1": (0.2, 0.5), "psi2": (0.7, 1.1), "c": (0.8, 1.8)}
"""The baseline's parameters are drawn around the published ones."""
CENTRAL = (0.025, 0.975)
BENCHES = 20
"""Networks and layouts to be tried where the component of the cause is given."""
PATIENCE = 5
"""Those of them after which another component (pair) is tried."""


@dataclass(frozen=True)
class CaseDraw:
    """A case to be made.

    Parameters
    ----------
    draw : Draw
        The set that it belongs to.
    index : int
        Its number, from 0.
    kind, first : str
        Its kind, and the effect to be tried first.
    """

    draw: Draw
    index: int
    kind: str
    first: str

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"case-{self.index + 1:03d}"


def _network(rng: np.random.Generator, draw: Draw) -> tuple[str, list[Any]]:
    """Kind of network, and vessels: those of the mouse, or the rows of a tree without loads."""
    kind = str(rng.choice(draw.networks))
    if kind == "mouse":
        return kind, [rounded(v) for v in with_nominal_loads(load_study("demo"))]
    low, high = draw.vessels
    return kind, tree(rng, int(rng.choice(range(low + (low + 1) % 2, high + 1, 2))))


def _bench(rng: np.random.Generator, job: CaseDraw) -> tuple[Bench, dict[str, Any]]:
    """A study whose baseline solves; a generated tree has a mean pressure of 10 to 20 mmHg at its root."""
    for _ in range(TRIES):
        kind, rows = _network(rng, job.draw)
        layout = str(rng.choice(job.draw.layouts))
        period, time, flow = inflow(rng)
        theta = {name: float(f"{rng.uniform(*limits):.6g}") for name, limits in THETA.items()}
        tau, wanted = rng.uniform(1, 2) * period, rng.uniform(10, 20)
        resistance = mmhg_to_cgs(wanted, MMHG) / float(flow.mean())
        placed: list[Sensor] = []
        for _ in range(6):
            vessels = tuple(rows) if kind == "mouse" else loaded(rows, resistance, tau)
            study = Study(
                job.name, period, Blood(1.055, 0.049), vessels, time, flow, np.array([]), (), source="blind"
            )
            try:
                bench = Bench(study, theta, placed or sensors(rng, vessels, layout))
            except EffectError:
                break
            placed, mean = bench.sensors, float(bench.clean[0].mean())
            if kind == "mouse" or 10 <= mean <= 20:
                network = {"kind": kind, "vessels": len(vessels)}
                return bench, {"network": network, "layout": layout, "base_parameters": theta}
            resistance *= max(0.3, min(3.0, 1 + (wanted - mean) / wanted))
    raise BlindError(f"{job.name}: {TRIES} networks could not be solved; make another set")


def _correlation(rng: np.random.Generator, kind: str) -> tuple[float, float]:
    """Size (mmHg) and time (s) of the correlated part of a case's noise; 0 where there is none."""
    if kind == "coloured":
        size, tau = (math.exp(rng.uniform(*np.log(limits))) for limits in (COLOURED, COLOURED_S))
        return float(f"{WHITE_MMHG * size:.6g}"), float(f"{tau:.6g}")
    correlated = CORRELATED_MMHG if rng.random() < 0.5 else 0.0
    return correlated, float(f"{rng.uniform(*CORRELATED_S):.6g}") if correlated else 0.0


def _effect(effect: Effect, values: tuple[float, ...], place: Location) -> dict[str, Any]:
    """An effect as the key tells it; of a cause, the limits of its size instead of a prior's interval."""
    cause = CAUSES.get(effect.name)
    found = {
        "effect": effect.name,
        **location_fields(place),
        "amplitudes": {a.name: x for a, x in zip(effect.parameters, values, strict=True)},
        "units": {a.name: a.unit for a in effect.parameters},
    }
    if cause is None:
        intervals = {a.name: [float(x) for x in a.prior.quantile(CENTRAL)] for a in effect.parameters}
        return found | {"priors_95": intervals}
    told = {"component": cause.component, "equation": cause.equation, "limits": [cause.low, cause.high]}
    return found | told


def _causes(
    bench: Bench,
    drawn: EffectDraw,
    added: Added,
    data: Array,
    waves: Array,
    errors: dict[str, GroupErrors],
) -> dict[str, Any]:
    """What the key says of causes in known components: their functions, and the gap with them refitted."""
    if not added or any(effect.name not in CAUSES for effect, _, _ in added):
        return {}
    before, after = bench.case(), bench.case(added)
    visited = Visited(after, bench.states(added))
    found = bench.refit(data, waves, errors, added)
    quantities = [q for _, _, q in bench.sensors]
    tables = true_functions(before, after, visited, bench.pressures(added), quantities, bench.labels)
    return {
        "components": list(dict.fromkeys(CAUSES[effect.name].component for effect, _, _ in added)),
        "shapes": {effect.name: drawn.shapes[effect.name] for effect, _, _ in added},
        "functions": tables,
        "visited": visited.record(),
        "refit_with_true_effects": found
        and {"gap_mmHg": over_pressures(found[0]), "gap_per_series": found[0], "parameters": found[1]},
    }


@dataclass(frozen=True, eq=False)
class CaseTruth:
    """What a case is made of, before its noise.

    Parameters
    ----------
    bench : Bench
        The study to come.
    entry : dict
        What its key says of network, sensors and parameters.
    effects : EffectDraw
        What drew the effects.
    name : str
        Of the first effect, or "no-gap".
    added : Added
        All effects.
    waves : array (n_series, n_times)
        Without noise, in each series' unit.
    correlated : (float, float)
        Sd (mmHg) and time (s) of the correlated part of the pressures' noise.
    """

    bench: Bench
    entry: dict[str, Any]
    effects: EffectDraw
    name: str
    added: Added
    waves: Array
    correlated: tuple[float, float]


def draw_truth(job: CaseDraw, noises: np.random.Generator) -> CaseTruth:
    """Draw what a case is made of.

    Parameters
    ----------
    job : CaseDraw
    noises : Generator
        From which the noise's correlation is drawn first.

    Returns
    -------
    CaseTruth

    Raises
    ------
    BlindError
        If no effect that was drawn has a model discrepancy of the size that is wanted.
    """
    network, effects = (job.draw.rng(what, job.index) for what in ("network", "effect"))
    correlated, tau = _correlation(noises, job.draw.kind)
    first = job.first
    for tried in range(BENCHES if job.kind in ("component", PAIR) else 4):
        if tried and not tried % PATIENCE:
            first = another(effects, job.kind)
        bench, entry = _bench(network, job)
        drawn = EffectDraw(effects, bench, math.hypot(WHITE_MMHG, correlated), job.draw.limits)
        if job.kind == "none":
            return CaseTruth(bench, entry, drawn, NULL, (), bench.clean, (correlated, tau))
        found = drawn.draw(first, job.kind, job.draw.effects)
        if found is not None:
            return CaseTruth(bench, entry, drawn, *found, (correlated, tau))
    low, high = job.draw.limits
    raise BlindError(
        f"{job.name}: no effect that was drawn has a model discrepancy of {low:g} to {high:g} times the "
        "noise; give other effects, layouts or networks"
    )


def draw_case(job: CaseDraw) -> MadeCase:
    """Draw a case: its files, and its entry of the key."""
    noises = job.draw.rng("noise", job.index)
    truth = draw_truth(job, noises)
    bench, entry, drawn, added, waves = truth.bench, truth.entry, truth.effects, truth.added, truth.waves
    name, (correlated, tau) = truth.name, truth.correlated
    pressure = np.array([q == "pressure_mmHg" for _, _, q in bench.sensors])[:, None]
    noise = noises.standard_normal(waves.shape) * np.array([[bench.sigma[q]] for _, _, q in bench.sensors])
    errors = {q: GroupErrors(sigma) for q, sigma in bench.sigma.items()}
    if correlated:
        step = bench.study.period_s / SAMPLES
        noise += correlated * pressure * autoregressive(noises, tau, step, waves.shape)
        errors["pressure_mmHg"] = GroupErrors(WHITE_MMHG, correlated / WHITE_MMHG, tau)
    digits = [DIGITS[q] for _, _, q in bench.sensors]
    data = np.array([np.round(row, d) for row, d in zip(waves + noise, digits, strict=True)])
    study = bench.with_series(bench.study, data)
    # the fit sees the data; what it misses is counted without the noise
    before = bench.refit(data, waves, errors)
    if before is None:
        raise BlindError(f"{job.name}: the baseline could not be fitted; make another set")
    # errors that are the effect are no part of what an answer should fit
    exact = bench.clean if any(effect.apply is None for effect, _, _ in added) else waves
    leading = added[0] if added else None
    return MadeCase(
        {
            "case": job.name,
            "kind": job.kind,
            "effect": name,
            "amplitude": leading[1][0] if leading else None,
            "place": leading[2].part if leading else None,
            **_causes(bench, drawn, added, data, waves, errors),
            "effects": [_effect(*one) for one in added],
            "base": BASELINE,
            **entry,
            "noise": {
                "white": {UNITS[q]: float(s) for q, s in bench.sigma.items()},
                "correlated_mmHg": correlated,
                "correlation_time_s": tau,
            },
            "gap_mmHg": {"before": over_pressures(before[0]), "before_per_series": before[0]},
            "base_fit": before[1],
            "redrawn": {effect: dict(counts) for effect, counts in drawn.redrawn.items()},
            "truth": {
                label: " ".join(f"{x:.{d + 1}f}" for x in row)
                for label, row, d in zip(bench.labels, exact, digits, strict=True)
            },
            "digest": study.checksum,
        },
        case_files(study),
    )
