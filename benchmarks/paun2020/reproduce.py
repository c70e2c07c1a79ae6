"""Table 4 again: the nine models on the measured mouse, and figures of the paper."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
from benchmarks.paun2020.figures import posteriors_figure, uncertainty_figure
from benchmarks.paun2020.table4 import (
    REFERENCE,
    cost_table,
    disagreements,
    markdown,
    numbers,
    parameter_table,
    score_table,
    table4_rows,
)
from benchmarks.paun2020.truth import THETA

from zoo import plots
from zoo.blood import predictive
from zoo.blood.prior_tables import PAPER_SET
from zoo.core.arviz_lines import InferenceData
from zoo.core.inference.convergence import diagnostics
from zoo.core.inference.record import RunRecord
from zoo.core.outputs import write_file
from zoo.core.posterior.comparison import compare
from zoo.core.posterior.files import PosteriorError, matching, sample_to
from zoo.core.surrogate.library import Library
from zoo.models import PAPER, get_model

if TYPE_CHECKING:
    import pymc as pm

    from zoo.blood.study import Study


def reproduce(
    study: Study,
    folder: Path,
    names: Sequence[str] = PAPER,
    *,
    figures: bool = True,
    say: Callable[[str], None] = print,
    **settings: Any,
) -> str:
    """Sample the models on a study, score them, and set the results beside Table 4.

    Everything goes to `folder`: X.nc for each model, table4.csv, scores.csv, costs.csv, comparison.csv,
    table4.md and figures/.

    Parameters
    ----------
    study : Study
        The measured mouse, or another one (then the published columns are only for orientation). Whatever
        its priors and noise are, the paper's are taken.
    folder : Path
        Posteriors that it holds are taken, interrupted runs go on.
    names : sequence of str
        Letters of models.
    figures : bool
        Draw figures 4, 5, 6, 8 and 9, as far as the models are there.
    say : callable
        Told what was done, one line each.
    **settings
        Of `zoo.sample`.

    Returns
    -------
    str
        What table4.md holds.

    Raises
    ------
    zoo.core.posterior.files.PosteriorError
        If a posterior there was drawn with another seed.
    """
    study = replace(study, priors={"set": PAPER_SET}, noise_sd={})
    posteriors, models = nine_posteriors(study, folder, names, say=say, **settings)
    comparison = compare(posteriors, models)
    parameters, scores, costs = (
        parameter_table(posteriors), score_table(comparison), cost_table(posteriors)
    )  # fmt: skip
    tables = {"table4": parameters.set_index("model"), "scores": scores, "costs": costs}
    for name, table in {**tables, "comparison": comparison}.items():
        write_file(folder / f"{name}.csv", table.to_csv())
    text = _text(parameters, scores, costs)
    write_file(folder / "table4.md", text)
    if figures:
        _figures(study, posteriors, models, folder / "figures")
    return text


def nine_posteriors(
    study: Study,
    folder: Path,
    names: Sequence[str] = PAPER,
    *,
    say: Callable[[str], None] = print,
    **settings: Any,
) -> tuple[dict[str, InferenceData], dict[str, pm.Model]]:
    """Posteriors by letter, those in `folder` and the others sampled into it, and the models."""
    folder.mkdir(parents=True, exist_ok=True)
    posteriors, models = {}, {}
    libraries: dict[str, Library] = {}
    for name in names:
        models[name] = get_model(name)(study)
        path = folder / f"{name}.nc"
        stored = matching(path, models[name])
        if stored is not None:
            if (seed := RunRecord.of(stored).seed) != settings["seed"]:
                raise PosteriorError(
                    f"{path}: drawn with seed {seed}, here it is {settings['seed']}; move it"
                )
            posteriors[name] = stored
            found = diagnostics(stored).verdict
            lacks = "" if found.passes else f", not converged (R-hat {found.max_rhat:.3f})"
            say(f"model {name}: posterior of {path}, {found.chains} chains of {found.draws} draws{lacks}")
        else:
            forward = models[name].zoo.forward  # models of one forward model share its solves
            more: dict[str, Any] = {"library": libraries.setdefault(forward.key, Library(forward))}
            if (name, study.name) == ("F", "mouse-c6"):  # a search from the prior does not find it
                more["start"] = numbers()["mode_of_f"]
            posteriors[name] = sample_to(path, models[name], **more, **settings)
            say(f"model {name}: sampled, wrote {path}")
    return posteriors, models


def _text(parameters: pd.DataFrame, scores: pd.DataFrame, costs: pd.DataFrame) -> str:
    """Table 4 and the costs as pipe tables, how many cells agree, and why others do not."""
    shown = costs.reset_index().map(lambda x: f"{x:.4g}" if isinstance(x, float) else str(x))
    lines = [f"parameters: {parameters['agrees'].sum()} of {len(parameters)} cells agree with Table 4"]
    if "agrees" in scores.columns:
        others = scores["agrees"].astype(bool).drop(REFERENCE)
        lines.append(f"differences of WAIC from model B: {others.sum()} of {len(others)} agree")
    lines += disagreements(parameters, scores)
    tables = markdown(*table4_rows(parameters, scores)), markdown(list(shown), shown.to_numpy().tolist())
    return "\n".join([*tables, *(f"- {line}" for line in lines), ""])


def _figures(
    study: Study, posteriors: Mapping[str, InferenceData], models: Mapping[str, pm.Model], folder: Path
) -> None:
    folder.mkdir(exist_ok=True)
    medians, pressures, at_medians = {}, {}, {}
    for name, idata in posteriors.items():
        waves = predictive.vessel_waves(models[name], idata)
        medians[name] = predictive.median_waves(waves)
        one = predictive.one_place(waves)
        pressures[name] = predictive.bands(one, "pressure_mmHg", (0.95,), errors=True)
        at_medians[name] = predictive.waves_at_medians(models[name], idata)
    some = [name for name in ("A", "B", "I") if name in posteriors] or list(posteriors)[:3]
    drawn = {
        "figure5": uncertainty_figure({name: pressures[name] for name in some}, study),
        "figure8": plots.models_figure(medians, study),
        "figure9-flow": plots.models_figure(medians, study, quantity="flow_ml_s"),
        "figure9-loops": plots.loops_figure(at_medians),
    }
    if {"A", "B"} <= set(posteriors):
        both = {name: posteriors[name] for name in ("A", "B")}
        drawn["figure4a"] = posteriors_figure(both, ("f3", "psi1", "psi2", "c"))
    if "E" in posteriors:
        drawn["figure6-left"] = plots.pair_figure(posteriors["E"], THETA)
    for name, figure in drawn.items():
        plots.save_figure(figure, folder / f"{name}.png")
