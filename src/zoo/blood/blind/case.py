"""One case: a network, an effect that can be seen, noise, and what the key says about them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.blood.blind.bench import BASELINE, SAMPLES, WHITE_MMHG, Added, Bench, over_pressures
from zoo.blood.blind.draw import FORMAT, Draw
from zoo.blood.blind.effect_draw import TRIES, EffectDraw, location_fields
from zoo.blood.blind.files import DIGITS, write_case
from zoo.blood.blind.networks import Sensor, inflow, loaded, rounded, sensors, tree
from zoo.blood.blind.noise import autoregressive
from zoo.blood.case import UNITS
from zoo.blood.network import with_nominal_loads
from zoo.blood.study import Blood, Study, load_study
from zoo.blood.units import MMHG, mmhg_to_cgs
from zoo.core.blindcheck.sealing import BlindError
from zoo.core.diagnosis.hypothesis import NULL
from zoo.core.effects import EffectError
from zoo.core.errors.spectral import GroupErrors

Array = NDArray[np.float64]

CORRELATED_MMHG, CORRELATED_S = 0.04, (2e-3, 6e-3)
THETA = {"f3": (3.5e4, 7e4), "psi1": (0.2, 0.5), "psi2": (0.7, 1.1), "c": (0.8, 1.8)}
"""The baseline's parameters are drawn around the published ones."""


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
    folder : Path
        Of the set.
    """

    draw: Draw
    index: int
    kind: str
    first: str
    folder: Path

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
    raise BlindError(f"{job.name}: {TRIES} networks could not be solved; give another seed")


def draw_case(job: CaseDraw) -> dict[str, Any]:
    """Draw a case, write its files, and return its entry of the key."""
    rng = np.random.default_rng([job.draw.seed, job.draw.n, job.index])
    for _ in range(4):
        bench, entry = _bench(rng, job)
        drawn = EffectDraw(rng, bench)
        found: tuple[str, Added, Array] | None = (NULL, (), bench.clean)
        if job.kind != "none":
            found = drawn.draw(job.first, job.kind, job.draw.effects)
        if found is not None:
            name, added, waves = found
            break
    else:
        raise BlindError(
            f"{job.name}: none of {TRIES} effects that were drawn can be seen; give other effects"
        )
    pressure = np.array([q == "pressure_mmHg" for _, _, q in bench.sensors])[:, None]
    step = bench.study.period_s / SAMPLES
    tau = float(f"{rng.uniform(*CORRELATED_S):.6g}") if rng.random() < 0.5 else 0.0
    noise = rng.standard_normal(waves.shape) * np.array([[bench.sigma[q]] for _, _, q in bench.sensors])
    if tau:
        noise += CORRELATED_MMHG * pressure * autoregressive(rng, tau, step, waves.shape)
    digits = [DIGITS[q] for _, _, q in bench.sensors]
    data = np.array([np.round(row, d) for row, d in zip(waves + noise, digits, strict=True)])
    study = bench.with_series(bench.study, data)
    write_case(study, job.folder / job.name)
    # both fits see the data; what they miss is counted without the noise
    errors = {q: GroupErrors(sigma) for q, sigma in bench.sigma.items()}
    if tau:
        errors["pressure_mmHg"] = GroupErrors(WHITE_MMHG, CORRELATED_MMHG / WHITE_MMHG, tau)
    before = bench.refit(data, waves, noise=errors)
    solved = tuple(a for a in added if a[0].apply is not None)
    if len(solved) < len(added):  # noise that is the effect is taken off
        data, waves = data - (waves - bench.clean), bench.clean
    after = bench.refit(data, waves, added=solved, free=bool(solved) and job.kind == "listed", noise=errors)
    if before is None:
        raise BlindError(f"{job.name}: the baseline could not be fitted; give another seed")
    first = added[0] if added else None
    return {
        "case": job.name,
        "format": FORMAT,
        "draw": job.draw.digest,
        "seed": job.draw.seed,
        "kind": job.kind,
        "effect": name,
        "amplitude": first[1][0] if first else None,
        "place": first[2].part if first else None,
        "effects": [
            {
                "effect": effect.name,
                **location_fields(place),
                "amplitudes": {a.name: x for a, x in zip(effect.parameters, values, strict=True)},
                "units": {a.name: a.unit for a in effect.parameters},
            }
            for effect, values, place in added
        ],
        "base": BASELINE,
        **entry,
        "noise": {
            "white": {UNITS[q]: float(s) for q, s in bench.sigma.items()},
            "correlated_mmHg": CORRELATED_MMHG if tau else 0.0,
            "correlation_time_s": tau,
        },
        "gap_mmHg": {
            "before": over_pressures(before[0]),
            "after": over_pressures(after[0]) if after else None,
            "before_per_series": before[0],
            "after_per_series": after[0] if after else None,
        },
        "base_fit": before[1],
        "invisible": drawn.invisible,
        "digest": study.checksum,
    }
