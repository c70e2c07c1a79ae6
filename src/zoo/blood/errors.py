"""Which errors a model of a study has: those of the paper's named set, or what follows from the study."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from zoo.blood.prior_tables import PAPER_SET as PAPER_SET
from zoo.blood.study import Study, StudyError
from zoo.core.errors.base import ErrorModel
from zoo.core.errors.gaussian_process import GaussianProcess
from zoo.core.errors.groups import GroupNoise, GroupProcess
from zoo.core.errors.independent import Independent
from zoo.core.errors.student import GroupStudent


def by_prior_set(paper: ErrorModel) -> Callable[[Study], ErrorModel]:
    """Make the function from a study to its errors: these in the set "paun2020", else those of any study."""
    return partial(errors_for, paper=paper)


def errors_named(errors: str | ErrorModel) -> ErrorModel | Callable[[Study], ErrorModel]:
    """Errors of a name, or those that are given themselves.

    Parameters
    ----------
    errors : {"student-t"} or ErrorModel

    Returns
    -------
    ErrorModel, or function of a study

    Raises
    ------
    StudyError
        If there are none of that name.
    """
    if isinstance(errors, ErrorModel):
        return errors
    if errors != "student-t":
        raise StudyError(f"errors = {errors!r}: must be student-t; leave it out for the model's own")
    return lambda study: GroupStudent(known=study.noise_sd)


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
        where = f"{study.source}: priors: set = {PAPER_SET!r}"
        quantities = list(dict.fromkeys(s.quantity for s in study.series))
        if len(quantities) > 1:
            raise StudyError(
                f"{where}: its errors are of one quantity, the study observes {' and '.join(quantities)}; "
                "leave out the set, or the series of all but one"
            )
        if study.noise_sd:
            raise StudyError(
                f"{where}: has a noise of its own, but noise_sd gives that of {', '.join(study.noise_sd)}; "
                "leave out one of them"
            )
        return paper
    if isinstance(paper, Independent):
        return GroupNoise(known=study.noise_sd)
    if isinstance(paper, GaussianProcess):
        return GroupProcess(known=study.noise_sd)
    return paper
