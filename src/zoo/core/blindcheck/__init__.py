"""The blind check: a diagnosis is given data whose cause is withheld, and its answers are scored.

`check` does all of it in memory for any simulator: draw cases, diagnose them, score the answers. Cases that
are folders are made by `making`, diagnosed by `running` and tied to their key by `sealing`; how an answer is
scored is the same.
"""

from zoo.core.blindcheck.answers import Answer, Explanation, as_answer
from zoo.core.blindcheck.check import DrawnCase, check, draw_cases
from zoo.core.blindcheck.check_score import CheckScore, score_answers
from zoo.core.blindcheck.keys import CaseKey, TrueEffect
from zoo.core.blindcheck.sealing import BlindError
from zoo.core.blindcheck.tables import score_table, write_score

__all__ = [
    "Answer",
    "BlindError",
    "CaseKey",
    "CheckScore",
    "DrawnCase",
    "Explanation",
    "TrueEffect",
    "as_answer",
    "check",
    "draw_cases",
    "score_answers",
    "score_table",
    "write_score",
]
