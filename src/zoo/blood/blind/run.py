"""Diagnosing the cases of a folder without their key."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zoo.blood.baseline import get_baseline
from zoo.blood.blind.bench import BASELINE
from zoo.blood.diagnosis import diagnose, prior_words
from zoo.blood.plugins import add_effects
from zoo.blood.solver import library_digest
from zoo.blood.study import Study, StudyError, load_study
from zoo.core import digests
from zoo.core.blindcheck.answers import Fitted, fitted_series
from zoo.core.blindcheck.running import Ran, run_folders
from zoo.core.blindcheck.sealing import BlindError
from zoo.core.diagnosis import DiagnosisError, read_diagnosis
from zoo.core.inference.record import versions
from zoo.core.outputs import write_file

FITTED = "fitted.json"
FITTED_DIGITS = 7


@dataclass(frozen=True)
class CaseDiagnosis:
    """The diagnosis of a case that is a study's folder.

    Parameters
    ----------
    base : str
        Name of the baseline model.
    posteriors, max_effects, seed, effects, priors
        As in `zoo.blood.diagnosis.diagnose`.
    effects_from : tuple of str
        Python files that define effects; they are run.
    """

    base: str
    posteriors: bool
    max_effects: int
    seed: int
    effects: tuple[str, ...] | None = None
    priors: Mapping[str, Any] | None = None
    effects_from: tuple[str, ...] = ()
    marker: str = "study.toml"
    result: str = "diagnosis.json"

    def answered(self, case: Path, answer: Path) -> bool:
        """Whether a diagnosis of this study by this version is there."""
        try:
            study = load_study(case)
            found = read_diagnosis(answer)
            facts = read_case_facts(answer)
            fitted = read_fitted(answer, study.checksum)
        except (StudyError, DiagnosisError, BlindError):
            return False
        return bool(
            found.study_checksum == study.checksum
            and facts == _case_facts(study, self)
            and found.base == self.base
            and found.record.get("seed") == self.seed
            and found.record.get("priors") == prior_words(study, self.base, self.priors)
            and (found.posteriors is not None or not self.posteriors)
            and fitted is not None
        )

    def diagnose(self, case: Path, answer: Path) -> None:
        """Diagnose the study, and write its tree and the diagnosis."""
        for path in self.effects_from:
            add_effects(path)
        study = load_study(case)
        facts = _case_facts(study, self)
        facts["parents"] = {str(vessel): parent for vessel, parent in facts["parents"].items()}
        write_file(answer / "case.json", digests.to_text(facts))
        found = diagnose(
            study,
            self.base,
            posteriors=self.posteriors,
            max_effects=self.max_effects,
            effects=self.effects,
            priors=self.priors,
            cores=1,
            seed=self.seed,
            folder=answer / "posteriors" if self.posteriors else None,
        )
        write_fitted(answer, fitted_series(found), study.checksum)
        found.save(answer)


def write_fitted(answer: Path, fitted: Fitted, checksum: str) -> None:
    """Write the series that a diagnosis fitted, which what it states of the discrepancy is about."""
    content = {
        "checksum": checksum,
        "about": list(fitted.rows),
        "base": np.round(fitted.base, FITTED_DIGITS).tolist(),
        "leader": np.round(fitted.leader, FITTED_DIGITS).tolist(),
    }
    write_file(answer / FITTED, digests.to_text(content, indent=None))


def read_fitted(answer: Path, checksum: str) -> Fitted | None:
    """What `write_fitted` wrote; None where answers are of a version that did not.

    Parameters
    ----------
    answer : Path
    checksum : str
        Of the study that the answer is about.

    Raises
    ------
    BlindError
        If it is broken or damaged, or of another study.
    """
    path = answer / FITTED
    if not path.exists():
        return None
    try:
        found = digests.from_text(path.read_bytes(), required=True)
        base, leader = (np.array(found[name], dtype=float) for name in ("base", "leader"))
        rows, study = tuple(int(i) for i in found["about"]), str(found["checksum"])
        if base.ndim != 2 or base.shape != leader.shape or not set(rows) <= set(range(len(base))) or not rows:
            raise ValueError
    except (OSError, ValueError, KeyError, TypeError):
        raise BlindError(f"{path}: is broken; make it again with `zoo blind run`") from None
    if study != checksum:
        raise BlindError(f"{path}: is of another case; make it again with `zoo blind run`")
    return Fitted(base, leader, rows)


def _digests(paths: Sequence[str]) -> list[str]:
    """SHA-256 of files."""
    return [digests.of_bytes(Path(path).read_bytes()) for path in paths]


def _case_facts(study: Study, asked: CaseDiagnosis) -> dict[str, Any]:
    """What case.json tells: the study's tree and series, what was asked of its diagnosis, and of whom."""
    return {
        "checksum": study.checksum,
        "parents": {v.id: v.parent for v in study.vessels},
        "series": [s.label for s in study.series],
        "max_effects": asked.max_effects,
        "effects": None if asked.effects is None else list(asked.effects),
        "effects_from": _digests(asked.effects_from),
        "program": {**versions(), "solver": library_digest()},
    }


def read_case_facts(answer: Path) -> dict[str, Any]:
    """Checksum, tree ("parents": id of a vessel -> that of the one that feeds it) and series of a case.

    Raises
    ------
    BlindError
        If case.json is missing, broken or damaged.
    """
    path = answer / "case.json"
    try:
        found = digests.from_text(path.read_bytes(), required=True)
        found["parents"] = {int(i): parent for i, parent in found["parents"].items()}
    except (OSError, ValueError, KeyError, AttributeError):
        raise BlindError(f"{path}: is missing or broken; make it again with `zoo blind run`") from None
    return dict(found)


def diagnose_cases(
    cases: str | Path,
    answers: str | Path,
    *,
    base: str = BASELINE,
    posteriors: bool = False,
    max_effects: int = 3,
    effects: Sequence[str] | None = None,
    effects_from: Sequence[str | Path] = (),
    seed: int = 1,
    priors: Mapping[str, Any] | None = None,
    cores: int = 2,
    executor: Executor | None = None,
    done: Callable[[str], None] = lambda case: None,
) -> Ran:
    """Diagnose every case of a folder, each in a process of its own; no key is read or looked for.

    A case whose answer is of the same data, settings, versions and solver is left as it is, so that an
    interrupted run goes on. One that fails has failed.txt instead.

    Parameters
    ----------
    cases : path
        Folder of studies.
    answers : path
        A folder for each case: diagnosis.json (`Diagnosis.save`), case.json.
    base : str
    posteriors : bool
        Sample the leading explanations' posteriors too.
    max_effects, effects, seed, priors
        As in `zoo.blood.diagnosis.diagnose`.
    effects_from : sequence of path
        Python files that define effects, which every process runs; on every machine in the same place.
    cores : int
        Processes.
    executor : concurrent.futures.Executor, optional
        Diagnoses the cases instead, see `zoo.core.inference.workers.each`.
    done : callable
        Told the name of each case that is finished.

    Returns
    -------
    Ran

    Raises
    ------
    BlindError
        If the folder holds a key or no study, or answers and cases are one folder; if a worker has other
        versions than this program.
    zoo.core.inference.workers.LostTaskError
        If the worker of a case died as often as it may.
    """
    cases, answers = Path(cases), Path(answers)
    if not cases.is_dir():
        raise BlindError(f"{cases}: no such folder; give one of `zoo blind make`")
    for what, count, least in (("max_effects", max_effects, 1), ("seed", seed, 0)):
        if count < least:
            raise BlindError(f"{what} = {count}: must be at least {least}")
    chosen = None if effects is None else tuple(effects)
    files = tuple(str(Path(path).resolve()) for path in effects_from)  # workers have a folder of their own
    diagnosis = CaseDiagnosis(
        get_baseline(base).name, posteriors, max_effects, seed, chosen, priors, effects_from=files
    )
    return run_folders(cases, answers, diagnosis, cores=cores, executor=executor, done=done)
