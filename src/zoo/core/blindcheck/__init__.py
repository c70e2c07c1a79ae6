"""The blind check: a diagnosis is given data whose cause is withheld, and its answers are scored.

`blind_check` does all of it in memory for any simulator; `ModelDraw` draws cases of any forward model. Cases
that are folders, with a sealed key, are in `folders`; how an answer is scored is the same.
"""

from zoo.core.blindcheck.cases import NULL, Answer, BlindError, CaseKey, Fitted, Group, Size, as_answer
from zoo.core.blindcheck.drawing import DrawnCase, LinearBaseline, ModelDraw
from zoo.core.blindcheck.score_tables import paired_table, score_table, write_score
from zoo.core.blindcheck.scoring import Score, paired, score_answers
from zoo.core.blindcheck.validation import blind_check, draw_cases
