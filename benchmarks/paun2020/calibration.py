"""Simulation-based calibration: does the posterior hold the truth as often as it says?

Parameters are drawn from the model's prior and data from the model at them; the truth's rank among draws of
the posterior is uniform if model, likelihood and sampler belong together (docs/calibration.md).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import minimize_scalar

from zoo import sample
from zoo.blood.ejection import PERIOD_S, ejection
from zoo.blood.prior_tables import PAPER_SET
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Blood, Series, Study, Vessel, Windkessel
from zoo.core.forward import SolveError
from zoo.core.inference.convergence import verdict
from zoo.core.inference.elements import arrays, scalars
from zoo.core.inference.logposterior import LogPosterior
from zoo.core.inference.workers import each
from zoo.core.model import record_of
from zoo.core.outputs import write_file
from zoo.core.parameters import draw_prior, unpack, variable_name
from zoo.core.surrogate.waveform import SurrogateError
from zoo.models import get_model

Array = NDArray[np.float64]
Builder = Callable[[Study], Any]

LEVELS = (0.5, 0.8, 0.95)
LOG_POSTERIOR = "log_posterior"
"""Name of the ranked quantity beside the parameters: the log-posterior density, which sees all of them."""
MOST_TRIES = 1000
SIGMA2 = {"log_uniform": [1e-3, 1.0]}
"""Prior of a variance here, mmHg2: InverseGamma(0.001, 0.001) has half of its mass above 1e300."""
EXACT: dict[str, Any] = {
    "method": "exact",
    "chains": 2,
    "tune": 400,
    "draws": 250,
    "thin": 4,
    "until_ess": 160,
    "max_draws": 3200,
}
SURROGATE = {"method": "surrogate", "chains": 4, "draws": 250, "until_ess": 160, "max_draws": 2000}
EFFECTS = ("viscoelastic-wall", "local-stiffness@2")
"""What the model "C+effects" has: is an effect's size in its intervals as often as they say?"""


class CalibrationError(ValueError):
    """A calibration that cannot start or go on; its text says why and what to change."""


def cheap_study(n_times: int = 32, sites: Sequence[tuple[int, float]] = ((1, 0.0),)) -> Study:
    """A trunk (vessel 1) with two branches (2, 3), our own inflow, and pressures of 0 mmHg, to be replaced.

    Parameters
    ----------
    n_times : int
        Samples in the beat of 0.11 s.
    sites : sequence of (vessel, position)
        Where pressure is observed.
    """
    time_s, flow_ml_s = ejection(64)
    vessels = (
        Vessel(1, "trunk", 0.40, 0.047, 0.045),
        Vessel(2, "left", 0.40, 0.034, 0.034, 1, Windkessel(3.3e4, 1.43e5, 5.9e-7)),
        Vessel(3, "right", 0.35, 0.037, 0.037, 1, Windkessel(2.7e4, 1.17e5, 7.2e-7)),
    )
    series = tuple(Series(vessel, x, "pressure_mmHg", np.zeros(n_times)) for vessel, x in sites)
    observed_s = np.arange(n_times) * PERIOD_S / n_times
    return Study(
        "cheap", PERIOD_S, Blood(1.055, 0.049), vessels, time_s, flow_ml_s, observed_s, series,
        priors={"set": PAPER_SET},
    )  # fmt: skip


def cheap_options(wall: str = "linear") -> SolverOptions:
    """Coarse settings for `cheap_study`: two cells a vessel, and a fixed time step.

    The number of steps is fixed because one that followed the parameters would make the waves jump by more
    than the Gaussian process' noise of 0.0019 mmHg.

    Parameters
    ----------
    wall : {"linear", "tangent"}
    """
    return SolverOptions(
        dx_cm=0.2, steps_per_beat={"linear": 256, "tangent": 1024}[wall], tolerance_mmHg=1e-4
    )


@dataclass(frozen=True)
class Calibration:
    """What is calibrated, and how.

    Parameters
    ----------
    builder : callable
        ``builder(study) -> pm.Model``; for other processes it is importable by name, such as a
        `functools.partial` of a model of `zoo.models`.
    study : Study
        Network, inflow, times and places of the observations; the observed values are not used.
    seed : int
        Replicate k depends on `seed` and k only.
    ranked : int
        L, draws that the truth is ranked among: evenly spaced over all chains.
    settings : mapping
        Of `zoo.sample`.
    truth : callable, optional
        Builder of the model that parameters and data are drawn from, if it is not the one that is fitted: a
        control that must fail. It needs the same parameters.
    """

    builder: Builder
    study: Study
    seed: int = 1
    ranked: int = 79
    settings: Mapping[str, Any] = field(default_factory=lambda: EXACT)
    truth: Builder | None = None

    @property
    def text(self) -> str:
        """What replicates of one calibration share, in words."""
        of = f"{_name(self.builder)} on data of {_name(self.truth or self.builder)}"
        return f"{of}, {self.study.checksum}, seed {self.seed}, {self.ranked} draws, {dict(self.settings)}"


def _name(builder: Builder) -> str:
    inner = getattr(builder, "func", builder)
    extra = sorted(getattr(builder, "keywords", {}).items())
    return f"{inner.__module__}.{inner.__qualname__}" + "".join(
        f", {name}={value!r}" for name, value in extra
    )


class Replicate(NamedTuple):
    """One truth, its ranks, and how its posterior was sampled.

    `truth` and `sd` (of the ranked draws) are in the parameters' own units; `rank` is the number of the
    ranked draws below the truth; `correction` is that of a surrogate's draws.
    """

    truth: dict[str, float]
    rank: dict[str, int]
    sd: dict[str, float]
    ess: float
    rhat: float
    correction: str


def simulate_and_rank(
    asked: Calibration,
    n: int,
    folder: Path | None = None,
    *,
    cores: int = 1,
    executor: Executor | None = None,
) -> list[Replicate]:
    """Rank many truths from the prior among draws of their posteriors.

    Parameters
    ----------
    asked : Calibration
    n : int
        Truths.
    folder : Path, optional
        Keeps each finished replicate in a file, which is not done again.
    cores : int
        Processes; 1 works in this one.
    executor : concurrent.futures.Executor, optional
        Does the replicates instead, as in `zoo.core.inference.workers.each`.

    Raises
    ------
    CalibrationError
        If the folder holds replicates of another calibration.

    References
    ----------
    Talts et al. 2018, arXiv:1804.06788.
    """
    found: dict[int, Replicate] = {}
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        found = {k: _read(file, asked) for k in range(n) if (file := folder / f"{k:04d}.json").is_file()}
    jobs = [(asked, k) for k in range(n) if k not in found]
    for (_, k), made in each(
        replicate, jobs, cores, executor=executor, name=lambda job: f"replicate {job[1]}"
    ):
        found[k] = made
        if folder is not None:
            write_file(folder / f"{k:04d}.json", json.dumps({"of": asked.text} | made._asdict(), indent=1))
    return [found[k] for k in range(n)]


def _read(file: Path, asked: Calibration) -> Replicate:
    stored = json.loads(file.read_text(encoding="utf-8"))
    if stored.pop("of") != asked.text:
        raise CalibrationError(f"{file}: a replicate of another calibration; choose another folder")
    return Replicate(**stored)


def replicate(job: tuple[Calibration, int]) -> Replicate:
    """Replicate k of a calibration: simulate, sample from the truth on, rank.

    Where there is no surrogate the forward model itself is sampled, lest truths are chosen among.
    """
    asked, number = job
    rng = np.random.default_rng([asked.seed, number])
    study, truth = drawn(asked.truth or asked.builder, asked.study, rng)
    model = asked.builder(study)
    common = {"seed": int(rng.integers(2**31)), "cores": 0, "progress": False, "start": truth}
    try:
        idata, correction = sample(model, **common, **asked.settings), ""
    except SurrogateError as error:
        idata, correction = sample(model, **common, **EXACT), f"exact chains: {error}"
    draws = {name: values.reshape(-1, *values.shape[2:]) for name, values in arrays(idata).items()}
    total = len(next(iter(draws.values())))
    kept = np.linspace(0, total - 1, asked.ranked).round().astype(int)
    names = [rv.name for rv in model.free_RVs]
    every = {name: np.concatenate([[truth[name]], draws[name][kept]]) for name in names}
    logp = LogPosterior(model)
    every[LOG_POSTERIOR] = np.array([logp(q) for q in logp.from_draws({name: every[name] for name in names})])
    columns = {name: column[0] for name, column in scalars({n: column[None] for n, column in every.items()})}
    judged = verdict(idata)
    return Replicate(
        truth={name: float(column[0]) for name, column in columns.items() if name != LOG_POSTERIOR},
        rank={name: int(np.sum(column[1:] < column[0])) for name, column in columns.items()},
        sd={name: float(column[1:].std(ddof=1)) for name, column in columns.items() if name != LOG_POSTERIOR},
        ess=float(judged.min_ess),
        rhat=float(judged.max_rhat),
        correction=correction,
    )


def drawn(builder: Builder, study: Study, rng: np.random.Generator) -> tuple[Study, dict[str, Array]]:
    """A study with data of a model at parameters from its prior, and these by variable.

    Parameters whose solve fails are drawn again. The posterior is zero there too, so prior and posterior are
    conditioned alike and ranks stay uniform.

    Raises
    ------
    CalibrationError
        If no parameters of many can be solved.
    """
    record = record_of(builder(study))
    forward, errors = record.forward, record.errors
    for _ in range(MOST_TRIES):
        values = unpack(forward.parameters, theta := draw_prior(forward.parameters, rng))
        values |= unpack(errors.parameters, draw_prior(errors.parameters, rng))
        try:
            mean = forward.solve(forward.configure(theta))
        except SolveError:
            continue
        data = mean + errors.draw(rng, values)
        series = tuple(replace(one, value=row) for one, row in zip(study.series, data, strict=True))
        return replace(study, series=series), {variable_name(n): np.asarray(v) for n, v in values.items()}
    raise CalibrationError(
        f"{_name(builder)}: none of {MOST_TRIES} draws of the prior solves; narrow its priors"
    )


def ranks_of(replicates: Sequence[Replicate]) -> pd.DataFrame:
    """Ranks, a row for each replicate and a column for each quantity."""
    return pd.DataFrame([one.rank for one in replicates])


def confidence_band(n: int, points: Array, prob: float) -> tuple[Array, Array]:
    """Least and largest share of n uniform numbers below each point: a band that holds all with `prob`.

    It has the same probability at each point, chosen for all of them together: the number below a point is
    binomial given that below the last one.
    """
    before = np.concatenate([[0.0], points[:-1]])

    def misses(at_each: float) -> float:
        low, high = np.asarray(stats.binom.interval(at_each, n, points), dtype=int)
        counts, inside = np.zeros(1, dtype=int), np.ones(1)
        for a, b, part in zip(low, high, (points - before) / (1 - before), strict=True):
            now = np.arange(a, b + 1)
            inside = inside @ stats.binom.pmf(now, n - counts[:, None], part, loc=counts[:, None])
            counts = now
        return abs(float(inside.sum()) - prob)

    at_each = minimize_scalar(misses, bounds=(prob, 1), method="bounded").x
    low, high = stats.binom.interval(at_each, n, points)
    return low / n, high / n


def uniform(ranks: pd.DataFrame, ranked: int, prob: float = 0.95) -> pd.Series:
    """Whether the ECDF of each column is in the band where that of uniform ranks is with probability `prob`.

    References
    ----------
    Säilynoja, Bürkner, Vehtari 2022, doi 10.1007/s11222-022-10090-6.
    """
    n = len(ranks)
    low, high = confidence_band(n, np.arange(1, ranked + 1) / (ranked + 1), prob)
    inside = {}
    for name, column in ranks.items():
        share = np.searchsorted(np.sort(column), np.arange(ranked), side="right") / n
        inside[name] = bool(np.all((share >= low - 1e-9) & (share <= high + 1e-9)))
    return pd.Series(inside)


def passes(ranks: pd.DataFrame, ranked: int) -> bool:
    """Whether all columns are uniform at level 0.01, divided by their number (Bonferroni)."""
    return bool(uniform(ranks, ranked, 1 - 0.01 / ranks.shape[1]).all())


def rank_table(replicates: Sequence[Replicate], ranked: int) -> pd.DataFrame:
    """One row for each quantity.

    Returns
    -------
    DataFrame
        Index parameter: in_band, of `uniform`; cover_50, cover_80 and cover_95, shares of central intervals
        that hold the truth; narrowing, median posterior standard deviation over that of the truths.
    """
    ranks = ranks_of(replicates)
    shares = ((ranks + 0.5) / (ranked + 1) - 0.5).abs()
    table = pd.DataFrame({"in_band": uniform(ranks, ranked)})
    for level in LEVELS:
        table[f"cover_{100 * level:.0f}"] = (shares <= level / 2 + 1e-12).mean()
    sd, truth = (pd.DataFrame([getattr(one, name) for one in replicates]) for name in ("sd", "truth"))
    return table.assign(narrowing=sd.median() / truth.std()).rename_axis("parameter")


def calibrated_model(name: str) -> tuple[Builder, Study]:
    """A model of the paper, or "C+effects", on the cheap study."""
    letter, _, added = name.partition("+")
    more: dict[str, Any] = {"options": cheap_options("tangent" if letter in "HI" or added else "linear")}
    study = cheap_study(64, ((1, 0.0), (2, 0.5), (3, 0.5))) if added else cheap_study()
    if letter in "ADF":
        study = replace(study, priors={**study.priors, "sigma2": SIGMA2})
    if added:
        more["effects"] = EFFECTS
    return partial(get_model(letter), **more), study


def calibrate(
    name: str, n: int, folder: Path, *, surrogate: bool, seed: int, cores: int, executor: Executor | None
) -> str:
    """Calibrate one model, and return what docs/calibration.md quotes."""
    builder, study = calibrated_model(name)
    asked = Calibration(builder, study, seed, settings=SURROGATE if surrogate else EXACT)
    stem = f"{name}{'-surrogate' if surrogate else ''}-{seed}"
    replicates = simulate_and_rank(asked, n, folder / stem, cores=cores, executor=executor)
    worst = min(one.ess for one in replicates), max(one.rhat for one in replicates)
    exact = sum(bool(one.correction) for one in replicates)
    return "\n".join(
        [
            f"model {name}: {n} replicates, {asked.ranked + 1} possible ranks",
            rank_table(replicates, asked.ranked).to_string(float_format=lambda x: f"{x:.3f}"),
            "least ESS {:.0f}, largest R-hat {:.3f}; ".format(*worst) + f"without a surrogate: {exact}",
            "passes" if passes(ranks_of(replicates), asked.ranked) else "FAILS",
        ]
    )
