"""A study whose series go over several beats, as one of their mean."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from zoo.blood.importing.beats import ImportedBeats, Record, scatter_lines
from zoo.blood.importing.imported import ImportedFileError
from zoo.blood.study.loading import read_study
from zoo.blood.study.samples import FEWEST_BEATS, MIN_SAMPLES, Samples
from zoo.core.arrays import Array


def average_beats(folder: str | Path) -> ImportedBeats:
    """A study of one beat from a study whose samples go over several.

    Beat k of a series has its samples from k to k + 1 periods: period_s and time 0 are those of the inflow,
    so that what lies between flow and pressure stays as it was measured. The mean of the beats takes the
    place of the series, and their scatter, sd^2 = mean over the times of sum_k (y_k - mean)^2/(K - 1), is its
    noise_sd where the study has none. An inflow over several beats is averaged too.

    Parameters
    ----------
    folder : str or Path
        Of a study, which stays as it is.

    Returns
    -------
    ImportedBeats
        Beats by the label of their series, without covariances.

    Raises
    ------
    ImportedFileError
        If no series goes over several beats, too few of them are whole, or all of them are the same.
    zoo.blood.study.StudyError
        If anything else in the study is wrong.

    Examples
    --------
    >>> import zoo
    >>> zoo.average_beats("my-study").save("my-study-averaged")  # doctest: +SKIP
    """
    fold = _Fold()
    study = read_study(folder, fold=fold)
    if not fold.beats:
        raise ImportedFileError(
            f"{study.source}: no series is longer than period_s = {study.period_s:.10g}: nothing to average"
        )
    noise = dict(study.noise_sd)
    read = list(fold.read)
    for label, beats in fold.beats.items():
        quantity = label.rpartition(" ")[2]
        sd = float(np.sqrt(np.mean(np.var(beats, axis=0, ddof=1))))
        read += scatter_lines(label, beats, sd, study.period_s)
        known = study.noise_sd.get(label, study.noise_sd.get(quantity))
        if label.startswith(("inflow ", "inlet ")):
            continue
        if known is not None:
            read.append(f"{label}: noise_sd stays {known:g}, as the study says")
        elif sd > 1e-9 * np.ptp(beats):
            noise[label] = sd
        else:
            raise ImportedFileError(
                f"{study.source}: {label}: all beats are the same: they are averaged already; give one"
            )
    study = replace(study, noise_sd=noise)
    return ImportedBeats(study, tuple(read), (), tuple(fold.left_out), beats=fold.beats)


@dataclass
class _Fold:
    """Makes one beat of samples that go over several, and keeps the beats."""

    beats: dict[str, Array] = field(default_factory=dict)
    read: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    def __call__(self, samples: Samples, period: float) -> Samples:
        there = ~np.isnan(samples.values)
        if np.sum(there) < MIN_SAMPLES or np.max(samples.times) <= 1.5 * period:
            return samples  # one beat, of which others say what is wrong
        s = replace(samples, times=samples.times[there], values=samples.values[there]).sorted()
        s.refuse_twice()
        record = Record(Path(s.path), s.label, "", s.times, s.values, int(np.sum(~there)))
        n = max(MIN_SAMPLES, round(period / record.step))
        phase = np.asarray(np.arange(n) * (period / n), dtype=np.float64)
        slack = 0.02 * record.step  # of times that are printed with few digits
        first = int(np.ceil((s.times[0] - slack) / period))
        last = int(np.floor((s.times[-1] - phase[-1] + slack) / period))
        starts = period * np.arange(first, last + 1)
        whole = [t for t in starts if record.measured(t + slack, t + phase[-1] - slack)]
        if len(whole) < FEWEST_BEATS:
            raise ImportedFileError(
                f"{s.path}: {s.label}: {len(whole)} whole beats of period_s = {period:.10g}: at least "
                f"{FEWEST_BEATS} are needed for their scatter; give a longer record, or one beat"
            )
        if lacking := len(starts) - len(whole):
            self.left_out.append(f"{s.label}: {lacking} beats of {len(starts)}, not measured throughout")
        beats = np.array([record.at(t + phase) for t in whole])
        mean = beats.mean(axis=0)
        self.beats[s.label if s.unit == "value" else f"{s.label} {s.unit}"] = beats
        slope = np.gradient(mean, phase)
        late = -(beats - mean) @ slope / (slope @ slope) if np.any(slope) else np.zeros(len(beats))
        self.read.append(
            f"{s.label}: {len(s.times)} samples every {1000 * record.step:.3g} ms, {record.missing} not "
            f"measured; {len(whole)} whole beats by period_s = {period:.10g}, from "
            f"{1000 * late.min():.2g} to {1000 * late.max():.2g} ms late against their mean"
        )
        return replace(samples, rows=[s.rows[0]] * n, times=phase, values=mean)
