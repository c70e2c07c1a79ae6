"""Regions of a posterior that a chain finds its way between too seldom, each described by a Gaussian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

APART = 1.2
"""Least distance of two regions' centres, in the sum of their standard deviations: at 1 there is no gap."""
SLOW = 0.22
"""Effective sample size, in parts of the median coordinate's, below which passing between parts is slow."""


@dataclass(frozen=True)
class Gaussian:
    """Centre and scatter of a posterior in the unconstrained space.

    Parameters
    ----------
    mean : array (n_dim,)
    covariance : array (n_dim, n_dim)
    """

    mean: Array
    covariance: Array
    cholesky: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cholesky", np.linalg.cholesky(self.covariance))

    def whiten(self, q: Array) -> Array:
        """Coordinates (n_dim,) in which the Gaussian is standard normal."""
        from scipy.linalg import solve_triangular

        return np.asarray(solve_triangular(self.cholesky, q - self.mean, lower=True, check_finite=False))

    def colour(self, u: Array) -> Array:
        """The inverse of `whiten`; u may be (n, n_dim)."""
        return np.asarray(self.mean + u @ self.cholesky.T)

    def refit(self, points: Array) -> Gaussian:
        """Blend with the moments of correlated draws of a chain.

        A chain of n draws in d dimensions is counted as n / (4 d) independent ones, the present covariance
        as d of them and the present mean as two.

        Parameters
        ----------
        points : array (n, n_dim)
        """
        n, d = points.shape
        weight = n / (4.0 * d)
        mean = (points.mean(0) * weight + self.mean * 2.0) / (weight + 2.0)
        covariance = (np.cov(points.T).reshape(d, d) * weight + self.covariance * d) / (weight + d)
        return Gaussian(mean, covariance)

    def log_density(self, points: Array) -> Array:
        """Log density at points (n, n_dim), but for a constant that all Gaussians of a size share."""
        from scipy.linalg import solve_triangular

        u = solve_triangular(self.cholesky, (points - self.mean).T, lower=True, check_finite=False)
        return np.asarray(-0.5 * (u**2).sum(0) - self.log_volume)

    @property
    def log_volume(self) -> float:
        """Logarithm of the determinant of the Cholesky factor."""
        return float(np.log(np.diag(self.cholesky)).sum())


def labels(parts: Sequence[Gaussian], points: Array) -> NDArray[np.intp]:
    """Number of the Gaussian with the highest density at each of the points (n, n_dim)."""
    return np.asarray(np.argmax([part.log_density(points) for part in parts], axis=0))


def region_of(parts: Sequence[Gaussian], q: Array) -> int:
    """Number of the Gaussian with the highest density at q (n_dim,)."""
    return int(labels(parts, q[None])[0])


def split(chains: Array, known: Sequence[Gaussian] = ()) -> list[Gaussian] | None:
    """Regions of which chains see one too seldom: the known ones, with the largest cut in two.

    A cut begins somewhere along the coordinate whose draws are the most alike in time, and is then moved
    until each point is on the side of the likelier of two Gaussians in all coordinates. Of several such cuts
    that leave a gap, the one that the chains cross least often is taken.

    Parameters
    ----------
    chains : array (n_chains, n_draws, n_dim)
        Unconstrained.
    known : sequence of Gaussian

    Returns
    -------
    list of Gaussian or None
        None where no part stands apart, or where chains pass between the parts as often as they do all else.
    """
    import arviz as az

    n_chains, n, d = chains.shape
    if n < 4:
        return None
    sizes = [
        min(float(az.ess(chains[:, :, k], method=method)) for method in ("bulk", "tail")) for k in range(d)
    ]
    slowest, usual = int(np.argmin(sizes)), float(np.median(sizes))
    points = chains.reshape(-1, d)
    member = np.zeros(len(points), int) if not known else labels(known, points)
    largest = int(np.argmax(np.bincount(member)))
    within = member == largest
    least, beyond = SLOW * usual, None
    for cut in _cuts(points[within], slowest):
        label = np.zeros(len(points))
        label[within] = cut
        passing = float(az.ess(label.reshape(n_chains, n), method="mean"))
        if passing < least:
            least, beyond = passing, cut
    if beyond is None:
        return None
    group = points[within]
    common = _within(group[~beyond], group[beyond])
    two = [_describe(group[~beyond], common), _describe(group[beyond], common)]
    return [*(part for k, part in enumerate(known) if k != largest), *two]


def _cuts(points: Array, coordinate: int) -> list[NDArray[np.bool_]]:
    """Ways to cut points (n, n_dim) in two with a gap between: which (n,) are in the smaller part."""
    d = points.shape[1]
    x = points[:, coordinate]
    found = []
    for share in (0.02, 0.05, 0.2, 0.5, 0.8, 0.95, 0.98):
        beyond = x > np.quantile(x, share)
        for _ in range(50):
            if min(beyond.sum(), (~beyond).sum()) < 2 * d:
                break
            common = _within(points[~beyond], points[beyond])
            parts = [_describe(points[side], common) for side in (~beyond, beyond)]
            weights = np.log([1.0 - beyond.mean(), beyond.mean()])
            each = np.array([part.log_density(points) for part in parts]) + weights[:, None]
            before, beyond = beyond, each[1] > each[0]
            if np.array_equal(before, beyond):
                if _gap(points[~beyond], points[beyond], common) > APART:
                    found.append(beyond if beyond.mean() <= 0.5 else ~beyond)
                break
    return found


def _within(one: Array, other: Array) -> Array:
    """Covariance within two groups (n_dim, n_dim), kept away from singular."""
    inner = np.concatenate([one - one.mean(0), other - other.mean(0)])
    covariance = inner.T @ inner / len(inner)
    return np.asarray(covariance + np.diag(1e-12 + 1e-6 * np.diag(covariance)))


def _describe(group: Array, within: Array) -> Gaussian:
    """Mean of a group, and its covariance blended with that within all groups: n / (4 d) parts to one."""
    n, d = group.shape
    weight = n / (4.0 * d)
    return Gaussian(group.mean(0), (np.cov(group.T).reshape(d, d) * weight + within) / (weight + 1.0))


def _gap(one: Array, other: Array, within: Array) -> float:
    """Distance of the centres along Fisher's direction, in the sum of the standard deviations along it."""
    along = np.linalg.solve(within, other.mean(0) - one.mean(0))
    a, b = one @ along, other @ along
    return float(abs(a.mean() - b.mean()) / max(a.std() + b.std(), 1e-300))
