"""The posterior over sets of causes: calibrated under its own prior, and beside frozen answers.

python -m benchmarks.causes calibrate [--replicates 500] [--seed 7]   linear problems of 20 causes, all drawn
python -m benchmarks.causes frozen OUT.jsonl [--each 3]               frozen blind cases; goes on where it was
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.blind.frozen.__main__ import frozen_answers, frozen_keys, sets, unpack
from scipy.stats import truncnorm

from zoo import load_study
from zoo.blood.baseline import get_baseline
from zoo.blood.diagnosis import HOOKS, SEARCH_SHARE, effects_for, errors_of
from zoo.blood.forward import study_data
from zoo.blood.study import Study
from zoo.core.blindcheck import CaseKey
from zoo.core.causes import Cause, CausePriors, ErrorFamily, Problem, weigh_causes
from zoo.core.causes.evidence import SizePriors, without
from zoo.core.causes.family import COLOURED, NOISE_SPREAD
from zoo.core.data import Data
from zoo.core.diagnosis.bounds import freed
from zoo.core.diagnosis.screening import Screening
from zoo.core.diagnosis.sets import CauseSets, cause_sets
from zoo.core.errors.spectral import Harmonics

RANGE = 10.0
BINS = (0.0, 0.001, 0.01, 0.05, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.000001)


@dataclass(eq=False)
class LinearToy:
    """Series of one group with three parameters and causes of several components, in five harmonics."""

    n_series: int = 2
    n_times: int = 32
    n_causes: int = 20
    n_components: int = 7
    sizes: SizePriors = field(default_factory=SizePriors)
    seed: int = 0

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        times = np.arange(self.n_times) / self.n_times
        wave = np.tile(0.5 * RANGE * np.sin(2 * np.pi * times), (self.n_series, 1))
        labels = [f"y{i}" for i in range(self.n_series)]
        data = Data(times, wave, labels, ["K"] * self.n_series, ["y"] * self.n_series, 1.0)
        self.errors = Harmonics().bind(data)
        k = np.arange(1, 6)[:, None]
        self.waves = np.concatenate([np.cos(2 * np.pi * k * times), np.sin(2 * np.pi * k * times)])
        self.causes = [self._cause(i) for i in range(self.n_causes)]
        self.jacobian = self.responses(3, 2.0)
        self.family = ErrorFamily(self.errors, {"y": RANGE})
        self.priors = CausePriors(self.causes)

    def responses(self, n: int, size: float) -> np.ndarray:
        weights = self.rng.standard_normal((n, self.n_series, len(self.waves))) / 5 * size
        return self.errors.flat(weights @ self.waves).T

    def _cause(self, i: int) -> Cause:
        component = f"c{i % self.n_components}"
        if i >= 0.7 * self.n_causes:
            return Cause(f"f{i}", component, self.responses(5, 0.5), free=True)
        bounds = {"low": 0.0, "high": 4.0} if i % 3 == 0 else {}
        return Cause(f"e{i}", component, self.responses(1, 1.0), **bounds)

    def problem(self, residual: np.ndarray) -> Problem:
        k = self.jacobian.shape[1]
        return Problem(residual, self.jacobian, np.ones(k), np.zeros(k), -0.5 * k * math.log(2 * math.pi))

    def drawn_set(self, rng: np.random.Generator) -> tuple[int, ...]:
        """A set of causes of its prior."""
        p = self.priors.odds / (1 + self.priors.odds)
        while True:
            there = [c for c in self.priors.names if rng.random() < p]
            if len(there) <= self.priors.most:
                break
        which = []
        for name in there:
            own = [i for i, one in enumerate(self.causes) if one.component == name]
            share = np.exp(self.priors.log_shares[own])
            which.append(int(rng.choice(own, p=share / share.sum())))
        return tuple(sorted(which))

    def signal(self, which: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
        """What causes of their prior sizes do."""
        total = np.zeros(len(self.jacobian))
        for i in which:
            one = self.causes[i]
            w = rng.standard_normal(one.columns.shape[1])
            if math.isfinite(one.low):
                w[0] = truncnorm.rvs(one.low, one.high, random_state=rng)
            total += one.columns @ (w * (abs(rng.standard_normal()) if one.free else 1.0))
        return total

    def variances(self, signal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Errors of their prior beside that signal."""
        f = self.family
        noise = np.exp(2 * (f.noise_centre[0] + NOISE_SPREAD * rng.standard_normal()))
        if rng.random() < COLOURED:
            p = np.exp(f.log_colours)
            return noise * f.kinds[0][1 + rng.choice(len(p), p=p / p.sum())]
        left = without(self.jacobian, signal, np.ones(len(signal))) if signal.any() else signal
        scales = self.sizes.scales(f.relative(left))
        scale = rng.choice(list(scales), p=list(scales.values()))
        size = abs(scale * rng.standard_normal())
        return noise + size**2 * f.discrepancies[rng.choice(len(f.shapes), p=np.exp(f.log_shapes))]

    def drawn(self, rng: np.random.Generator) -> tuple[tuple[int, ...], np.ndarray]:
        """A set and residual coefficients of the whole prior."""
        which = self.drawn_set(rng)
        signal = self.signal(which, rng)
        V = self.variances(signal, rng)
        moved = self.jacobian @ rng.standard_normal(self.jacobian.shape[1])
        return which, signal + moved + np.sqrt(V) * rng.standard_normal(len(V))


def calibrate(replicates: int, seed: int) -> None:
    """Draw problems from the prior, and compare stated probabilities with frequencies."""
    toy, rng = LinearToy(), np.random.default_rng(seed)
    stated, true, numbers, n_true = [], [], [], []
    began = time.monotonic()
    for i in range(replicates):
        which, residual = toy.drawn(rng)
        found = weigh_causes(toy.problem(residual), toy.causes, toy.family, priors=toy.priors, cores=1)
        p = found.included(lambda one: one.name)
        stated.append([p.get(one.name, 0.0) for one in toy.causes])
        true.append([k in which for k in range(len(toy.causes))])
        numbers.append(np.pad(found.number, (0, 5 - len(found.number))))
        n_true.append(len(which))
        if (i + 1) % 50 == 0 or i + 1 == replicates:
            print(f"{i + 1} of {replicates}, {time.monotonic() - began:.0f} s")
            _compare(stated, true, numbers, n_true)


def _compare(
    stated: list[list[float]], true: list[list[bool]], numbers: list[np.ndarray], n_true: list[int]
) -> None:
    p, there = np.array(stated), np.array(true, dtype=float)
    each, count = np.array(numbers), np.array(n_true)
    z = (p.sum(axis=0) - there.sum(axis=0)) / np.sqrt(np.sum(p * (1 - p), axis=0))
    print(f"causes: stated minus true, in standard errors: {np.round(z, 1)}")
    print("causes at once: stated, true, difference in standard errors")
    for k in range(5):
        off = each[:, k] - (count == k)
        errors = off.mean() / off.std() * len(off) ** 0.5
        print(f"  {k}: {each[:, k].mean():.4f} {(count == k).mean():.4f} {errors:+.1f}")
    print("stated probability of a cause: number, mean, frequency, difference in standard errors")
    for low, high in pairwise(BINS):
        inside = (p >= low) & (p < high)
        if inside.any():
            q, t = p[inside], there[inside]
            off = (q.sum() - t.sum()) / math.sqrt(float(np.sum(q * (1 - q))) + 1e-9)
            print(
                f"  {low:g} to {min(high, 1):g}: {q.size} {q.mean():.4f} {t.mean():.4f} {off:+.1f}",
                flush=True,
            )


def sets_of(study: Study, cores: int) -> CauseSets:
    """The posterior over sets of causes of a study, without the rest of a diagnosis."""
    data = study_data(study)
    model = get_baseline("linear-constant").forward(study, share=SEARCH_SHARE)
    effects, errors = effects_for(model), errors_of(study, data)
    screening = Screening(data, model, effects, errors=errors, smooth=HOOKS.smooth, cores=cores)
    return cause_sets(freed(screening)[0].run(), HOOKS, cores=cores)


def frozen(out: Path, each: int, cores: int) -> None:
    """Weigh frozen cases, drawn alike from every set, and score inclusion beside the former answers."""
    found = {}
    if out.exists():
        found = {line["case"]: line for line in map(json.loads, out.read_text(encoding="utf-8").splitlines())}
    by_set: dict[str, list[CaseKey]] = {}
    for key in frozen_keys():
        by_set.setdefault(key.case.split("/")[0], []).append(key)
    rng = np.random.default_rng(3)
    chosen = [keys[i] for _, keys in sorted(by_set.items()) for i in rng.permutation(len(keys))[:each]]
    with tempfile.TemporaryDirectory() as folder:
        unpack(Path(folder), sets())
        for key in chosen:
            if key.case in found:
                continue
            began = time.monotonic()
            line: dict[str, Any] = {"case": key.case}
            one = sets_of(load_study(Path(folder) / key.case), cores=cores)
            line |= {"components": one.posterior.components, "number": one.posterior.number.tolist()}
            line |= {"linear_error": one.linear_error, "seconds": time.monotonic() - began}
            line["sets"] = one.table(0.01)[["causes", "probability", "solved"]].to_dict("records")
            with out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
            found[key.case] = line
            print(
                key.case,
                key.label,
                {k: round(v, 2) for k, v in line["components"].items() if v > 0.02},
                flush=True,
            )
    _scores([key for key in chosen if key.case in found], found)


def _scores(keys: list[CaseKey], found: Mapping[str, Any]) -> None:
    former = frozen_answers()
    print("set: cases | log score of inclusion, no floor | Brier score | first right | wrong above 0.9")
    rows: dict[str, list[list[float]]] = {}
    for key in keys:
        answer = former[key.case]
        then = {one.name: one.probability for one in answer.components} if answer else {}
        now = found[key.case]["components"]
        names = [name for name in now if name in then]
        row = []
        for p in (now, then):
            right = np.array([p[n] if n in key.components else 1.0 - p[n] for n in names])
            first = max(names, key=lambda n, p=p: p[n])
            good = first in key.components if key.components else p[first] < 0.5
            wrong = sum(p[n] > 0.9 for n in names if n not in key.components)
            with np.errstate(divide="ignore"):
                row += [
                    float(np.log(right).mean()),
                    float(np.mean((1.0 - right) ** 2)),
                    float(good),
                    float(wrong),
                ]
        rows.setdefault(key.case.split("-")[0], []).append(row)
        rows.setdefault("all", []).append(row)
    for name, each in rows.items():
        a = np.array(each)
        d = a[:, 1] - a[:, 5]
        print(
            f"{name}: {len(a)} | {a[:, 0].mean():.3f} (former {a[:, 4].mean():.3f}) | {a[:, 1].mean():.4f} "
            f"(former {a[:, 5].mean():.4f}, difference {d.mean():+.4f} ± {d.std() / len(d) ** 0.5:.4f}) | "
            f"{a[:, 2].sum():.0f} ({a[:, 6].sum():.0f}) | {a[:, 3].sum():.0f} ({a[:, 7].sum():.0f})"
        )


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("calibrate")
    one.add_argument("--replicates", type=int, default=500)
    one.add_argument("--seed", type=int, default=7)
    other = commands.add_parser("frozen")
    other.add_argument("out", type=Path)
    other.add_argument("--each", type=int, default=3)
    other.add_argument("--cores", type=int, default=2)
    args = parser.parse_args()
    if args.command == "calibrate":
        calibrate(args.replicates, args.seed)
    else:
        frozen(args.out, args.each, args.cores)


if __name__ == "__main__":
    main()
