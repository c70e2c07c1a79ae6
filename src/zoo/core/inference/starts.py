"""Where chains begin: starts spread wider than the posterior, and the first history of their jumps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoo.core.inference.logposterior import Array, LogPosterior
from zoo.core.inference.mode import Mode
from zoo.core.inference.spaces import T_DOF, Gaussian


@dataclass(frozen=True)
class Start:
    """Where chains begin: starts (n_chains, n_dim), the Gaussian, the first archive (n, n_dim), the mode."""

    starts: Array
    reference: Gaussian
    archive: Array
    mode: Mode


def disperse(logp: LogPosterior, mode: Mode, chains: int, seed: int) -> Start:
    """Starts from a t distribution twice as wide as the Gaussian at the mode, failed solves rejected."""
    d = len(mode.vector)
    reference = Gaussian(mode.vector, mode.covariance)
    starts = []
    for chain in range(chains):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(chain, 0)))
        for _ in range(20):
            u = 2.0 * rng.standard_normal(d) * np.sqrt(T_DOF / rng.chisquare(T_DOF))
            lowest = mode.logp - 10.0 * d - 2.0 * float(u @ u)
            for _ in range(12):
                q = reference.colour(u)
                if logp(q) >= lowest:
                    break
                u = 0.7 * u
            else:
                continue
            break
        else:
            q = mode.vector
        starts.append(q)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1 << 30,)))
    archive = reference.colour(rng.standard_normal((10 * d, d)))
    return Start(np.array(starts), reference, archive, mode)
