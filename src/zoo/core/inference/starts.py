"""Where chains begin: starts spread wider than the posterior, and the first history of their jumps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from zoo.core.arrays import Array
from zoo.core.inference.logposterior import LogPosterior
from zoo.core.inference.mode import Mode
from zoo.core.inference.spaces import T_DOF, Gaussian


@dataclass(frozen=True)
class Start:
    """Where chains begin: starts (n_chains, n_dim), the Gaussian, the first archive (n, n_dim), the mode."""

    starts: Array
    reference: Gaussian
    archive: Array
    mode: Mode

    def stored(self) -> dict[str, Any]:
        """As a run's file has it: plain numbers, which JSON keeps to the last digit."""
        mode = self.mode
        return {
            "starts": self.starts.tolist(),
            "mode": mode.vector.tolist(),
            "logp": mode.logp,
            "covariance": mode.covariance.tolist(),
            "evaluations": mode.evaluations,
        }

    @classmethod
    def of_stored(cls, found: Mapping[str, Any], logp: LogPosterior, seed: int) -> Start:
        """As it was when `stored` was called."""
        vector, covariance = np.array(found["mode"]), np.array(found["covariance"])
        mode = Mode(vector, logp.to_values(vector), found["logp"], covariance, found["evaluations"])
        reference = Gaussian(vector, covariance)
        return cls(np.array(found["starts"]), reference, first_archive(reference, seed), mode)


def disperse(logp: LogPosterior, mode: Mode, chains: int, seed: int) -> Start:
    """Starts from a t distribution twice as wide as the Gaussian at the mode, failed solves rejected."""
    reference = Gaussian(mode.vector, mode.covariance)
    starts = []
    for chain in range(chains):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(chain, 0)))
        place = scattered(logp, reference, mode.logp, rng)
        starts.append(mode.vector if place is None else place)
    return Start(np.array(starts), reference, first_archive(reference, seed), mode)


def scattered(
    logp: Callable[[Array], float], reference: Gaussian, highest: float, rng: np.random.Generator
) -> Array | None:
    """A draw (n_dim,) of a t distribution twice as wide as a Gaussian, nearer where the posterior is too low.

    `highest` is the log-posterior at the Gaussian's mean. None if nothing was found.
    """
    d = len(reference.mean)
    for _ in range(20):
        u = 2.0 * rng.standard_normal(d) * np.sqrt(T_DOF / rng.chisquare(T_DOF))
        lowest = highest - 10.0 * d - 2.0 * float(u @ u)
        for _ in range(12):
            q = reference.colour(u)
            if logp(q) >= lowest:
                return q
            u = 0.7 * u
    return None


def first_archive(reference: Gaussian, seed: int) -> Array:
    """The first history (10 n_dim, n_dim) that jumps are drawn from: draws of the Gaussian."""
    d = len(reference.mean)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1 << 30,)))
    return reference.colour(rng.standard_normal((10 * d, d)))


def start_settings(start: Mapping[str, ArrayLike] | Mode | None) -> Any:
    """A start as a run's identity has it: plain numbers."""
    if start is None:
        return None
    if isinstance(start, Mode):
        return [float(value) for value in start.vector]
    return {name: np.asarray(value, dtype=float).tolist() for name, value in start.items()}
