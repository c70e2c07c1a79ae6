"""The blind check of the diagnosis: studies whose effect is withheld, diagnosed and scored.

`make_cases` writes studies, each with an effect that its files do not tell, and the key apart;
`diagnose_cases` diagnoses them and sees no key; `score_cases` compares. docs/blind.md says how cases are
drawn and what each score means.
"""

from __future__ import annotations

import math
import re
import secrets
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from zoo.blood.baseline import get_baseline
from zoo.blood.blind.study_cases import (
    BASELINE,
    BENCHES,
    GAP_OVER_NOISE,
    LAYOUTS,
    NETWORKS,
    WHITE_MMHG,
    case_of,
    correlation,
    draw_bench,
    draw_listed,
    nothing,
    stream,
)
from zoo.blood.plugins import add_effects
from zoo.blood.solver import library_digest
from zoo.blood.study import load_study
from zoo.blood.study_diagnosis import diagnose, effects_for
from zoo.core import digests
from zoo.core.blindcheck.cases import NULL, Answer, BlindError, as_answer
from zoo.core.blindcheck.folders import MadeCase, Ran, read_answers, read_sealed, run_cases, write_cases
from zoo.core.blindcheck.score_tables import SCORE_FILES, write_score
from zoo.core.blindcheck.scoring import Score, score_answers
from zoo.core.inference.record import versions
from zoo.core.outputs import output_folder

FORMAT = 3
SECRET = re.compile(r"[0-9a-f]{32}")
"""128 bits in hexadecimal digits."""
NONE_SHARE = 1 / 8
BY = ("kind", "series", "layout", "network")


@dataclass(frozen=True)
class Draw:
    """What a set of cases is drawn from; as the arguments of `make_cases`, whose words they are."""

    n: int
    secret: str
    effects: tuple[str, ...]
    networks: tuple[str, ...]
    layouts: tuple[str, ...]
    vessels: tuple[int, int]

    def plan(self) -> list[str]:
        """The effect of each case that is tried first, or "no-gap".

        Every effect comes once before one comes twice, in an order that the secret shuffles.
        """
        rng = stream(self.secret, "plan")
        none = round(self.n * NONE_SHARE)
        rounds = [
            str(x) for _ in range(-(-self.n // len(self.effects))) for x in rng.permutation(self.effects)
        ]
        names = [NULL] * none + rounds[: self.n - none]
        return [names[i] for i in rng.permutation(self.n)]


def draw_case(draw: Draw, job: tuple[int, str]) -> MadeCase:
    """Draw a case, by its number and what is tried first: its files, and its entry of the key.

    Raises
    ------
    BlindError
        If no effect that was drawn has a model discrepancy of the size that is wanted.
    """
    index, first = job
    name = f"case-{index + 1:03d}"
    network, effects, noises = (stream(draw.secret, x, index) for x in ("network", "effect", "noise"))
    correlated = correlation(noises)
    noise = math.hypot(WHITE_MMHG, correlated[0])
    low, high = (x * noise for x in GAP_OVER_NOISE)
    for _ in range(BENCHES):
        bench, tags = draw_bench(
            network, name, networks=draw.networks, layouts=draw.layouts, vessels=draw.vessels
        )
        quiet = nothing(bench) if first == NULL else None
        cause = quiet or draw_listed(effects, bench, (first, *draw.effects), (low, high))
        if cause is not None:
            return case_of(bench, cause, noises, correlated, tags)
    raise BlindError(
        f"{name}: no effect that was drawn has a model discrepancy of {low:.2g} to {high:.2g} mmHg; "
        "give other effects, layouts or networks"
    )


def make_cases(
    folder: str | Path,
    n: int = 40,
    key: str | Path = "key.json",
    *,
    secret: str | None = None,
    effects: Sequence[str] | None = None,
    networks: Sequence[str] = NETWORKS,
    layouts: Sequence[str] = LAYOUTS,
    vessels: tuple[int, int] = (5, 15),
    cores: int = 2,
    done: Callable[[str], None] = lambda case: None,
) -> Path:
    """Write studies with a withheld effect each, or none, and the key apart.

    All that is random comes from a secret of 128 bits, which the key holds and nothing else: nobody finds the
    plan by trying numbers. The cases are written together when all are made.

    Parameters
    ----------
    folder : path
        New or empty: for the cases, and the key's SHA-256.
    n : int
        Cases; an eighth has no effect.
    key : path
        New JSON file outside the folder.
    secret : str, optional
        That of an older key, 32 hexadecimal digits, to make its cases again with the same `n` and settings; a
        new one is drawn if absent.
    effects : sequence of str, optional
        Of the catalogue; all that fit the baseline if absent.
    networks : sequence of str
        "mouse", "tree".
    layouts : sequence of str
        Of `LAYOUTS`.
    vessels : (int, int)
        Least and largest number of vessels of a generated tree.
    cores : int
        Processes.
    done : callable
        Told the name of each finished case.

    Returns
    -------
    Path
        The key's.

    Raises
    ------
    BlindError
        If an argument is out of range, or the folder or the key is there.
    """
    folder, key = Path(folder), Path(key)
    if n < 1 or n > 999 or cores < 1:
        raise BlindError(f"n = {n}, cores = {cores}: give n from 1 to 999, cores >= 1")
    if secret is not None and not SECRET.fullmatch(secret):
        raise BlindError('secret: give the 32 hexadecimal digits of a key\'s "secret", or leave it out')
    for what, given, some in (("networks", networks, NETWORKS), ("layouts", layouts, LAYOUTS)):
        if not given or set(given) - set(some):
            raise BlindError(f"{what} = {', '.join(given)}: give some of {', '.join(some)}")
    names = tuple(one.name for one in effects_for(BASELINE, effects))
    if len(names) < 2:
        raise BlindError(f"effects = {', '.join(names)}: give two or more, or what is withheld is known")
    if not 3 <= vessels[0] <= vessels[1] or (vessels[0] == vessels[1] and vessels[0] % 2 == 0):
        raise BlindError(
            f"vessels = {vessels[0]}, {vessels[1]}: give limits of at least 3 with an odd number between them"
        )
    draw = Draw(n, secret or secrets.token_hex(16), names, tuple(networks), tuple(layouts), vessels)
    jobs, head = list(enumerate(draw.plan())), {"format": FORMAT, **vars(draw)}
    write_cases(folder, key, jobs, partial(draw_case, draw), head=head, cores=cores, done=done)
    return key


@dataclass
class StudyDiagnosis:
    """The diagnosis of a case that is a study's folder.

    Parameters
    ----------
    base : str
        Name of the baseline model.
    seed, effects, priors
        As in `zoo.blood.study_diagnosis.diagnose`.
    effects_from : sequence of path
        Python files that define effects, which every process runs; on every machine in the same place.
    """

    base: str = BASELINE
    seed: int = 1
    effects: Sequence[str] | None = None
    priors: Mapping[str, Any] | None = None
    effects_from: Sequence[str | Path] = ()
    marker: str = "study.toml"

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise BlindError(f"seed = {self.seed}: must be at least 0")
        self.base = get_baseline(self.base).name
        self.effects_from = [Path(path).resolve() for path in self.effects_from]  # workers are elsewhere

    def identity(self) -> dict[str, Any]:
        """What was asked, and of which program."""
        return {
            "base": self.base,
            "seed": self.seed,
            "effects": None if self.effects is None else list(self.effects),
            "priors": {name: str(one) for name, one in sorted((self.priors or {}).items())},
            "effects_from": [digests.of_bytes(Path(path).read_bytes()) for path in self.effects_from],
            "program": {**versions(), "solver": library_digest()},
        }

    def __call__(self, case: Path, answer: Path) -> Answer:
        """Diagnose the study, and write diagnosis.json."""
        for path in self.effects_from:
            add_effects(path)
        found = diagnose(
            load_study(case),
            self.base,
            effects=self.effects,
            priors=self.priors,
            cores=1,
            seed=self.seed,
            progress=False,
        )
        found.save(answer)
        return as_answer(found)


def diagnose_cases(
    cases: str | Path,
    answers: str | Path,
    *,
    cores: int = 2,
    executor: Executor | None = None,
    fresh: bool = False,
    done: Callable[[str], None] = lambda case: None,
    **asked: Any,
) -> Ran:
    """Diagnose every case of a folder, as `run_cases`.

    Parameters
    ----------
    cases : path
        Folder of studies.
    answers : path
        A folder for each case: answer.json, diagnosis.json (`Diagnosis.save`).
    cores, executor, fresh, done
        As in `zoo.core.blindcheck.folders.run_cases`.
    **asked
        Of `StudyDiagnosis`.

    Returns
    -------
    Ran

    Raises
    ------
    BlindError
        As `run_cases`.
    """
    settings: dict[str, Any] = {"cores": cores, "executor": executor, "fresh": fresh, "done": done}
    return run_cases(Path(cases), Path(answers), StudyDiagnosis(**asked), **settings)


def score_cases(answers: str | Path, key: str | Path, out: str | Path) -> Score:
    """Score answers against a key, and write score.json, cases.csv and score.md.

    Parameters
    ----------
    answers : path
        From `diagnose_cases`.
    key : path
        From `make_cases`.
    out : path
        Folder.

    Returns
    -------
    Score

    Raises
    ------
    BlindError
        If the key is not that of the cases, or an answer is about other data.
    """
    answers, out = Path(answers), Path(out)
    keys = read_sealed(Path(key), answers)
    output_folder(out, SCORE_FILES, deep=True)
    found, without_key = read_answers(answers, keys)
    score = score_answers(keys, found, by=BY, without_key=without_key)
    write_score(score, out)
    return score
