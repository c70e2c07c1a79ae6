"""Paun et al. 2020 again: the nine models on the measured mouse, beside the published Table 4."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from zoo.blood.prior_tables import PAPER_SET
from zoo.core.inference.convergence import judged
from zoo.core.outputs import write_file
from zoo.core.posterior.files import matching, refuse_other_settings, sample_to
from zoo.core.surrogate.library import Library
from zoo.models import PAPER, get_model
from zoo.paper.modes_of_f import start_of
from zoo.paper.table4 import (
    REFERENCE,
    cost_table,
    disagreements,
    markdown,
    parameter_table,
    score_table,
    table4_rows,
)

if TYPE_CHECKING:
    import arviz as az
    import pymc as pm

    from zoo.blood.study import Study


def nine_posteriors(
    study: Study,
    folder: Path,
    names: Sequence[str] = PAPER,
    *,
    say: Callable[[str], None] = lambda text: None,
    **settings: Any,
) -> tuple[dict[str, az.InferenceData], dict[str, pm.Model]]:
    """Posteriors of models on a study: those in `folder`, the others sampled into it.

    Parameters
    ----------
    study : Study
    folder : Path
        Holds X.nc for each model X that is done, and the checkpoint of one that is not.
    names : sequence of str
        Letters of models.
    say : callable
        Told what is read and what was sampled, one line each.
    **settings
        Of `zoo.sample`.

    Returns
    -------
    posteriors, models : dict
        By letter.

    Raises
    ------
    zoo.core.posterior.files.PosteriorError
        If a posterior there was drawn with another seed or other settings.
    """
    folder.mkdir(parents=True, exist_ok=True)
    posteriors, models = {}, {}
    libraries: dict[str, Library] = {}
    for name in names:
        models[name] = get_model(name)(study)
        path = folder / f"{name}.nc"
        stored = matching(path, models[name])
        if stored is not None:
            refuse_other_settings(path, stored, settings)
            posteriors[name] = stored
            found = judged(stored)
            lacks = "" if found.passes else f", not converged (R-hat {found.max_rhat:.3f})"
            say(f"model {name}: posterior of {path}, {found.chains} chains of {found.draws} draws{lacks}")
        else:
            forward = models[name].zoo.forward  # models of one forward model share its solves
            shared = libraries.setdefault(forward.key, Library(forward))
            more: dict[str, Any] = {"library": shared, **settings}
            if (begin := start_of(name, study)) is not None:
                more.setdefault("start", begin)
            posteriors[name] = sample_to(path, models[name], **more)
            say(f"model {name}: sampled, wrote {path}")
    return posteriors, models


@dataclass(frozen=True)
class Reproduction:
    """What `reproduce` found: Table 4 in three parts, and the ranking with the pointwise decompositions."""

    parameters: pd.DataFrame
    scores: pd.DataFrame
    costs: pd.DataFrame
    comparison: pd.DataFrame

    def lines(self) -> list[str]:
        """Agreement in words: how many cells agree, and each that does not with its reason."""
        cells = self.parameters["agrees"]
        lines = [f"parameters: {int(cells.sum())} of {len(cells)} cells agree with Table 4"]
        if "agrees" in self.scores.columns:
            right = self.scores["agrees"].astype(bool).drop(REFERENCE)
            lines.append(f"differences of WAIC from model B: {int(right.sum())} of {len(right)} agree")
        return [*lines, *disagreements(self.parameters, self.scores)]

    def markdown(self) -> str:
        """Table 4 and the costs as pipe tables."""
        costs = self.costs.reset_index()
        rows = [[_short(value) for value in row] for row in costs.itertuples(index=False)]
        parts = [markdown(*table4_rows(self.parameters, self.scores)), markdown(list(costs.columns), rows)]
        return "\n".join([*parts, *(f"- {line}" for line in self.lines()), ""])


def _short(value: Any) -> str:
    if value is None or value is pd.NA or (isinstance(value, float) and np.isnan(value)):
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def reproduce(
    study: Study,
    folder: Path,
    names: Sequence[str] = PAPER,
    *,
    figures: bool = True,
    say: Callable[[str], None] = lambda text: None,
    **settings: Any,
) -> Reproduction:
    """Sample the models on a study, score them, and set the results beside Table 4.

    Everything goes to `folder`: X.nc for each model, table4.csv, scores.csv, costs.csv, comparison.csv,
    table4.md, interval-widths.csv and, in figures/, the figures of the paper.

    Parameters
    ----------
    study : Study
        The measured mouse, or another one (then the published columns are only for orientation). Whatever
        its priors and noise are, the paper's are taken.
    folder : Path
        Posteriors that it holds are taken, checkpoints resumed.
    names : sequence of str
        Letters of models.
    figures : bool
        Draw figures 4 to 9.
    say : callable
        Told what was done, one line each.
    **settings
        Of `zoo.sample`.

    Returns
    -------
    Reproduction
    """
    from zoo.core.posterior.comparison import compare

    study = replace(study, priors={"set": PAPER_SET}, noise_sd={})
    posteriors, models = nine_posteriors(study, folder, names, say=say, **settings)
    comparison = compare(posteriors, models)
    found = Reproduction(
        parameter_table(posteriors), score_table(comparison), cost_table(posteriors), comparison
    )
    write_file(folder / "table4.csv", found.parameters.to_csv(index=False))
    for name, table in (("scores", found.scores), ("costs", found.costs), ("comparison", comparison)):
        write_file(folder / f"{name}.csv", table.to_csv())
    write_file(folder / "table4.md", found.markdown())
    if figures:
        paper_figures(study, posteriors, models, found, folder, say=say)
    return found


def paper_figures(
    study: Study,
    posteriors: Mapping[str, az.InferenceData],
    models: Mapping[str, pm.Model],
    found: Reproduction,
    folder: Path,
    *,
    say: Callable[[str], None] = lambda text: None,
) -> None:
    """Figures 4 to 9 of the paper, from the models that are there, and the widths of its table S1."""
    from zoo import plots
    from zoo.blood import predictive

    place = folder / "figures"
    place.mkdir(exist_ok=True)

    def save(figure: Any, name: str) -> None:
        plots.save_figure(figure, place / f"{name}.png")

    save(plots.intervals_figure(found.parameters), "table4-intervals")
    save(plots.comparison_figure(found.comparison), "comparison")
    medians, pressures, at_medians, widths = {}, {}, {}, {}
    for name, idata in posteriors.items():
        waves = predictive.vessel_waves(models[name], idata)
        widths[name] = predictive.interval_widths(waves)
        one = predictive.one_place(waves)
        medians[name] = predictive.median_waves(waves)
        pressures[name] = predictive.bands(one, "pressure_mmHg", (0.95,), errors=True)
        at_medians[name] = predictive.waves_at_medians(models[name], idata)
        for quantity in ("pressure_mmHg", "flow_ml_s"):
            shown = (
                pressures[name] if quantity == "pressure_mmHg" else predictive.bands(one, quantity, (0.95,))
            )
            title = f"model {name}, {quantity.split('_')[0]}"
            save(plots.all_vessels_figure(shown, study, title=title), f"all-{quantity.split('_')[0]}-{name}")
        save(plots.trace_figure(idata, list(models[name].zoo.parameters)), f"trace-{name}")
        save(plots.rank_figure(idata, list(models[name].zoo.parameters)), f"rank-{name}")
        say(f"model {name}: waves in all vessels")
    every = [int(v) for v in next(iter(at_medians.values()))["vessel"].to_numpy()]
    write_file(folder / "interval-widths.csv", pd.concat(widths, names=["model", "vessel"]).to_csv())
    if {"A", "B"} <= set(posteriors):
        names = ("f3", "psi1", "psi2", "c")
        save(plots.posteriors_figure({m: posteriors[m] for m in ("A", "B")}, names), "figure4a")
    for name in {"B", "I"} & set(posteriors):
        shown = predictive.with_stiffness(models[name], posteriors[name])
        save(plots.posteriors_figure({name: shown}), f"figure4b-{name}")
    some = [name for name in ("A", "B", "I") if name in posteriors] or list(posteriors)[:3]
    save(plots.uncertainty_figure({name: pressures[name] for name in some}, study), "figure5")
    if "E" in posteriors:
        save(plots.pair_figure(posteriors["E"], ["f1", "f2", "f3", "psi1", "psi2", "c"]), "figure6-left")
    own = {name: predictive.stiffness_draws(models[name], posteriors[name]) for name in posteriors}
    save(plots.stiffness_figure({n: d for n, d in own.items() if n == "G"} or own), "figure6-right")
    estimate = float(posteriors["B"]["posterior"]["f3"].median()) if "B" in posteriors else None
    curve = predictive.pressure_against_stiffness(study)
    write_file(folder / "figure7.csv", curve.to_csv(index=False))
    save(plots.pressure_stiffness_figure(curve, estimate), "figure7")
    save(plots.models_figure(medians, study), "figure8")
    save(plots.models_figure(medians, study, quantity="flow_ml_s"), "figure9-flow")
    save(plots.loops_figure(at_medians), "figure9-loops")
    save(plots.loops_figure(at_medians, vessels=every), "loops-all-vessels")
    save(plots.loops_figure(at_medians, vessels=every, standardised=True), "loops-all-vessels-standardised")
