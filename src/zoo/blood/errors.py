"""Which errors a model of a study has: those of the paper's named set, or those that follow from the study."""

from __future__ import annotations

from zoo.blood.study import Study, StudyError
from zoo.core.errors.base import ErrorModel
from zoo.core.errors.gaussian_process import GaussianProcess
from zoo.core.errors.groups import GroupNoise, GroupProcess
from zoo.core.errors.independent import Independent

PAPER_SET = "paun2020"


def errors_for(study: Study, paper: ErrorModel) -> ErrorModel:
    """The errors of a model of the paper on a study.

    In the set of priors "paun2020" they are the paper's own. Elsewhere independent errors of one variance
    become `GroupNoise`, and the Gaussian process with fixed noise and amplitude becomes `GroupProcess`: a
    noise, and a process, for each quantity, with the study's `noise_sd` where that is given.

    Parameters
    ----------
    study : Study
    paper : ErrorModel
        `Independent` or `GaussianProcess`; another one is left as it is.

    Returns
    -------
    ErrorModel

    Raises
    ------
    StudyError
        If the paper's set is asked for a study with a `noise_sd`, or with several quantities.
    """
    if study.priors.get("set") == PAPER_SET:
        quantities = list(dict.fromkeys(s.quantity for s in study.series))
        for what, wrong in (("noise_sd", study.noise_sd), ("observations", quantities[1:])):
            if wrong:
                raise StudyError(
                    f"{study.source}: priors: set = {PAPER_SET!r}: has errors of its own for one quantity, but "
                    f"the study has {what} of {', '.join(study.noise_sd if what == 'noise_sd' else quantities)}; "
                    "leave out the set, or these"
                )
        return paper
    if isinstance(paper, Independent):
        return GroupNoise(known=study.noise_sd)
    if isinstance(paper, GaussianProcess):
        return GroupProcess(known=study.noise_sd)
    return paper
