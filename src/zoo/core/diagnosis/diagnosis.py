"""What a base model misses: where the gap lies, which effect causes it, how far it shrinks, what is left."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from zoo.blood.conventions import Conventions
from zoo.blood.effects import CATALOGUE, Place, effects_for, get_base
from zoo.blood.study import Study
from zoo.core.diagnosis.discrepancy import smooth_part
from zoo.core.diagnosis.screening import (
    CORRELATED,
    DOUBT,
    NO_GAP,
    UNLISTED,
    Fit,
    Scored,
    Screened,
    Screening,
    Search,
    SearchError,
    score,
)
from zoo.core.inference.record import versions

if TYPE_CHECKING:
    from zoo.core.diagnosis.confirm import Confirmation

Array = NDArray[np.float64]

FORMAT = 1
UNITS = {"pressure_mmHg": "mmHg", "flow_ml_s": "ml/s", "area_cm2": "cm2"}
PHASES = ("upstroke", "peak", "late-systole", "incisura", "diastole")
MAX_HARMONIC = 10
HELD_OUT_BLOCKS = 5
DRAWS = 400
PEAK_BEATS = 0.03
"""Half the width of the peak and of the incisura, in beats."""
POOR_FIT = 0.2
"""Gap over the data's range above which input is suspected: four prior sds of a free discrepancy."""
LITTLE = 0.5
"""Part of the gap that an explanation should remove at least, lest a warning is given."""
FLOW_NOISE = 0.02
"""Noise of a flow measurement that is only planned, as a part of its peak."""


class DiagnosisError(ValueError):
    """A diagnosis that cannot be made or read; its text says why and what to change."""


# ---------------------------------------------------------------------------------------------------
# diagnosis.json


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Interval(_Part):
    """An estimate with its 95 % interval."""

    mean: float
    low: float
    high: float


class SeriesGap(_Part):
    """The gap in one observed series."""

    series: str
    unit: str
    before: Interval
    after: Interval
    noise_floor: float
    residual_rms_before: float
    residual_rms_after: float


class Gap(_Part):
    """The gap of the base model in mmHg over all pressures; without pressures in ml/s over the flows."""

    before_mmHg: float
    before_interval_mmHg: tuple[float, float]
    noise_floor_mmHg: float
    after_mmHg: float
    after_interval_mmHg: tuple[float, float]
    residual_rms_before_mmHg: float
    residual_rms_after_mmHg: float
    removed: float
    removed_interval: tuple[float, float]
    held_out_before_mmHg: float | None
    held_out_after_mmHg: float | None
    held_out_removed: float | None
    held_out: str
    per_series: list[SeriesGap]


class PlaceShare(_Part):
    """Probability of a place; vessel null stands for everywhere alike."""

    vessel: int | None
    subtree: bool
    probability: float


class Where(_Part):
    """Shares of the gap's energy, and the place."""

    series: dict[str, float]
    phase: dict[str, float]
    harmonic: dict[str, float]
    place: list[PlaceShare]


class AmplitudeEstimate(_Part):
    """An effect's size."""

    name: str
    mean: float
    sd: float
    unit: str


class HypothesisResult(_Part):
    """One explanation of the data."""

    name: str
    place: int | None
    subtree: bool = False
    probability: float
    group: int
    log_evidence: float
    amplitude: AmplitudeEstimate | None
    other_amplitudes: list[AmplitudeEstimate] = []
    gap_after_mmHg: float
    gap_after_interval_mmHg: tuple[float, float]
    residual_rms_mmHg: float
    shift_of_base: dict[str, float] = {}
    places: list[PlaceShare] = []


class NextMeasurement(_Part):
    """The measurement that would best tell the leading explanations apart."""

    vessel: int
    position: float
    quantity: str
    separates: tuple[str, str]
    expected_log_odds: float


class Step(_Part):
    """An effect that was added, and what it left."""

    name: str
    place: int | None
    subtree: bool
    probability: float
    amplitudes: list[AmplitudeEstimate] = []
    gap_before_mmHg: float
    gap_after_mmHg: float


class DiagnosisFile(_Part):
    """Content of diagnosis.json; documented in docs/diagnosis.md."""

    format: Literal[1] = 1
    study: str
    study_checksum: str
    base: str
    gap: Gap
    where: Where
    cause: list[str]
    verdict: str
    warnings: list[str] = []
    hypotheses: list[HypothesisResult]
    steps: list[Step]
    invisible: list[str]
    failed: list[str]
    next_measurement: NextMeasurement | None
    base_parameters: dict[str, dict[str, float]]
    confirmation: dict[str, Any] | None
    record: dict[str, Any]


def read_diagnosis(path: str | Path) -> DiagnosisFile:
    """Read a diagnosis.json back.

    Parameters
    ----------
    path : path
        The file, or the folder that holds it.

    Returns
    -------
    DiagnosisFile

    Raises
    ------
    DiagnosisError
        If it is missing, not JSON, or a field is wrong.
    """
    path = Path(path)
    path = path / "diagnosis.json" if path.is_dir() else path
    try:
        return DiagnosisFile.model_validate_json(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DiagnosisError(
            f"{path}: cannot be read ({error.strerror}); give a file of `zoo diagnose`"
        ) from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(x) for x in first["loc"]) or "the file"
        raise DiagnosisError(
            f"{path}: {where}: {first['msg']}; make it again with `zoo diagnose` or `zoo blind run`"
        ) from None


# ---------------------------------------------------------------------------------------------------
# phases of the beat


def phases(wave: Array, period_s: float) -> NDArray[np.int_]:
    """Phase of the beat of each sample, an index of `PHASES`, found from the waveform.

    The foot is the least value before the steepest rise, the peak the largest value, the incisura the
    sharpest upward bend (largest second difference of the smoothed wave) after it within 0.45 beats.

    Parameters
    ----------
    wave : array (n,)
        One periodic series.
    period_s : float
        s; only the order of the samples counts.

    Returns
    -------
    int array (n,)
    """
    n = len(wave)
    c = np.fft.rfft(wave)
    k = np.arange(len(c))
    smooth = np.fft.irfft(c * np.exp(-0.5 * (k / 12.0) ** 2), n=n)
    slope = np.roll(smooth, -1) - np.roll(smooth, 1)
    steepest = int(np.argmax(slope))
    back = [(steepest - i) % n for i in range(n // 2)]
    foot = back[int(np.argmin(smooth[back]))]
    ahead = [(foot + i) % n for i in range(n)]
    peak_after = int(np.argmax(smooth[ahead[: int(0.6 * n)]]))
    bend = np.roll(smooth, -1) - 2.0 * smooth + np.roll(smooth, 1)
    half = max(1, round(PEAK_BEATS * n))
    first, last = peak_after + 2 * half, min(n - half, peak_after + int(0.45 * n))
    incisura_after = first + int(np.argmax(bend[[ahead[i] for i in range(first, last)]]))
    found = np.empty(n, int)
    for i, at in enumerate(ahead):
        if abs(i - peak_after) <= half:
            phase = 1
        elif i < peak_after:
            phase = 0
        elif abs(i - incisura_after) <= half:
            phase = 3
        else:
            phase = 2 if i < incisura_after else 4
        found[at] = phase
    return found


# ---------------------------------------------------------------------------------------------------
# the diagnosis


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """The discrepancy of a fit, with bands; series in their own units."""

    mean: Array  # (n_series, n_times)
    sd: Array
    rms: Array  # (n_draws, n_series)
    lasting: Array  # (n_draws, n_series), rms of what a fit to data without noise would leave
    residual: Array  # (n_series, n_times)

    def pooled(self, rows: list[int]) -> Array:
        """Rms over some series together, (n_draws,)."""
        return _over(self.rms, rows)

    def interval(self, rows: list[int]) -> Interval:
        """Of that rms; from what a fit to data without noise would leave to what this fit leaves."""
        return _interval(self.pooled(rows), _over(self.lasting, rows))

    def removed(self, rows: list[int], before: Discrepancy) -> Interval:
        """Part of the gap that this fit takes away; its interval holds both meanings of what is left."""
        gap = np.maximum(before.pooled(rows), 1e-12)
        low, high = (1.0 - _over(x, rows) / gap for x in (self.rms, self.lasting))
        return Interval(
            mean=float(low.mean()), low=float(np.quantile(low, 0.025)), high=float(np.quantile(high, 0.975))
        )


def _over(rms: Array, rows: list[int]) -> Array:
    return np.asarray(np.sqrt(np.mean(rms[:, rows] ** 2, axis=1)))


def discrepancy(screened: Screened, fit: Fit, seed: int = 0, *, known_noise: bool = False) -> Discrepancy:
    """Posterior of the truth minus the fitted waveforms: what is smooth in the residual beside the noise, and
    the error of the fitted parameters, which does not show there.

    Parameters
    ----------
    screened : Screened
    fit : Fit
    seed : int
        Of the draws that give its size an interval.
    known_noise : bool
        Take the noise as fitted, which is faster.

    Returns
    -------
    Discrepancy
    """
    screening = screened.screening
    H = screening.harmonics
    rng = np.random.default_rng(seed)
    noise = {q: [(0.0, e)] for q, e in screened.noise.items()} if known_noise else screened.possible_noise
    found = screening.unexplained(fit, noise, rng, DRAWS)
    waves = H.back(found.draws)
    rms, lasting = (np.sqrt(np.mean(x**2, axis=2)) for x in (waves, H.back(found.lasting)))
    return Discrepancy(H.back(found.mean), waves.std(axis=0), rms, lasting, H.back(fit.residual))


def _rows(study: Study) -> tuple[list[int], str]:
    """Series that a gap in mmHg is about, and their unit: the pressures, or all of the first quantity."""
    quantity = (
        "pressure_mmHg"
        if any(s.quantity == "pressure_mmHg" for s in study.series)
        else study.series[0].quantity
    )
    return [i for i, s in enumerate(study.series) if s.quantity == quantity], UNITS[quantity]


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _interval(draws: Array, least: Array) -> Interval:
    low, high = np.quantile(least, 0.025), np.quantile(draws, 0.975)
    return Interval(mean=float(np.mean(draws)), low=float(low), high=float(high))


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Rms (in the unit of the gap) of residuals in data that were not fitted, and what was held out."""

    before: float
    after: float
    what: str

    @property
    def removed(self) -> float:
        """Part of the gap that is gone there."""
        return 1.0 - self.after / self.before if self.before > 0 else 0.0


def hold_out(scored: Scored, fit: Fit) -> HeldOut | None:
    """Gap before and after in data that a refit does not see: each series in turn, or blocks of the beat.

    Parameters
    ----------
    scored : Scored
    fit : Fit
        The hypothesis with its effect.

    Returns
    -------
    HeldOut or None
        Rms of smooth residuals, sqrt(max(0, rms^2 - noise^2)); None where a refit fails.
    """
    screening, base = scored.screened.screening, scored.screened.base
    study = screening.study
    rows, _ = _rows(study)
    n = len(study.time_s)
    if len(rows) > 1:
        folds = [np.repeat(np.arange(len(study.series))[:, None] == i, n, axis=1) for i in rows]
        what = "each series in turn"
    else:
        block = np.arange(n) * HELD_OUT_BLOCKS // n
        folds = [
            np.tile(block == b, (len(study.series), 1)) & (np.arange(len(study.series)) == rows[0])[:, None]
            for b in range(HELD_OUT_BLOCKS)
        ]
        what = f"{HELD_OUT_BLOCKS} blocks of the beat in turn"
    noise = np.array([scored.screened.noise[s.quantity].noise for s in study.series])[:, None]
    sums = {0: [0.0, 0], 1: [0.0, 0]}
    for out in folds:
        for which, start in enumerate((base, fit)):
            found = _refit(screening, start, ~out, noise)
            if found is None:
                return None
            left = (study.values - found)[out]
            sums[which][0] += float(np.sum(left**2 - (noise * np.ones_like(study.values))[out] ** 2))
            sums[which][1] += left.size
    before, after = (math.sqrt(max(0.0, total / count)) for total, count in sums.values())
    return HeldOut(before, after, what)


class _Kept:
    """Stands in for a hypothesis' harmonics: the samples that are fitted."""

    def __init__(self, forward: Any, kept: NDArray[np.bool_]) -> None:
        self.forward, self.kept = forward, kept
        self.low, self.high, self.units = forward.low, forward.high, forward.units
        self.parameters, self.prior = forward.parameters, forward.prior
        self.last_failure = ""
        self.all: dict[bytes, Array] = {}

    def __call__(self, u: Array) -> Array | None:
        waves = self.forward.waves(u)
        if waves is None:
            self.last_failure = self.forward.last_failure
            return None
        self.all[u.tobytes()] = waves
        return np.asarray(waves[self.kept])


def _refit(screening: Screening, start: Fit, kept: NDArray[np.bool_], noise: Array) -> Array | None:
    """All series as computed by a hypothesis that was fitted to the kept samples only."""
    forward = _Kept(start.forward, kept)
    S = (noise * np.ones(kept.shape))[kept] ** 2
    search = Search(forward, screening.study.values[kept], S)  # type: ignore[arg-type]
    jacobian = screening.harmonics.back(start.jacobian.T)[:, kept].T
    try:
        point = search.at(start.u, jacobian)
    except SearchError:
        return None
    point = search.descend(point, 8)
    return forward.all[point.u.tobytes()]


def next_measurement(scored: Scored) -> NextMeasurement | None:
    """Where the leading explanation and its nearest rival, as fitted, differ most beside the noise.

    Rivals are the other members of the leader's group, or what else is not improbable; without any, None.

    Expected log odds: half the squared difference of their series over the variance of the noise. Pressures
    are taken to have the noise of the observed ones, flows one of 2 % of their peak. That the base parameters
    would move again is not counted, so it is an upper estimate.
    """
    screened = scored.screened
    first = scored.leader
    if first not in scored.places:
        return None
    rivals = [n for n in scored.members(first)[1:] if n in scored.places]
    rivals += [n for n in scored.names if n in scored.places and scored.probability[n] > DOUBT and n != first]
    if not rivals:
        return None
    second = rivals[0]
    study = screened.screening.study
    seen = {(s.vessel, s.position, s.quantity) for s in study.series}
    candidates = [
        (int(v), 0.5, q) for v in screened.screening.network.ids for q in ("pressure_mmHg", "flow_ml_s")
    ]
    candidates = [c for c in candidates if c not in seen]
    waves = [scored.best[n].forward.waves(scored.best[n].u, candidates) for n in (first, second)]
    if waves[0] is None or waves[1] is None:
        return None
    pressure = screened.noise.get("pressure_mmHg")
    spread = np.ptp(study.values, axis=1).max()
    noises = np.array(
        [
            (pressure.noise if pressure else 0.01 * spread)
            if q == "pressure_mmHg"
            else FLOW_NOISE * float(np.abs(w).max())
            for (_, _, q), w in zip(candidates, waves[0], strict=True)
        ]
    )
    gain = 0.5 * np.sum((waves[0] - waves[1]) ** 2, axis=1) / noises**2
    i = int(np.argmax(gain))
    vessel, position, quantity = candidates[i]
    return NextMeasurement(
        vessel=vessel,
        position=position,
        quantity=quantity,
        separates=(first, second),
        expected_log_odds=float(gain[i]),
    )


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What `diagnose` found; `file` is the content of diagnosis.json.

    Attributes
    ----------
    study : Study
    file : DiagnosisFile
    rounds : tuple of Scored
        One for each effect that was added, the last one finding no more.
    before, after : Discrepancy
        What the base leaves, and what the base with its causes leaves.
    computed : tuple of array (n_series, n_times)
        Series of the base and of the base with its causes.
    confirmation : Confirmation or None
    """

    plotter: ClassVar[Callable[[Diagnosis], Any] | None] = None
    """Draws a diagnosis; figures are not of this package."""

    study: Study
    file: DiagnosisFile
    rounds: tuple[Scored, ...] = field(repr=False)
    before: Discrepancy = field(repr=False)
    after: Discrepancy = field(repr=False)
    computed: tuple[Array, Array] = field(repr=False)
    confirmation: Confirmation | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        return f"<Diagnosis of {self.study.name!r}, base {self.file.base}: {self.file.verdict}>"

    @property
    def where(self) -> Where:
        """Shares of the gap by series, phase, harmonic and place."""
        return self.file.where

    @property
    def cause(self) -> list[str]:
        """The leading explanation, with all that this study cannot tell from it."""
        return self.file.cause

    @property
    def shrinkage(self) -> float:
        """Part of the gap that the cause removes."""
        return self.file.gap.removed

    @property
    def hypotheses(self) -> list[HypothesisResult]:
        """All explanations, most probable first."""
        return self.file.hypotheses

    def plot(self) -> Any:
        """Discrepancy, hypotheses and locations on one page, by the `plotter` that `zoo.front` sets."""
        if Diagnosis.plotter is None:
            raise DiagnosisError("no figures here: call zoo.plots.plot_diagnosis(d)")
        return Diagnosis.plotter(self)

    def confirmed(
        self,
        *,
        cores: int = 2,
        seed: int = 1,
        folder: str | Path | None = None,
        tick: Callable[[str, float], None] | None = None,
    ) -> Diagnosis:
        """Sample the posteriors of the base and the leading explanations in PyMC, and compare them.

        Parameters
        ----------
        cores, seed : int
        folder : path, optional
            Where posteriors and checkpoints are stored; a killed run goes on there.
        tick : callable, optional
            Called with a text and the share done.

        Returns
        -------
        Diagnosis
            With `confirmation`, and its summary in `file`.
        """
        from zoo.core.diagnosis.confirm import confirm

        began = time.monotonic()
        found = confirm(self.rounds[0], cores=cores, seed=seed, folder=folder, tick=tick)
        record = self.file.record | {"posterior_seconds": time.monotonic() - began}
        content = self.file.model_copy(update={"confirmation": found.summary(), "record": record})
        return replace(self, file=content, confirmation=found)

    def save(self, folder: str | Path) -> Path:
        """Write diagnosis.json into a folder; returns its path."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "diagnosis.json"
        path.write_text(
            json.dumps(json.loads(self.file.model_dump_json()), indent=1) + "\n", encoding="utf-8"
        )
        return path


def _place_posterior(scored: Scored) -> list[PlaceShare]:
    """Everywhere alike, or a vessel; what is missing to 1 is the probability of no listed effect."""
    shares: dict[Place, float] = {}
    for name, places in scored.places.items():
        for place, weight in places:
            shares[place] = shares.get(place, 0.0) + weight * scored.probability[name]
    found = [
        PlaceShare(vessel=p.vessel, subtree=p.subtree, probability=w)
        for p, w in sorted(shares.items(), key=lambda x: -x[1])
    ]
    return [p for p in found if p.probability >= 0.001]


def _where(scored: Scored, d: Discrepancy) -> Where:
    study = scored.screened.screening.study
    rows, _ = _rows(study)
    labels = [s.label for s in study.series]
    energy = d.mean**2
    total = float(energy[rows].sum()) or 1.0
    phase = phases(study.values[rows[0]], study.period_s)
    by_phase = {p: float(energy[rows][:, phase == i].sum()) / total for i, p in enumerate(PHASES)}
    power = np.abs(np.fft.rfft(d.mean[rows], axis=1)) ** 2
    power[:, 1:] *= 2.0
    if len(study.time_s) % 2 == 0:
        power[:, -1] *= 0.5
    power = power.sum(axis=0) / (float(power.sum()) or 1.0)
    by_harmonic = {str(k): float(power[k]) for k in range(min(MAX_HARMONIC + 1, len(power)))}
    by_harmonic[f"above {MAX_HARMONIC}"] = float(power[MAX_HARMONIC + 1 :].sum())
    by_series = {labels[i]: float(energy[i].sum()) / total for i in rows}
    return Where(series=by_series, phase=by_phase, harmonic=by_harmonic, place=_place_posterior(scored))


def _amplitudes(fit: Fit) -> list[AmplitudeEstimate]:
    found = []
    for i, a in enumerate(CATALOGUE[fit.hypothesis.name].amplitudes):
        mean, sd = fit.amplitude(i)
        found.append(AmplitudeEstimate(name=a.name, mean=mean, sd=sd, unit=a.unit))
    return found


def _free_amplitudes(fit: Fit) -> list[AmplitudeEstimate]:
    found = []
    for q, e in fit.errors.items():
        found.append(AmplitudeEstimate(name=f"sd of {q}", mean=e.delta, sd=0.0, unit=UNITS[q]))
        found.append(AmplitudeEstimate(name=f"length scale of {q}", mean=e.length, sd=0.0, unit="s"))
    return found


def _results(scored: Scored, seed: int, known: Mapping[str, Discrepancy]) -> list[HypothesisResult]:
    screened = scored.screened
    study = screened.screening.study
    rows, _ = _rows(study)
    found = []
    for name in scored.names:
        fit = scored.best[name]
        if name in (UNLISTED, CORRELATED):
            mean, _ = smooth_part(screened.screening.harmonics, fit.residual, fit.errors)
            noise_left = screened.screening.harmonics.back(fit.residual - mean)
            after = np.array([0.0, 0.0, 0.0])
            rms = _rms(noise_left[rows])
        else:
            improbable = scored.probability[name] < DOUBT
            d = known.get(name) or discrepancy(screened, fit, seed, known_noise=improbable)
            size = d.interval(rows)
            after = np.array([size.mean, size.low, size.high])
            rms = _rms(d.residual[rows])
        listed = name in scored.places
        amplitudes = [] if name == NO_GAP else _amplitudes(fit) if listed else _free_amplitudes(fit)
        shift = {}
        if listed:
            base = screened.base
            for i, p in enumerate(fit.forward.base.parameters):
                shift[p.name] = float(fit.forward.values(fit.u)[i] - base.values[i])
        places = scored.places.get(name, [])
        found.append(
            HypothesisResult(
                name=name,
                place=fit.hypothesis.place.vessel if listed else None,
                subtree=fit.hypothesis.place.subtree if listed else False,
                probability=scored.probability[name],
                group=scored.group[name],
                log_evidence=scored.log_z[name],
                amplitude=amplitudes[0] if amplitudes else None,
                other_amplitudes=amplitudes[1:],
                gap_after_mmHg=float(after[0]),
                gap_after_interval_mmHg=(float(after[1]), float(after[2])),
                residual_rms_mmHg=rms,
                shift_of_base=shift,
                places=[
                    PlaceShare(vessel=p.vessel, subtree=p.subtree, probability=w)
                    for p, w in places
                    if w >= 0.001 and len(places) > 1
                ],
            )
        )
    return found


def _verdict(scored: Scored, gap: Gap) -> str:
    _, unit = _rows(scored.screened.screening.study)
    leader, p = scored.leader, scored.probability[scored.leader]
    if leader == NO_GAP:
        return f"no gap: noise of {gap.noise_floor_mmHg:.3g} {unit} explains what the base leaves ({p:.0%})"
    if leader in (UNLISTED, CORRELATED):
        text = "none of the listed effects" if leader == UNLISTED else "correlated noise"
        twin = [n for n in scored.members(leader) if n != leader]
        return f"{text} ({p:.0%}): a smooth discrepancy of {gap.before_mmHg:.2g} {unit}" + (
            f"; this study cannot tell it from {' or '.join(twin)}" if twin else ""
        )
    members = scored.members(leader)
    twins = f", which this study cannot tell from {', '.join(members[1:])}" if len(members) > 1 else ""
    fit = scored.best[leader]
    at = fit.hypothesis.place
    where = f" in vessel {at.vessel}" + (" and below" if at.subtree else "") if at.vessel is not None else ""
    total = sum(scored.probability[m] for m in members)
    return (
        f"{leader}{where} ({total:.0%}{' with its group' if twins else ''}){twins}: "
        f"the gap of {gap.before_mmHg:.2g} {unit} shrinks to {gap.after_mmHg:.2g} {unit}"
    )


def _warnings(study: Study, gap: Gap, scored: Scored) -> list[str]:
    """What should be looked at before the answer is believed."""
    rows, unit = _rows(study)
    found = []
    spread = float(max(np.ptp(study.values[i]) for i in rows))
    if gap.before_mmHg > POOR_FIT * spread:
        found.append(
            f"the base misses the data by {gap.before_mmHg:.2g} {unit}, {gap.before_mmHg / spread:.0%} of "
            "their range, more than any effect of the catalogue should: check the units in observations.csv, "
            "the inflow and the conventions"
        )
    leader = scored.leader
    if leader not in scored.places:
        return found
    if gap.removed < LITTLE:
        found.append(
            f"{leader} explains the data best of what is listed, but only {max(gap.removed, 0.0):.0%} of the "
            "gap goes with it: most has another cause"
        )
    fit = scored.best[leader]
    for i in range(fit.forward.asked, len(fit.u)):
        p = fit.forward.parameters[i]
        for name, bound in (("lower", p.low), ("upper", p.high)):
            zero = bound == 0.0  # the base itself
            if not zero and abs(fit.values[i] - bound) < 1e-3 * (p.high - p.low):
                found.append(
                    f"{p.name} of {leader} stands at the {name} bound of its prior, {bound:g} {p.unit}: "
                    "the data ask for more than the catalogue allows"
                )
    return found


def _stronger(scored: Scored, exhaust: bool) -> tuple[str, Place] | None:
    """The effect to add before looking further, or None."""
    leader = scored.leader
    if exhaust and leader in (UNLISTED, CORRELATED):
        leader = next((n for n in scored.names if n in scored.places and n not in scored.invisible), leader)
    if leader not in scored.places:
        return None
    return leader, scored.best[leader].hypothesis.place


def diagnose(
    study: Study,
    base: str = "linear-constant",
    *,
    confirm: bool = False,
    max_effects: int = 3,
    exhaust: bool = False,
    effects: Sequence[str] | None = None,
    conventions: Conventions | None = None,
    cores: int = 2,
    seed: int = 1,
    tick: Callable[[str, float], None] | None = None,
    folder: str | Path | None = None,
) -> Diagnosis:
    """Find where a base model misses a study's data, which unmodelled effect explains it, and how well.

    Every effect of the catalogue is fitted with the base and weighed by its marginal likelihood, beside "no
    gap" (noise alone) and "unlisted" (a free smooth discrepancy). The best is added and the rest weighed
    again, until noise or nothing listed explains what is left.

    Parameters
    ----------
    study : Study
        With observations.
    base : str
        "linear-constant", "linear-radius", "tangent-constant", "tangent-radius", or a model with that
        structure (A to E, H, I).
    confirm : bool
        Sample the posteriors of the leading explanations in PyMC.
    max_effects : int
        Most effects to add.
    exhaust : bool
        Go on adding the best listed effect where a free discrepancy explains more: what the catalogue can do
        at most. The verdict is that of the first round all the same.
    effects : sequence of str, optional
        Only these of the catalogue.
    conventions : Conventions, optional
        Instead of the study's own.
    cores : int
        Threads, and processes of the confirmation.
    seed : int
        Of the draws.
    tick : callable, optional
        Called with a text and the share of the screening that is done.
    folder : path, optional
        Where the confirmation stores its posteriors and checkpoints.

    Returns
    -------
    Diagnosis

    Raises
    ------
    DiagnosisError
        If an argument is out of range, a series does not vary, or the base cannot be fitted.
    zoo.blood.effects.EffectError
        If there is no such effect or base.

    References
    ----------
    Kennedy and O'Hagan 2001, doi 10.1111/1467-9868.00294; Paun et al. 2020, doi 10.1098/rsif.2020.0886.
    """
    if not isinstance(study, Study):
        raise DiagnosisError(f"study = {study!r}: give a Study, such as zoo.load_study('demo')")
    for what, count in (("max_effects", max_effects), ("cores", cores)):
        if count < 1:
            raise DiagnosisError(f"{what} = {count}: must be at least 1")
    if isinstance(effects, str):
        raise DiagnosisError(f"effects = {effects!r}: give a list of names, such as [{effects!r}]")
    if effects:
        effects = effects_for(base, effects)
    for series in study.series:
        if np.ptp(series.value) == 0.0:
            raise DiagnosisError(
                f"{study.source}: series {series.label} is {series.value[0]:g} throughout; give a beat that "
                "varies in observations.csv, or leave the series out"
            )
    began = time.monotonic()
    started = datetime.now(UTC).isoformat(timespec="seconds")
    rounds: list[Scored] = []
    screenings: list[Screening] = []
    added: list[tuple[str, Place]] = []
    while True:
        screening = Screening(
            study, base, added=added, effects=effects, cores=cores, conventions=conventions, tick=tick
        )
        screenings.append(screening)
        try:
            scored = score(screening.run(stop_at_noise=bool(rounds)))
        except SearchError as error:
            if rounds:
                break
            raise DiagnosisError(
                f"{study.source}: study {study.name!r}: the base {base!r} cannot be solved ({error}); "
                "check inflow, Windkessels and conventions"
            ) from None
        rounds.append(scored)
        best = _stronger(scored, exhaust)
        if best is None or len(added) == max_effects:
            break
        added.append(best)
    screen_seconds = time.monotonic() - began
    first = rounds[0]
    cause_fit = rounds[-1].screened.base if len(rounds) > 1 else first.best[first.leader]
    single = first.best[first.leader]
    file, before, after = _file(study, base, first, rounds, single, seed, started, screen_seconds, screenings)
    computed = tuple(
        first.screened.screening.harmonics.back(f.computed) for f in (first.screened.base, cause_fit)
    )
    found = Diagnosis(study, file, tuple(rounds), before, after, (computed[0], computed[1]))
    return found.confirmed(cores=cores, seed=seed, folder=folder, tick=tick) if confirm else found


def _file(
    study: Study,
    base: str,
    first: Scored,
    rounds: Sequence[Scored],
    single: Fit,
    seed: int,
    started: str,
    seconds: float,
    screenings: Sequence[Screening],
) -> tuple[DiagnosisFile, Discrepancy, Discrepancy]:
    rows, unit = _rows(study)
    screened = first.screened
    before = discrepancy(screened, screened.base, seed)
    listed = first.leader in first.places
    after = discrepancy(screened, single, seed) if listed else before
    held = hold_out(first, single) if listed else None
    noise = {s.label: screened.noise[s.quantity].noise for s in study.series}
    b, a, removed = before.interval(rows), after.interval(rows), after.removed(rows, before)
    quantity = study.series[rows[0]].quantity
    gap = Gap(
        before_mmHg=b.mean,
        before_interval_mmHg=(b.low, b.high),
        noise_floor_mmHg=screened.noise[quantity].noise,
        after_mmHg=a.mean,
        after_interval_mmHg=(a.low, a.high),
        residual_rms_before_mmHg=_rms(before.residual[rows]),
        residual_rms_after_mmHg=_rms(after.residual[rows]),
        removed=removed.mean if listed else 0.0,
        removed_interval=(removed.low, removed.high) if listed else (0.0, 0.0),
        held_out_before_mmHg=held.before if held else None,
        held_out_after_mmHg=held.after if held else None,
        held_out_removed=held.removed if held else None,
        held_out=held.what if held else "",
        per_series=[
            SeriesGap(
                series=s.label,
                unit=UNITS[s.quantity],
                before=before.interval([i]),
                after=after.interval([i]),
                noise_floor=noise[s.label],
                residual_rms_before=_rms(before.residual[i]),
                residual_rms_after=_rms(after.residual[i]),
            )
            for i, s in enumerate(study.series)
        ],
    )
    steps = []
    for now, then in pairwise(rounds):
        name, place = then.screened.screening.added[-1]
        fits = (now.screened.base, then.screened.base)
        sizes = [float(discrepancy(now.screened, f, seed).pooled(rows).mean()) for f in fits]
        steps.append(
            Step(
                name=name, place=place.vessel, subtree=place.subtree, probability=now.probability[name],
                amplitudes=_amplitudes(now.best[name]), gap_before_mmHg=sizes[0], gap_after_mmHg=sizes[1],
            )
        )  # fmt: skip
    parameters = {}
    for label, fit in (("base", screened.base), ("with cause", single)):
        values = fit.values
        sds = fit.sd
        parameters[label] = {p.name: float(values[i]) for i, p in enumerate(fit.forward.parameters)} | {
            f"{p.name} sd": float(sds[i] * (values[i] if p.log else 1.0))
            for i, p in enumerate(fit.forward.parameters)
        }
    members = first.members(first.leader)
    file = DiagnosisFile(
        study=study.name,
        study_checksum=study.checksum,
        base=get_base(base).name,
        gap=gap,
        where=_where(first, before),
        cause=members,
        verdict=_verdict(first, gap),
        warnings=_warnings(study, gap, first),
        hypotheses=_results(first, seed, {NO_GAP: before} | ({first.leader: after} if listed else {})),
        steps=steps,
        invisible=list(first.invisible),
        failed=list(first.failed),
        next_measurement=next_measurement(first),
        base_parameters=parameters,
        confirmation=None,
        record={
            "versions": versions(),
            "seed": seed,
            "started": started,
            "screening_seconds": seconds,
            "solves": sum(s.solves for s in screenings),
            "failed_solves": sum(s.failures for s in screenings),
            "cores": screenings[0].cores,
            "noise": {q: vars(e) for q, e in screened.noise.items()},
            "gap_unit": unit,
        },
    )
    return file, before, after
