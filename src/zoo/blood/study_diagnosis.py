"""The diagnosis of a study: baselines, effects, phases of the beat, candidate measurements."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.blood.baseline import Baseline, get_baseline
from zoo.blood.blood_flow import study_data
from zoo.blood.components import component_of, components, plausible
from zoo.blood.conventions import Conventions
from zoo.blood.effects import CATALOGUE
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Study, Vessel, suspect_units
from zoo.blood.study_priors import with_priors
from zoo.core.causes.family import ErrorFamily
from zoo.core.components import FreeFunction
from zoo.core.data import Data
from zoo.core.diagnosis import Candidate, Diagnosis, DiagnosisError, Hooks, OtherState
from zoo.core.diagnosis import diagnose as diagnose_data
from zoo.core.diagnosis.coordinates import ranges
from zoo.core.diagnosis.hooks import NOISE_PART
from zoo.core.effects import Effect, EffectError
from zoo.core.errors.spectral import Spectral, spectral_errors
from zoo.core.experiments import Experiments
from zoo.core.forward import ForwardModel

Array = NDArray[np.float64]

PHASES = ("upstroke", "peak", "late-systole", "incisura", "diastole")
UPSTROKE, PEAK, LATE_SYSTOLE, INCISURA, DIASTOLE = range(5)
PEAK_BEATS = 0.03
"""Half the width of the peak and of the incisura, in beats."""
SMOOTHED = 12.0
"""Harmonic at which the wave is damped to exp(-1/2) before its features are looked for."""
PEAK_WITHIN, INCISURA_WITHIN = 0.6, 0.45
"""Beats after the foot within which the peak is, and after the peak within which the incisura is."""
MIDWAY = 0.5
"""Place of a candidate measurement in its vessel, in parts of the length."""
FLOW_NOISE_PART = 0.02
"""Noise of a flow measurement that is only planned, as a part of its peak."""
SEARCH_SHARE = 0.1
"""Tolerance of the solves of a search, whose differences must not be noise."""
LEAST_HEARD = 1e-4
"""Noise in parts of the range below which no finer grid is worth its time: some series show none."""


def phases(wave: Array, period_s: float) -> NDArray[np.int_]:
    """Phase of the beat of each sample, an index of `PHASES`, found from the waveform.

    The foot is the least value before the steepest rise, the peak the largest value, the incisura the
    sharpest upward bend (largest second difference of the smoothed wave) after it within 0.45 cycles.

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
    smooth = np.fft.irfft(c * np.exp(-0.5 * (k / SMOOTHED) ** 2), n=n)
    slope = np.roll(smooth, -1) - np.roll(smooth, 1)
    steepest = int(np.argmax(slope))
    back = [(steepest - i) % n for i in range(n // 2)]
    foot = back[int(np.argmin(smooth[back]))]
    ahead = [(foot + i) % n for i in range(n)]
    peak_after = int(np.argmax(smooth[ahead[: int(PEAK_WITHIN * n)]]))
    bend = np.roll(smooth, -1) - 2.0 * smooth + np.roll(smooth, 1)
    half = max(1, round(PEAK_BEATS * n))
    first, last = peak_after + 2 * half, min(n - half, peak_after + int(INCISURA_WITHIN * n))
    incisura_after = first + int(np.argmax(bend[[ahead[i] for i in range(first, last)]]))
    found = np.empty(n, int)
    for i, at in enumerate(ahead):
        if abs(i - peak_after) <= half:
            phase = PEAK
        elif i < peak_after:
            phase = UPSTROKE
        elif abs(i - incisura_after) <= half:
            phase = INCISURA
        else:
            phase = LATE_SYSTOLE if i < incisura_after else DIASTOLE
        found[at] = phase
    return found


def _phases(data: Data, rows: list[int]) -> tuple[tuple[str, ...], NDArray[np.int_]]:
    wave, n = data.samples(rows[0]), data.n_times
    if data.even:
        return PHASES, phases(wave, data.duration)
    passed = (data.times - data.times[0]) / data.duration
    even = np.interp(np.arange(n) / n, passed[data.measured[rows[0]]], wave, period=1.0)
    return PHASES, phases(even, data.duration)[(passed * n).astype(int) % n]


def _candidates(data: Data, baseline: ForwardModel) -> list[Candidate]:
    """Pressure and flow midway in every vessel."""
    return [
        Candidate(
            (int(vessel), MIDWAY, quantity),
            {"vessel": int(vessel), "position": MIDWAY, "quantity": quantity},
            group,
            noise_part,
            f"{word} midway in vessel {vessel}",
        )
        for vessel in baseline.network.ids  # type: ignore[attr-defined]
        for word, quantity, group, noise_part in (
            ("pressure", "pressure_mmHg", "pressure_mmHg", NOISE_PART),
            ("flow", "flow_ml_s", "", FLOW_NOISE_PART),
        )
    ]


HOOKS = Hooks(
    about="pressure_mmHg",
    phases=_phases,
    candidates=_candidates,
    labels={
        "f1": "stiffness f1",
        "f2": "stiffness f2",
        "f3": "stiffness f3",
        "m_chi": "mean stiffness",
        "chi": "stiffness chi",
        "gamma": "wall shape gamma",
        "psi1": "factor psi1 of R1",
        "psi2": "factor psi2 of R2",
        "c": "factor c of C",
    },
    advice="check the units in observations.csv, the inflow and the conventions",
    smooth=False,
    components=components,
    component_of=component_of,
    plausible=plausible,
)
"""What a diagnosis is told about blood flow."""


@dataclass(frozen=True, eq=False, repr=False)
class StudyDiagnosis(Diagnosis):
    """The diagnosis of a study, which figures of the tree need."""

    study: Study = field(kw_only=True)


def effects_for(
    baseline: str | ForwardModel, given: Iterable[str | Effect] | None = None
) -> tuple[Effect, ...]:
    """Effects that a baseline can take, once each; all of the catalogue that can act if none are given.

    Parameters
    ----------
    baseline : str or ForwardModel
        Its name, or itself: only then are sizes those of its study, such as seconds and not parts of a beat.
    given : iterable of str or Effect, optional
        Names in the catalogue, or effects.

    Raises
    ------
    zoo.core.effects.EffectError
        For a name that is not in the catalogue, or an effect that the baseline cannot take or that acts
        nowhere in its study.
    """
    name = baseline if isinstance(baseline, str) else baseline.name
    if given is None:
        found = tuple(one for one in CATALOGUE.values() if one.offered(name))
    else:
        found = CATALOGUE.resolve(given)
    for one in found:
        if not one.offered(name):
            only = ", ".join(one.baselines)
            raise EffectError(f"effect {one.name}: cannot be added to {name}, only to {only}")
    if isinstance(baseline, str):
        return found
    for one in found if given is not None else ():
        if not one.locations(baseline):
            raise EffectError(f"effect {one.name}: acts nowhere in this study; leave it out")
    return tuple(one.of(baseline) for one in found if one.locations(baseline))


def _of_size(factor: float) -> Callable[[ForwardModel, Array, Data], Sequence[FreeFunction]] | None:
    """The components' functions with prior sizes a factor larger; none at all of size 0."""

    def scaled(model: ForwardModel, theta: Array, data: Data) -> list[FreeFunction]:
        return [replace(one, size=factor * one.size) for one in components(model, theta, data)]

    return None if factor == 0.0 else components if factor == 1.0 else scaled


def errors_of(study: Study, data: Data) -> Spectral:
    """The errors of a diagnosis: the white noise of the study's `noise_sd`, fitted where it gives none.

    Raises
    ------
    DiagnosisError
        If series of one quantity have different noise, or some of them have none.
    """
    known = {}
    for group, rows in data.rows.items():
        sds = {study.noise_sd.get(data.labels[i], study.noise_sd.get(group)) for i in rows}
        if len(sds) > 1:
            raise DiagnosisError(
                f"{study.source}: noise_sd: differs between the series of {group}, which a diagnosis takes "
                f"as equally noisy; give one for {group}, or leave it out to have it fitted"
            )
        if (sd := sds.pop()) is not None:
            known[group] = sd
    return replace(spectral_errors(data), known=known)


def heard(study: Study, data: Data) -> Study:
    """The study with the noise that its finest harmonics show, where it states neither noise nor accuracy.

    Its grid is then as fine as for a noise that is known: a solver's error of the size of the noise, which
    differs between effects, would move log evidence by tens. Noise in a unit that is suspected tells nothing.
    """
    if "accuracy_percent" in study.numerics or suspect_units(study):
        return study
    errors = errors_of(study, data)
    family = ErrorFamily(errors.bind(data), ranges(data), dict(errors.known))
    sds = zip(family.groups, np.exp(family.noise_start), strict=True)
    seen = {group: max(float(sd), LEAST_HEARD * family.ranges[group]) for group, sd in sds}
    return replace(study, noise_sd={**seen, **study.noise_sd})


def diagnose(
    study: Study,
    base: str = "linear-constant",
    *,
    effects: Iterable[str | Effect] | None = None,
    posteriors: bool = False,
    conventions: Conventions | None = None,
    options: SolverOptions | None = None,
    priors: Mapping[str, Any] | None = None,
    fixed: Mapping[str, float] | None = None,
    component_sizes: float = 1.0,
    states: Sequence[Study] = (),
    cores: int = 2,
    seed: int = 1,
    tick: Callable[[str, float], None] | None = None,
    progress: bool = True,
    folder: str | Path | None = None,
    checkpoint: str | Path | None = None,
) -> StudyDiagnosis:
    """Find where a baseline model misses a study's data, which unmodelled effect explains it, and how well.

    Parameters
    ----------
    study : Study
        With observations.
    base : str
        "linear-constant", "linear-radius", "linear-vessels", "tangent-constant", "tangent-radius", or the
        letter of a model with that structure.
    effects : iterable of str or Effect, optional
        Only these: names in the catalogue, or effects of your own.
    posteriors : bool
        Sample the posteriors of the leading explanations in PyMC.
    conventions : Conventions, optional
        Instead of the study's own.
    options : SolverOptions, optional
        Numerical settings; those of the study, with a tighter tolerance than for sampling, if absent.
    priors : mapping, optional
        Instead of some of the study's own, as a model takes them.
    fixed : mapping, optional
        Parameters that are held at a value, ``{"psi1": 1.0}``, beside those that the study holds.
    component_sizes : float
        Factor of the prior sizes of what components may lack (docs/components.md): half and double tell how
        much of an answer they made, 0 leaves components out, and saves most of the time.
    states : sequence of Study
        The same vessels and sensors in other states, such as at another heart rate: what was learned is fixed
        there, and compared with the baseline and with the discrepancy that was seen at the sensor.
    cores, seed, tick, progress, folder, checkpoint
        As in `zoo.core.diagnosis.diagnose`.

    Returns
    -------
    StudyDiagnosis

    Raises
    ------
    DiagnosisError
        If an argument is out of range, a series does not vary, or the baseline cannot be fitted.
    zoo.core.effects.EffectError
        If there is no such effect or baseline.

    References
    ----------
    Kennedy and O'Hagan 2001, doi 10.1111/1467-9868.00294; Paun et al. 2020, doi 10.1098/rsif.2020.0886.
    """
    if not isinstance(study, Study):
        raise DiagnosisError(f"study = {study!r}: give a Study, such as zoo.load_study('demo')")
    _checked([study], effects, component_sizes)
    chosen = get_baseline(base)
    study = with_priors(study, priors, fixed)
    data, forward = _solved(study, chosen, conventions, options)
    if isinstance(states, Study | str):
        raise DiagnosisError(f"states = {states!r}: give a list of studies")
    own = suspect_units(study)
    others, odd = [], list(map(str, own))
    for state in states:
        other = with_priors(same_tree(study, state), priors, fixed)
        suspicions = suspect_units(other)
        odd += [f"in {other.name}: {suspicion}" for suspicion in suspicions]
        if {one.unit for one in suspicions} - {one.unit for one in own}:
            odd.append(f"{other.name} is not compared with what was learned before its units are mended")
            continue
        here, model = _solved(other, chosen, conventions, options)
        others.append(OtherState(here, model, errors_of(other, here)))
    found = diagnose_data(
        data,
        forward,
        effects_for(forward, effects),
        errors=errors_of(study, data),
        hooks=replace(HOOKS, warnings=tuple(odd), components=_of_size(component_sizes)),
        states=others,
        posteriors=posteriors,
        cores=cores,
        seed=seed,
        tick=tick,
        progress=progress,
        folder=folder,
        checkpoint=checkpoint,
    )
    found.file.record["component_sizes"] = component_sizes
    return of_study(found, study, {p.name: p.prior.text for p in forward.parameters})


def _checked(studies: Sequence[Study], effects: Any, component_sizes: float) -> None:
    """Refuse what cannot be diagnosed."""
    if isinstance(effects, str | Effect):
        raise DiagnosisError(f"effects = {effects!r}: give a list, such as [{effects!r}]")
    for study in studies:
        if not study.series:
            raise DiagnosisError(
                f"{study.source}: study {study.name!r} has no observations: a diagnosis needs at least one "
                "series of eight samples; add observations.csv"
            )
    if not 0.0 <= component_sizes < math.inf:
        raise DiagnosisError(f"component_sizes = {component_sizes}: must be finite, and not below 0")


def _solved(
    study: Study, chosen: Baseline, conventions: Conventions | None, options: SolverOptions | None
) -> tuple[Data, ForwardModel]:
    """A study's data, and its baseline on the grid that they call for."""
    data = study_data(study)
    settings: dict[str, Any] = {"conventions": conventions, "options": options, "share": SEARCH_SHARE}
    return data, chosen.forward(heard(study, data), **settings)


def diagnose_studies(
    studies: Sequence[Study],
    base: str = "linear-constant",
    *,
    share: Iterable[str] = (),
    effects: Iterable[str | Effect] | None = None,
    conventions: Conventions | None = None,
    options: SolverOptions | None = None,
    priors: Mapping[str, Any] | None = None,
    fixed: Mapping[str, float] | None = None,
    component_sizes: float = 1.0,
    **settings: Any,
) -> Diagnosis:
    """Find what a baseline lacks in several studies together: causes that act in all of them, of one size.

    Parameters
    ----------
    studies : sequence of Study
        Each with observations; the names must differ.
    base : str
        As in `diagnose`.
    share : iterable of str
        Parameters that are one for all; the others are of each study, with its own prior.
    effects : iterable of str or Effect, optional
        Only these; all of the catalogue that can act in every study if absent. A size in s is one in all.
    conventions, options, priors, fixed, component_sizes, **settings
        As in `diagnose`.

    Returns
    -------
    Diagnosis
        Its parameters are named "f3[study]"; its free functions are those that all studies have.

    Raises
    ------
    DiagnosisError
        As in `diagnose`, and where two studies have one name.
    zoo.core.experiments.ExperimentError
        If the studies cannot be taken as one.
    zoo.core.effects.EffectError
        If an effect does not exist, or acts nowhere in one of the studies.
    """
    for one in studies:
        if not isinstance(one, Study):
            raise DiagnosisError(f"studies = {one!r}: give studies, such as zoo.load_study('demo')")
    names = [one.name for one in studies]
    if twice := [name for i, name in enumerate(names) if name in names[:i]]:
        raise DiagnosisError(f"studies: {twice[0]} is there twice; give it once, or another name")
    _checked(studies, effects, component_sizes)
    chosen = get_baseline(base)
    given = {one.name: with_priors(one, priors, fixed) for one in studies}
    ready = {name: _solved(one, chosen, conventions, options) for name, one in given.items()}
    models = {name: model for name, (_, model) in ready.items()}
    records = {name: data for name, (data, _) in ready.items()}
    noises = {name: dict(errors_of(one, records[name]).known) for name, one in given.items()}
    own_noise = any(one != next(iter(noises.values())) for one in noises.values())
    several = Experiments(models, records, share, own_noise)
    for model in models.values():
        effects_for(model, effects)  # what was asked for has to act in each
    listed = [several.effect(one) for one in effects_for(chosen.name, effects)]
    known = {
        f"{name}/{group}" if own_noise else group: sd
        for name, noise in noises.items()
        for group, sd in noise.items()
    }
    own = _of_size(component_sizes)

    def functions(model: Any, theta: Array, data: Data) -> Sequence[FreeFunction]:
        assert own is not None
        found: Sequence[FreeFunction] = model.functions(own, theta)
        return found

    odd = [f"in {name}: {one}" for name, study in given.items() for one in suspect_units(study)]
    labels = {f"{key}[{name}]": f"{text} [{name}]" for key, text in HOOKS.labels.items() for name in given}
    hooks = replace(
        HOOKS,
        about=several.about("pressure_mmHg"),
        candidates=None,
        warnings=tuple(odd),
        labels={**HOOKS.labels, **labels},
        components=own and functions,
    )
    acting = [one for one in listed if one.locations(several)]
    if effects is not None and len(acting) < len(listed):
        nowhere = ", ".join(one.name for one in listed if one not in acting)
        raise EffectError(f"effects: {nowhere}: no place where all studies have it; leave it out")
    found = diagnose_data(
        several.data,
        several,
        acting,
        errors=replace(spectral_errors(several.data), known=known),
        hooks=hooks,
        **settings,
    )
    found.file.record["component_sizes"] = component_sizes
    return found


def same_tree(study: Study, other: Study) -> Study:
    """The other study, which must have observations of the same tree of vessels.

    Parameters
    ----------
    study, other : Study

    Returns
    -------
    Study
        The other one.

    Raises
    ------
    DiagnosisError
        If it has no observations, or vessels of other parents, lengths or radii.
    """
    if not isinstance(other, Study):
        raise DiagnosisError(f"states = {other!r}: give studies, such as zoo.load_study('demo')")
    if not other.series:
        raise DiagnosisError(
            f"{other.source}: study {other.name!r} has no observations, and nothing to compare with in this "
            "state; add observations.csv"
        )
    trees = [{v.id: _geometry(v) for v in one.vessels} for one in (study, other)]
    for odd in sorted(trees[0].keys() | trees[1].keys()):
        here, there = (tree.get(odd) for tree in trees)
        if here is None or there is None or here[0] != there[0] or not np.allclose(here[1], there[1]):
            raise DiagnosisError(
                f"{other.source}: vessel {odd} is not the same as in {study.name!r}, whose parent, length "
                "and radii it needs: another state has the same tree of vessels; give a study of it"
            )
    return other


def _geometry(vessel: Vessel) -> tuple[int | None, list[float]]:
    return vessel.parent, [vessel.length_cm, vessel.radius_cm, vessel.radius_out_cm]


def of_study(found: Diagnosis, study: Study, priors: Mapping[str, str]) -> StudyDiagnosis:
    """A diagnosis of a study's data with the study, its checksum, and the baseline's priors in words."""
    record = found.file.record | {"priors": dict(priors)}
    found = found.with_file(study=study.name, study_checksum=study.checksum, record=record)
    values: dict[str, Any] = {f.name: getattr(found, f.name) for f in fields(Diagnosis)}
    return StudyDiagnosis(**values, study=study)
