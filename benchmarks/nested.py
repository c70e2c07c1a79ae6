"""The evidence of solved sets of causes beside nested sampling with the simulator.

python -m benchmarks.nested [--sets 10] [--seed 1]               a three-vessel study with a wall that lags
python -m benchmarks.nested --study mouse-c6 --sets 2 [--most 8]  sets of so many parameters at most

Needs dynesty (`pip install dynesty`). Both take the errors' prior with the scale of the model error that the
set has at its mode, and integrate the noise by one dimension; nested sampling has neither Laplace's
approximation nor derivatives.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
from benchmarks.paun2020.calibration import cheap_study

from zoo import Study, diagnose, get_baseline, load_study
from zoo.blood.effects import CATALOGUE
from zoo.blood.solver import SolverOptions
from zoo.core.causes.evidence import SIZE_PRIORS, SetModel
from zoo.core.causes.problem import Problem
from zoo.core.diagnosis.sets import CauseSets
from zoo.core.diagnosis.solved import SolvedSet
from zoo.core.effects import AddedEffect, with_effects
from zoo.core.parameters import pack

OPTIONS = SolverOptions(dx_cm=0.1, tolerance_mmHg=1e-4)


def log_likelihood(sets: CauseSets, one: SolvedSet, values: np.ndarray) -> float:
    """Given all parameters, in their own units: errors are integrated over."""
    forward = one.forward
    u = np.array([p.coordinate(x) for p, x in zip(forward.parameters, values, strict=True)])
    computed = forward(u)
    if computed is None:
        return -1e300
    left = sets.search.data - computed
    none = np.zeros((len(left), 1))  # a parameter that does nothing
    problem = Problem(left, none, np.ones(1), np.zeros(1), -0.5 * math.log(2.0 * math.pi))
    evidence = one.evidence
    found = SetModel(problem, (), evidence.family).given(evidence.kinds, evidence.log_noise)
    return replace(found, signal=evidence.signal).total(SIZE_PRIORS)


def nested(sets: CauseSets, one: SolvedSet, live: int, seed: int) -> tuple[float, float, int]:
    """Log evidence, its standard error and the number of solves."""
    import dynesty

    parameters = one.forward.model.parameters
    edges = np.cumsum([0, *(p.size for p in parameters)])

    def transform(p: np.ndarray) -> np.ndarray:
        found = np.empty_like(p)
        for parameter, a, b in zip(parameters, edges[:-1], edges[1:], strict=True):
            found[a:b] = parameter.prior.quantile(p[a:b])
        return found

    sampler = dynesty.NestedSampler(
        lambda x: log_likelihood(sets, one, x), transform, int(edges[-1]), nlive=live,
        sample="rwalk", rstate=np.random.default_rng(seed),
    )  # fmt: skip
    sampler.run_nested(dlogz=0.1, print_progress=False)
    found = sampler.results
    return float(found.logz[-1]), float(found.logzerr[-1]), int(np.sum(found.ncall))


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--study", help="a built-in study; one of three vessels if absent")
    parser.add_argument("--sets", type=int, default=10)
    parser.add_argument("--most", type=int, default=8, help="parameters of a set")
    parser.add_argument("--live", type=int, default=60, help="live points")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    settings: dict[str, Any] = {"base": "linear-constant", "progress": False}
    study = load_study(args.study) if args.study else made_study(args.seed)
    if not args.study:
        settings["options"] = OPTIONS
    sets = diagnose(study, **settings).sets
    posterior = sets.posterior
    small = [
        w for w, one in sets.solved.items() if not one.evidence.free and len(one.forward.low) <= args.most
    ]
    small.sort(key=lambda w: -posterior.log_joint[w])
    print("set: parameters, log evidence, nested sampling, its error, difference, solves, seconds")
    for which in small[: args.sets]:
        one, began = sets.solved[which], time.monotonic()
        found, error, solves = nested(sets, one, args.live, args.seed)
        print(
            f"{sets.name(which)}: {len(one.forward.low)} {one.log_z:.2f} {found:.2f} {error:.2f} "
            f"{one.log_z - found:+.2f} {solves} {time.monotonic() - began:.0f}",
            flush=True,
        )


def made_study(seed: int) -> Study:
    """Three vessels whose wall is viscoelastic, in two places, with white noise of 0.05 mmHg."""
    study = cheap_study(64, ((1, 0.0), (2, 0.5)))
    forward = get_baseline("linear-constant").forward(study, options=OPTIONS)
    wall = AddedEffect(CATALOGUE["viscoelastic-wall"])
    model = with_effects(forward, [wall])
    values = pack(forward.parameters, {"f3": 5e4, "psi1": 0.4, "psi2": 0.9, "c": 1.2})
    waves = model.solve(model.configure(np.append(values, 4e-3)))
    noise = np.random.default_rng(seed).normal(0.0, 0.05, waves.shape)
    series = zip(study.series, waves + noise, strict=True)
    return replace(study, series=tuple(replace(one, value=row) for one, row in series))


if __name__ == "__main__":
    main()
