"""The posterior over sets of causes, as tables and in sentences."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from zoo.core.outputs import write_file
from zoo.report.words import percent

if TYPE_CHECKING:
    from zoo.core.diagnosis.sets import CauseSets

SET_FILES = ("sets.csv", "sensitivity.csv")
UNSURE = 3.0
"""Rms error of log evidence above which modes were missed, and the answer is not to be believed."""


def write_sets(sets: CauseSets, folder: Path) -> list[Path]:
    """Write sets.csv and sensitivity.csv into a folder; returns their paths."""
    texts = (sets.table().to_csv(index=False), sets.sensitivity().to_csv(index_label="prior"))
    return [write_file(folder / name, text) for name, text in zip(SET_FILES, texts, strict=True)]


def sets_summary(sets: CauseSets) -> list[str]:
    """What the posterior says, and first what makes it doubtful."""
    found = sets.posterior
    lines = ["", "one posterior over sets of causes (docs/causes.md)"]
    most = found.priors.most
    if most < len(found.priors.names) and len(found.number) > most and found.number[most] > 0.5:
        lines.append(
            f"more than {most} causes were not tried, and {most} are said to be there: do not believe it"
        )
    if sets.linear_error > UNSURE:
        lines.append(
            f"the linear model is off by {sets.linear_error:.1f} in log evidence, so that better sets may be "
            "unseen: do not believe it"
        )
    for which, p in list(found.probability.items())[:3]:
        lines.append(f"  {percent(p)} {sets.name(which)}")
    prior = found.priors.inclusion()
    wrong = sorted(found.components.items(), key=lambda item: -item[1])
    told = ", ".join(f"{name} {percent(p)} ({percent(prior[name])})" for name, p in wrong)
    lines.append(f"components that are wrong (before the data): {told}")
    return lines
