"""One posterior over sets of causes: what a simulator may lack, given a discrepancy and noise."""

from zoo.core.causes.family import ErrorFamily
from zoo.core.causes.posterior import CausePosterior, SetRow
from zoo.core.causes.problem import Cause, CauseError, Problem
from zoo.core.causes.set_priors import CausePriors
from zoo.core.causes.weigh import weigh_causes

__all__ = [
    "Cause",
    "CauseError",
    "CausePosterior",
    "CausePriors",
    "ErrorFamily",
    "Problem",
    "SetRow",
    "weigh_causes",
]
