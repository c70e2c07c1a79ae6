"""Whether a posterior was drawn from a model: of the same study, data, conventions and priors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from zoo.core.inference.record import RunRecord

if TYPE_CHECKING:
    import arviz as az


def mismatch(idata: az.InferenceData, model: Any) -> str | None:
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
        prior. Priors that an older run has not recorded are not looked at.

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
    known = record.priors or {}
    pairs += [(f"prior of {n}", known[n], prior) for n, prior in ours.priors.items() if n in known]
    return next((f"{what} is {a}, here it is {b}" for what, a, b in pairs if a != b), None)
