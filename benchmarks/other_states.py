"""Does what is learned in one state hold in another? Cases with a cause that is withheld, in two states each.

Causes are those of `benchmarks/blind/causes.py`. The second state is the same tree with another inflow,
of a heart that beats 10 to 25 % faster and ejects 10 to 40 % more in a time. A cause in the inflow's record
is one of the first record only, so that its function ought not to hold in the second state; all others act
in both.

Prints a row for each case: what the baseline, the discrepancy at the sensor and the leader leave in the
second state, and whether the leader holds there; then how often it does, by whether the leader is right.

Usage: python -m benchmarks.other_states [--n 14] [--secret HEX] [--cores 2]
"""

from __future__ import annotations

import argparse
import secrets
from dataclasses import replace
from typing import Any

import numpy as np
from benchmarks.blind.sets import Job, draw_truth, plan

from zoo.blood.blind.networks import inflow
from zoo.blood.blind.study_cases import SAMPLES, Bench, Cause, stream
from zoo.blood.study import Study
from zoo.blood.study_diagnosis import diagnose
from zoo.core.diagnosis import DiagnosisFile
from zoo.core.effects import EffectError

FASTER, MORE = (0.8, 0.9), (1.1, 1.4)
"""Limits of the second state's period and flow, in the first one's."""


def measured(bench: Bench, waves: np.ndarray, rng: np.random.Generator) -> Study:
    """Waveforms with white noise, as a study."""
    return bench.with_series(bench.study, waves + bench.sigma[:, None] * rng.standard_normal(waves.shape))


def second_state(first: Bench, cause: Cause, rng: np.random.Generator) -> tuple[Bench, np.ndarray] | None:
    """The same tree under another inflow, and its waveforms; None where it cannot be solved."""
    study = first.study
    flow = inflow(rng)[-1]
    period = round(study.period_s * rng.uniform(*FASTER), 4)
    flow = flow * (rng.uniform(*MORE) * study.inflow_ml_s.mean() / flow.mean())
    time = np.arange(len(flow)) * (period / len(flow))
    bare = replace(
        study, name=f"{study.name}-faster", period_s=period, inflow_time_s=time, inflow_ml_s=flow,
        time_s=np.array([]), series=(),
    )  # fmt: skip
    try:
        bench = Bench(bare, first.theta, first.sensors)
    except EffectError:
        return None
    waves = bench.clean if "inflow" in cause.components else bench.solve(cause.added)
    return None if waves is None else (bench, waves)


def row_of(true: str, file: DiagnosisFile) -> dict[str, Any]:
    """What leads, how probable it is, what is left in the second state, and what holds there."""
    first, state = next(one for one in file.sets if one.causes == file.cause), file.states[0]
    held = next((c for c in state.carried if c.names == first.components), None)
    holding = [c.names for c in state.carried if c.holds]
    return {
        "true": true,
        "leader": "+".join(first.components) or "nothing",
        "probability": first.probability,
        "right": true in first.components,
        "holds": held is not None and held.holds,
        "errors": (state.baseline.mean, state.sensor.mean, (held.error if held else state.baseline).mean),  # type: ignore[union-attr]
        "holding": [" and ".join(sorted(names)) for names in holding],
        "others hold": any(true not in names for names in holding),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--n", type=int, default=14)
    parser.add_argument("--secret", help="of an earlier run, 32 hexadecimal digits", default="")
    parser.add_argument("--cores", type=int, default=2)
    args = parser.parse_args()
    secret = args.secret or secrets.token_hex(16)
    print(f"secret {secret}, {SAMPLES} samples; errors in mmHg beyond the noise", flush=True)
    layouts = ("MPA+daughters", "MPA+distal", "MPA+flows")
    rows = []
    for i, first_tried in enumerate(plan("component", args.n, secret)):
        noises = stream(secret, "component", "noise", i)
        bench, cause, _, _ = draw_truth(Job("component", secret, layouts, i, first_tried), noises)
        rng = stream(secret, "second state", i)
        second = second_state(bench, cause, rng)
        if second is None:
            print(f"{bench.study.name} {cause.label}: no second state could be solved", flush=True)
            continue
        first = measured(bench, cause.waves, rng)
        found = diagnose(first, states=[measured(*second, rng)], cores=args.cores)
        row = row_of(cause.components[0], found.file)
        rows.append(row)
        baseline, sensor, leader = row["errors"]
        print(
            f"{bench.study.name} true {row['true']} ({cause.label}), leads {row['leader']} "
            f"{row['probability']:.2f}: baseline {baseline:.3f}, sensor {sensor:.3f}, leader {leader:.3f}; "
            f"holds: {', '.join(row['holding']) or 'nothing'}",
            flush=True,
        )
    lasting = [r for r in rows if r["true"] != "inflow"]
    for what, chosen in (
        ("right, a cause of both states", [r for r in lasting if r["right"]]),
        ("wrong, a cause of both states", [r for r in lasting if not r["right"]]),
        ("a cause of the first record only", [r for r in rows if r["true"] == "inflow"]),
    ):
        if chosen:
            medians = ", ".join(f"{x:.3f}" for x in np.median([r["errors"] for r in chosen], axis=0))
            print(
                f"{what}: the leader holds in {sum(r['holds'] for r in chosen)} of {len(chosen)}; medians of "
                f"what baseline, sensor and leader leave: {medians}"
            )
    ought = [r["right"] and r["true"] != "inflow" for r in rows]
    agree = sum(r["holds"] == x for r, x in zip(rows, ought, strict=True))
    print(f"whether the leader ought to hold: right in {agree} of {len(rows)}; always yes: {sum(ought)}")
    others = sum(r["others hold"] for r in lasting)
    print(f"a cause of both states, and something of another component holds too: {others} of {len(lasting)}")


if __name__ == "__main__":
    main()
