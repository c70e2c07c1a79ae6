"""The blind check of the diagnosis: studies whose effect is withheld, diagnosed and scored.

`make_cases` writes studies, each with an effect that its files do not tell, and the key apart;
`diagnose_cases` diagnoses them and sees no key; `score_cases` compares. docs/blind.md says how cases are
drawn and what each score means.
"""

from zoo.blood.blind.make import make_cases
from zoo.blood.blind.run import diagnose_cases
from zoo.blood.blind.score import score_cases
from zoo.core.blindcheck.sealing import BlindError

__all__ = ["BlindError", "diagnose_cases", "make_cases", "score_cases"]
