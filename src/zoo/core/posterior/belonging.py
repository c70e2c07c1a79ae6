"""Whether a posterior was drawn from a model: of the same study, data, conventions and priors."""

from __future__ import annotations

from typing import Any

from zoo.core.arviz_lines import InferenceData
from zoo.core.inference.record import RunRecord
from zoo.core.words import short


def mismatch(idata: InferenceData, model: Any) -> str | None:
    """What a stored posterior has otherwise than a model, in words; or None.

    Parameters
    ----------
    idata : InferenceData
        With a run record.
    model : pm.Model
        With a record.

    Returns
    -------
    str or None
        The first of: the model's name, the study, the checksum of its data, a switch of the conventions, a
        numerical setting of the solver that is no mere limit (its name does not begin with "max_"), a prior
        or known noise, also one that only one of them has. A run so old that it has recorded no priors at
        all passes in these, and one without a numerical setting in that setting.

    Raises
    ------
    ResultsError
        If there is no run record.
    """
    record, ours = RunRecord.of(idata), model.zoo
    source = ours.study or ours.data
    conventions = ours.settings.get("conventions", {})
    pairs = [
        ("model", record.model, ours.name),
        ("study", record.study, source.name),
        ("checksum of the study", record.study_checksum, source.checksum),
        ("conventions", record.conventions.get("name", ""), conventions.get("name", "")),
    ]
    mine = ours.settings.get("solver options", {})
    shaping = [n for n in mine if n in record.solver and n != "grid" and not n.startswith("max_")]
    pairs += [(n, _setting(record.solver[n]), _setting(mine[n])) for n in shaping]
    if record.priors is not None:
        both = dict.fromkeys([*ours.priors, *record.priors])
        pairs += [(_of_prior(n), record.priors.get(n, "none"), ours.priors.get(n, "none")) for n in both]
    return next((f"{what} is {a}, here it is {b}" for what, a, b in pairs if a != b), None)


def _setting(value: Any) -> str:
    return short(list(value) if isinstance(value, tuple) else value)


def _of_prior(name: str) -> str:
    """What a record's prior is called; a known noise has a name in words."""
    return name if " of " in name else f"prior of {name}"
