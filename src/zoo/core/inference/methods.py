"""Which way a posterior is sampled: with the forward model alone, with its derivatives, or by a surrogate."""

from __future__ import annotations

import contextlib
import inspect
import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zoo.core.arviz_lines import InferenceData
from zoo.core.forward import SolveError
from zoo.core.inference.checkpoint import Folder
from zoo.core.inference.logposterior import LogPosterior, SamplingError, model_name
from zoo.core.inference.mode import has_many
from zoo.core.inference.sampling import check_settings, has_gradient
from zoo.core.inference.sampling import sample as sample_exact
from zoo.core.inference.surrogate_sampling import sample_surrogate
from zoo.core.joint import JointRecord
from zoo.core.model import ModelError, ModelRecord, record_of, theta_of
from zoo.core.surrogate.likelihood import no_table
from zoo.core.surrogate.surrogate_model import errors_in_graph
from zoo.core.surrogate.waveform import SurrogateError

METHODS = ("auto", "exact", "nuts", "surrogate")
FEW = 8
"""Dimensions up to which chains with the forward model itself are as quick as a surrogate."""
SLOW = 0.05
"""Seconds of a solve from which on a surrogate is quicker with as few dimensions, too."""
MOST = 60
"""Coordinates of the solves above which a surrogate needs too many of them."""
ONLY_EXACT: dict[str, tuple[Any, ...]] = {
    "thin": (None,),
    "step_options": (None, {}),
    "executor": (None,),
}
"""Settings that other methods have no use for (but NUTS for an executor), with those that ask for nothing."""


def choose(model: Any, method: str = "auto", *, checkpoint: str | Path | None = None) -> tuple[str, str]:
    """The method of a model, and why.

    Parameters
    ----------
    model : pm.Model
    method : {"auto", "exact", "nuts", "surrogate"}
        "exact": DEMetropolisZ with the forward model, no derivatives. "nuts": NUTS with the forward model's
        own derivatives. "surrogate": NUTS on a surrogate, corrected with the forward model.
    checkpoint : path, optional
        A run that is there goes on as it began.

    Returns
    -------
    method, reason : str

    Raises
    ------
    SamplingError
        If there is no such method, or it cannot be had.
    """
    if method not in METHODS:
        raise SamplingError(f"method = {method!r}: must be one of {', '.join(METHODS)}")
    if method != "auto":
        if method == "nuts" and not has_gradient(model):
            raise SamplingError(
                f"method = 'nuts': model {model_name(model)} has no gradient, for its forward model or its "
                "errors offer none; use method surrogate or exact"
            )
        if method == "surrogate" and (why := _no_surrogate(model)):
            raise SamplingError(f"method = 'surrogate': {why}; use method exact")
        return method, "as asked"
    if checkpoint is not None and (there := _begun(Path(checkpoint))):
        return there, "a checkpoint of such a run is there"
    if why := _no_surrogate(model):
        return "exact", why
    logp = LogPosterior(model)
    d = len(logp.template.data)
    corrected = "each stored draw is corrected with the forward model"
    if d > FEW:
        return "surrogate", f"{d} dimensions; {corrected}"
    if (seconds := _seconds(logp)) > SLOW:
        return "surrogate", f"a solve takes {seconds:.2g} s; {corrected}"
    return "exact", f"with {d} dimensions it is as quick as a surrogate"


def _begun(folder: Path) -> str:
    """Method of the run that a checkpoint folder holds; empty if there is none."""
    try:
        step = json.loads((folder / "run.json").read_bytes()).get("identity", {}).get("step")
    except FileNotFoundError:
        return ""
    except (OSError, ValueError, AttributeError, RecursionError):
        return "exact"  # which says what is wrong with it
    return str(step) if step in ("nuts", "surrogate") else "exact"


def _seconds(logp: LogPosterior) -> float:
    """What a solve takes where a model begins: the shorter time of two."""
    record = record_of(logp.model)
    forward = record.forward
    begin = logp.from_values(record.suggested) if record.suggested else logp.vector(logp.initial)
    values = logp.to_values(begin)
    (theta,) = theta_of(record, {name: value[None] for name, value in values.items()})
    took = []
    for _ in range(2):
        began = time.perf_counter()
        with contextlib.suppress(SolveError):
            forward.solve(forward.configure(theta))
        took.append(time.perf_counter() - began)
    return min(took)


def _no_surrogate(model: Any) -> str:
    """Why a model cannot have a surrogate; empty if it can."""
    if isinstance(getattr(model, "zoo", None), JointRecord):
        return "a model of several subjects has no surrogate"
    try:
        record: ModelRecord = record_of(model)
    except ModelError as error:
        return str(error)
    n = sum(p.size for p in record.forward.parameters if not p.hyper)
    if n > MOST:
        return f"{n} parameters of the solves are more than a surrogate takes ({MOST})"
    if not errors_in_graph(record):
        return no_table(record.errors)
    if has_many(LogPosterior(model)):
        return "many parameters under independent errors have a bent posterior, beside which a design lies"
    return ""


def sample(
    model: Any,
    *,
    method: str = "exact",
    checkpoint: str | Path | None = None,
    fresh: bool = False,
    **settings: Any,
) -> InferenceData:
    """Sample a posterior by one of `METHODS`.

    Parameters
    ----------
    model : pm.Model
    method : str
        Of `choose`; what "auto" takes is printed with the reason. Where it takes a surrogate that cannot be
        made or does not serve, the forward model is sampled instead.
    checkpoint : path, optional
        Folder of the run, which goes on from there; of a surrogate it holds the solves.
    fresh : bool
        Remove what the folder holds of a run, once nothing speaks against this one.
    **settings
        Of `zoo.core.inference.sampling.sample` or `zoo.core.inference.surrogate_sampling.sample_surrogate`.

    Raises
    ------
    SamplingError
        If the method cannot be had, or has no use for a setting.
    """
    known = inspect.signature(check_settings).parameters
    check_settings(**{name: value for name, value in settings.items() if name in known})
    asked = {n: v for n, v in settings.items() if n in ONLY_EXACT and v not in ONLY_EXACT[n]}
    taken, reason = choose(model, method, checkpoint=None if fresh else checkpoint)
    begun = not fresh and checkpoint is not None and _begun(Path(checkpoint))
    if method == "auto" and asked and not begun:
        taken, reason = "exact", f"{next(iter(asked))} is a setting of it"
    if taken == "nuts":
        asked.pop("executor", None)
    for name, value in asked.items() if taken != "exact" else ():
        raise SamplingError(
            f"{name} = {value}: method {taken} has no use for it; leave it out, or use method exact"
        )
    if fresh and checkpoint is not None and Path(checkpoint).is_dir():
        Folder(Path(checkpoint)).remove()  # refused while another run holds it
    words = f"model {model_name(model)}: method {taken}: {reason}" if method == "auto" else ""
    if taken == "exact":
        return sample_exact(model, checkpoint=checkpoint, preface=words, **_without(settings, "library"))
    if words and settings.get("progress", True):
        print(words, file=sys.stderr)
    if taken == "nuts":
        own = _without(settings, "thin", "step_options", "library")
        return sample_exact(model, nuts=True, checkpoint=checkpoint, **own)
    try:
        return sample_surrogate(model, checkpoint=checkpoint, **_without(settings, *ONLY_EXACT))
    except SurrogateError as error:
        if method != "auto":
            raise
        words = f"{error}\nmodel {model_name(model)}: method exact, for there is no surrogate that serves"
        if checkpoint is not None:
            Folder(Path(checkpoint)).remove()  # chains have no use for a surrogate's solves
        return sample_exact(model, checkpoint=checkpoint, preface=words, **_without(settings, "library"))


def _without(settings: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in settings.items() if name not in names}
