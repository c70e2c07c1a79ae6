"""Scoring the answers about cases against their key."""

from __future__ import annotations

import math
from pathlib import Path

from zoo.blood.blind.keys import read_key
from zoo.blood.blind.run import read_case_facts, read_fitted
from zoo.blood.components import component_of
from zoo.blood.effects import CATALOGUE
from zoo.core.blindcheck.answers import Answer, as_answer
from zoo.core.blindcheck.check_score import CheckScore, score_answers
from zoo.core.blindcheck.running import read_answers
from zoo.core.blindcheck.sealing import BlindError
from zoo.core.blindcheck.tables import SCORE_FILES, write_score
from zoo.core.diagnosis import read_diagnosis
from zoo.core.outputs import output_folder

BY = ("kind", "layout", "series", "effect", "gap", "network")
GAP_EDGES = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8, math.inf)
"""Of the bins of model discrepancy, mmHg."""


def read_answer(folder: Path) -> Answer:
    """The answer that a folder of `diagnose_cases` holds, with the tree of its vessels."""
    found, facts = read_diagnosis(folder), read_case_facts(folder)
    if facts["checksum"] != found.study_checksum:
        raise BlindError(f"{folder / 'case.json'}: is of another case; make it again with `zoo blind run`")
    fitted = read_fitted(folder, found.study_checksum)
    belongs = {name: component_of(effect) for name, effect in CATALOGUE.items()}
    return as_answer(found, facts["parents"], fitted, belongs)


def score_cases(answers: str | Path, key: str | Path, out: str | Path) -> CheckScore:
    """Score answers against a key, and write score.json, cases.csv and score.md.

    Parameters
    ----------
    answers : path
        From `diagnose_cases`.
    key : path
        From `make_cases`; or a folder with keys that were made elsewhere, a file for each case.
    out : path
        Folder.

    Returns
    -------
    CheckScore

    Raises
    ------
    BlindError
        If the key is not that of the cases, or an answer is about other data.
    """
    answers, out = Path(answers), Path(out)
    if not answers.is_dir():
        raise BlindError(f"{answers}: no such folder; give the answers of `zoo blind run`")
    keys, checked = read_key(key, answers)
    output_folder(out, SCORE_FILES, deep=True)
    found, without_key = read_answers(answers, keys, read_answer, result="diagnosis.json")
    score = score_answers(
        keys, found, by=BY, gap_edges=GAP_EDGES, key_checked=checked, without_key=without_key
    )
    write_score(score, out)
    return score
