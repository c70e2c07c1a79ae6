"""Ranks of truths among draws of their posteriors, and whether they are uniform."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEVELS = (0.5, 0.8, 0.95)
"""Of central intervals whose coverage is asked for."""
LOG_POSTERIOR = "log_posterior"
"""Name of the ranked quantity beside the parameters: the log-posterior density, which sees all of them."""


class CalibrationError(ValueError):
    """A calibration that cannot start or go on; its text says why and what to change."""


@dataclass(frozen=True)
class Replicate:
    """One truth, its ranks, and how its posterior was sampled.

    `truth` and `sd` (of the ranked draws) are in the parameters' own units; `rank` is the number of the
    ranked draws below the truth, `ess` the bulk effective sample size of all draws, `steps` those of each
    chain that count; `redrawn` counts draws of the prior in vain, by reason.
    """

    number: int
    truth: dict[str, float]
    rank: dict[str, int]
    sd: dict[str, float]
    ess: dict[str, float]
    rhat: float
    accepted: float
    steps: int
    redrawn: dict[str, int]
    seconds: float
    correction: str = ""
    k_hat: float | None = None


@dataclass(frozen=True)
class RankTest:
    """Ranks of truths among posterior draws, and tests of their being uniform on 0, ..., L.

    Parameters
    ----------
    names : tuple of str
        Ranked quantities.
    ranks : int array (n_replicates, n_names)
    ranked : int
        L, draws that each truth is ranked among.
    replicates : tuple of Replicate
        Where the ranks come from; may be empty.

    Raises
    ------
    CalibrationError
        If the shapes do not fit, or a rank is not in 0, ..., L.
    """

    names: tuple[str, ...]
    ranks: NDArray[np.int64]
    ranked: int
    replicates: tuple[Replicate, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        ranks = np.asarray(self.ranks, dtype=np.int64)
        if ranks.ndim != 2 or ranks.shape[1] != len(self.names) or len(ranks) == 0:
            raise CalibrationError(f"ranks of shape {ranks.shape}: must be (n, {len(self.names)}), n > 0")
        if ranks.min() < 0 or ranks.max() > self.ranked:
            raise CalibrationError(f"ranks {ranks.min()} to {ranks.max()}: must be in 0 to {self.ranked}")
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "ranks", ranks)

    @classmethod
    def of(cls, replicates: Sequence[Replicate], ranked: int) -> RankTest:
        """From finished replicates."""
        names = tuple(replicates[0].rank)
        ranks = np.array([[r.rank[name] for name in names] for r in replicates])
        return cls(names, ranks, ranked, tuple(replicates))

    @property
    def n(self) -> int:
        """Replicates."""
        return len(self.ranks)

    @property
    def points(self) -> Array:
        """Where the ECDFs are evaluated, (L,): the probabilities (k + 1)/(L + 1) of a rank of at most k."""
        return np.arange(1, self.ranked + 1) / (self.ranked + 1)

    def histogram(self, bins: int | None = None) -> NDArray[np.int64]:
        """Counts of ranks in equal bins, (bins, n_names).

        Parameters
        ----------
        bins : int, optional
            A divisor of L + 1; if absent the largest, up to 20, with at least five expected in each.

        Raises
        ------
        CalibrationError
            If `bins` does not divide L + 1.
        """
        total = self.ranked + 1
        if bins is None:
            fitting = [k for k in range(2, 21) if total % k == 0 and self.n / k >= 5]
            bins = max(fitting, default=1)
        if bins < 1 or total % bins:
            raise CalibrationError(f"bins = {bins}: must divide the {total} possible ranks")
        width = total // bins
        return np.stack([np.bincount(column // width, minlength=bins) for column in self.ranks.T], axis=1)

    def chi_square(self, bins: int | None = None) -> Array:
        """p-values of Pearson's test that the bins are equally likely, (n_names,)."""
        from scipy.stats import chisquare

        return np.asarray(chisquare(self.histogram(bins), axis=0).pvalue)

    def ecdf_difference(self) -> Array:
        """Share of ranks of at most k minus (k + 1)/(L + 1), k = 0, ..., L - 1, (L, n_names)."""
        return self._counts() / self.n - self.points[:, None]

    def _counts(self) -> NDArray[np.int64]:
        counts = np.stack([np.bincount(column, minlength=self.ranked + 1) for column in self.ranks.T], axis=1)
        return np.asarray(np.cumsum(counts, axis=0)[:-1])

    def band(self, prob: float = 0.95) -> tuple[Array, Array]:
        """Limits, (L,) each, that the ECDF difference keeps everywhere with probability `prob`.

        References
        ----------
        Säilynoja, Bürkner, Vehtari 2022, doi 10.1007/s11222-022-10090-6.
        """
        from arviz.stats.ecdf_utils import ecdf_confidence_band

        low, high = ecdf_confidence_band(self.n, self.points, self.points, prob=prob, method="optimized")
        return low - self.points, high - self.points

    def ecdf_p(self, trials: int = 4000, seed: int = 0) -> Array:
        """p-values of the simultaneous ECDF test, (n_names,), by simulation of uniform ranks.

        The statistic is gamma = 2 min_k min(P(X <= R_k), P(X >= R_k)), X ~ Binomial(n, (k + 1)/(L + 1)), R_k
        the ranks of at most k.

        Parameters
        ----------
        trials : int
            Simulated sets of ranks; 1/(trials + 1) is the smallest p-value.
        seed : int
            Of the simulation.

        References
        ----------
        Säilynoja, Bürkner, Vehtari 2022, doi 10.1007/s11222-022-10090-6.
        """
        total = self.ranked + 1
        rng = np.random.default_rng(seed)
        uniform = rng.multinomial(self.n, np.full(total, 1 / total), size=trials)
        null = np.sort(self._gamma(np.cumsum(uniform, axis=1)[:, :-1]))
        found = self._gamma(self._counts().T)
        return (1 + np.searchsorted(null, found * (1 + 1e-9), side="right")) / (trials + 1)

    def _gamma(self, counts: NDArray[np.int64]) -> Array:
        from scipy.stats import binom

        table = binom.cdf(np.arange(-1, self.n + 1)[:, None], self.n, self.points)  # P(X <= r), r from -1
        column = np.arange(self.ranked)
        below, above = table[counts + 1, column], 1 - table[counts, column]
        return np.asarray(2 * np.minimum(below, above).min(axis=1))

    def coverage(self, levels: Sequence[float] = LEVELS) -> pd.DataFrame:
        """How often central intervals hold the truth, with the range that chance allows.

        Returns
        -------
        DataFrame
            Columns parameter, level, expected (of the ranks that count as inside, near the level), share,
            error (binomial standard error), low, high (central 95 % of the binomial), within.
        """
        from scipy.stats import binom

        total = self.ranked + 1
        rows = []
        for level in levels:
            inside = np.abs((np.arange(total) + 0.5) / total - 0.5) <= level / 2 + 1e-12
            expected = float(inside.mean())
            low, high = (float(x) / self.n for x in binom.interval(0.95, self.n, expected))
            error = float(np.sqrt(expected * (1 - expected) / self.n))
            for name, column in zip(self.names, self.ranks.T, strict=True):
                share = float(inside[column].mean())
                rows.append((name, level, expected, share, error, low, high, low <= share <= high))
        columns = ["parameter", "level", "expected", "share", "error", "low", "high", "within"]
        return pd.DataFrame(rows, columns=columns)

    def narrowing(self) -> dict[str, float]:
        """Median posterior standard deviation over that of the truths; near 1 the data say nothing."""
        found = {}
        for name in self.replicates[0].sd if self.replicates else ():
            spread = float(np.std([r.truth[name] for r in self.replicates], ddof=1))
            found[name] = float(np.median([r.sd[name] for r in self.replicates])) / spread
        return found

    def table(self) -> pd.DataFrame:
        """One row for each quantity.

        Returns
        -------
        DataFrame
            Index parameter: chi2_p, ecdf_p, in_band (95 %), cover_50, cover_80, cover_95, narrowing.
        """
        low, high = self.band()
        difference = self.ecdf_difference()
        slack = 1e-9
        table = pd.DataFrame(
            {
                "chi2_p": self.chi_square(),
                "ecdf_p": self.ecdf_p(),
                "in_band": [bool(np.all((d >= low - slack) & (d <= high + slack))) for d in difference.T],
            },
            index=pd.Index(self.names, name="parameter"),
        )
        for level, rows in self.coverage().groupby("level"):
            table[f"cover_{100 * float(str(level)):.0f}"] = rows.set_index("parameter")["share"]
        table["narrowing"] = pd.Series(self.narrowing(), dtype=float)
        return table

    def passes(self, alpha: float = 0.01) -> bool:
        """Whether no ECDF test is below `alpha` divided by the number of quantities (Bonferroni)."""
        return bool(self.ecdf_p().min() >= alpha / len(self.names))
