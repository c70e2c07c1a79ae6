"""The posterior over sets of causes, calibrated under its own prior.

python -m benchmarks.causes calibrate [--replicates 500] [--seed 7]   linear problems of 20 causes
python -m benchmarks.causes distorted [--replicates 40] [--seed 7]    one cause, its response off by 5, 10 %
python -m benchmarks.causes noise [--replicates 30] [--seed 7]        white and AR(1) noise, no cause
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.stats import truncnorm

from zoo.core.causes import Cause, CausePriors, ErrorFamily, Problem, weigh_causes
from zoo.core.causes.evidence import SizePriors, without
from zoo.core.causes.family import COLOURED, NOISE_SPREAD
from zoo.core.causes.posterior import CausePosterior
from zoo.core.data import Data
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
            return noise * f.of(1 + rng.choice(len(p), 1, p=p / p.sum()))[0][0]
        if not signal.any():
            scales, like, beside = *self.sizes.scales(None), f
        else:
            left = without(self.jacobian, signal, np.ones(len(signal)))
            scales, like = self.sizes.scales(f.relative(left))
            beside = f.beside(left)
        each = [*scales, *like]
        at = rng.choice(len(each), p=[*scales.values(), *like.values()])
        size = abs(each[at] * rng.standard_normal())
        shape = len(f.shapes) if at >= len(scales) else rng.choice(len(f.shapes), p=np.exp(f.log_shapes))
        return noise + size**2 * beside.discrepancy(shape)

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


def _weighed(toy: LinearToy, residual: np.ndarray) -> CausePosterior:
    return weigh_causes(toy.problem(residual), toy.causes, toy.family, priors=toy.priors, cores=1)


def distort(replicates: int, seed: int) -> None:
    """One cause of its prior size, its response off, at a noise of a hundredth of what it does."""
    toy, rng = LinearToy(), np.random.default_rng(seed)
    print("off by: cases, true cause above 0.5, expected number of others, others above 0.5")
    for off in (0.0, 0.05, 0.1):
        stated, right, wrong = [], 0, 0
        for k in rng.choice(len(toy.causes), replicates):
            signal = toy.signal((int(k),), rng)
            beside = toy.responses(1, 1.0)[:, 0]
            signal = signal + off * np.linalg.norm(signal) / np.linalg.norm(beside) * beside
            gap = without(toy.jacobian, signal, np.ones(len(signal)))
            noise = 0.01 * math.sqrt(float(np.mean(gap**2)))
            p = _weighed(toy, signal + noise * rng.standard_normal(len(signal))).components
            own = p.pop(toy.causes[k].component)
            right, wrong = right + (own > 0.5), wrong + sum(x > 0.5 for x in p.values())
            stated.append(sum(p.values()))
        print(f"{off:.0%}: {replicates} {right} {sum(stated):.2f} {wrong}", flush=True)


def only_noise(replicates: int, seed: int) -> None:
    """No cause, beside white noise and noise that is correlated in time, of one part of the range."""
    toy, rng = LinearToy(), np.random.default_rng(seed)
    n = toy.n_times
    print("noise: cases, most probable is nothing, mean probability of it, a component above 0.5")
    for name, rho in (("white", 0.0), ("AR(1), 0.5", 0.5), ("AR(1), 0.9", 0.9)):
        nothing, above = [], 0
        for _ in range(replicates):
            e = rng.standard_normal((toy.n_series, 20 * n))
            for t in range(1, e.shape[1]):
                e[:, t] = rho * e[:, t - 1] + math.sqrt(1 - rho**2) * e[:, t]
            found = _weighed(toy, toy.errors.flat(0.1 * e[:, -n:]))
            nothing.append(found.probability[()])
            above += max(found.components.values()) > 0.5
        first = sum(x > 0.5 for x in nothing)
        print(f"{name}: {replicates} {first} {np.mean(nothing):.3f} {above}", flush=True)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    runs = {"calibrate": (calibrate, 500), "distorted": (distort, 40), "noise": (only_noise, 30)}
    for name, (_, replicates) in runs.items():
        one = commands.add_parser(name)
        one.add_argument("--replicates", type=int, default=replicates)
        one.add_argument("--seed", type=int, default=7)
    args = parser.parse_args()
    runs[args.command][0](args.replicates, args.seed)


if __name__ == "__main__":
    main()
