"""Tables of the documents, in Markdown: the catalogue of effects, how large each is, the free functions.

python docs/tables.py effects|signatures|components
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zoo import load_study
from zoo.blood.baseline import get_baseline
from zoo.blood.components import components
from zoo.blood.components.plausibility import LIMITS, amount
from zoo.blood.effects.catalogue import CATALOGUE
from zoo.blood.forward import BloodFlow, study_data
from zoo.core.components import FreeFunction
from zoo.core.effects import Effect, Location
from zoo.core.forward import Outputs, SolveError
from zoo.core.parameters import pack, start_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Signature:
    """What one effect does to the pressure at the root's inlet, at its prior's scale.

    Parameters
    ----------
    effect : str
    location : Location
        That of the largest change.
    values : tuple of float
        Of the effect's parameters; the first halved where the solve failed.
    mean_mmHg, rms_mmHg, largest_mmHg : float
        Of the change over the beat.
    left_mmHg : float
        Root mean square of what no small change of the baseline's parameters can imitate.
    """

    effect: str
    location: Location
    values: tuple[float, ...]
    mean_mmHg: float
    rms_mmHg: float
    largest_mmHg: float
    left_mmHg: float


def typical_values(made: Effect) -> tuple[float, ...]:
    """An effect's parameters at the scale of their priors, shapes at their centre."""
    return tuple(min(max(p.scale, p.low), p.high) if p.zero_is_base else p.centre for p in made.parameters)


def signatures(model: BloodFlow, *, n_times: int = 256) -> list[Signature]:
    """Size of every effect in a study's network, at the start of a baseline's parameters.

    Parameters
    ----------
    model : BloodFlow
        Such as ``get_baseline("B").forward(study)``.
    n_times : int
        Samples of the beat.

    Returns
    -------
    list of Signature
        For each effect that the baseline can take and a solve can show.

    Raises
    ------
    SolveError
        If the baseline's own solve fails.
    """
    period = model.network.period_s
    root = int(model.network.ids[int(np.argmin(model.network.parent))])
    times = np.asarray(np.arange(n_times) * (period / n_times), dtype=np.float64)
    outputs = Outputs(((root, 0.0, "pressure_mmHg"),), times)
    start = pack(model.parameters, start_of(model.parameters))
    case = model.configure(start)
    plain = model.solve(case, outputs)[0]
    columns = []
    for step in np.diag(1e-3 * start):
        up, down = (model.solve(model.configure(theta), outputs)[0] for theta in (start + step, start - step))
        columns.append((up - down) / 2e-3)
    directions = np.linalg.qr(np.array(columns).T)[0]

    rows = []
    for made in CATALOGUE.values():
        if made.apply is None or not made.offered(model.name):
            continue
        found = []
        for location in made.locations(model):
            values, changed = typical_values(made.of(model)), np.full(n_times, np.nan)
            for _ in range(6):
                try:
                    changed = model.solve(made.apply(case, values, location), outputs)[0]
                    break
                except SolveError:
                    values = (values[0] / 2, *values[1:])
            change = changed - plain
            left = change - directions @ (directions.T @ change)
            rms, rest = (float(np.sqrt(np.mean(x**2))) for x in (change, left))
            mean, largest = float(change.mean()), float(np.abs(change).max())
            found.append(Signature(made.name, location, values, mean, rms, largest, rest))
        rows.append(max(found, key=lambda row: -1.0 if math.isnan(row.rms_mmHg) else row.rms_mmHg))
    return rows


def signature_table(model: BloodFlow) -> str:
    """`signatures` as a table in Markdown."""
    lines = [
        "| effect | location | parameters | mean change | rms change | rms left of it by the baseline's |",
        "|---|---|---|---|---|---|",
    ]
    for row in signatures(model):
        values = ", ".join(
            f"{value:.3g} {p.unit}".removesuffix(" 1")
            for value, p in zip(row.values, CATALOGUE[row.effect].parameters, strict=True)
        )
        numbers = f"{row.mean_mmHg:+.2f} | {row.rms_mmHg:.2f} | {row.left_mmHg:.3f}"
        lines.append(f"| `{row.effect}` | {row.location} | {values} | {numbers} |")
    return "\n".join(lines)


def catalogue_table() -> str:
    """The catalogue as a table in Markdown, a row for each parameter."""

    def cell(text: str) -> str:
        return text.replace("|", "\\|")

    lines = [
        "| effect | family | what | equation | parameter | prior | why | what it does to a beat | source |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for made in CATALOGUE.values():
        for k, parameter in enumerate(made.parameters):
            what = (made.statement, f"`{cell(made.equation)}`") if k == 0 else ("", "")
            rest = (made.signature, made.source) if k == 0 else ("", "")
            name = f"`{made.name}`" if k == 0 else ""
            kind = made.family if k == 0 else ""
            cells = (name, kind, *what, parameter.name, parameter.text, parameter.why, *rest)
            lines.append("| " + " | ".join(cell(c) if not c.startswith("`") else c for c in cells) + " |")
    return "\n".join(lines)


def component_table(functions: Iterable[FreeFunction]) -> str:
    """A row for each function: its equation, argument, prior size and source, and what is believed.

    Parameters
    ----------
    functions : iterable of FreeFunction
        Such as ``components(model, theta, data)``.

    Returns
    -------
    str
    """
    lines = [
        "| component | function | equation | argument | values | prior size | lengths | why this size "
        "| believed up to |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    component = ""
    for one in functions:
        unit = "" if one.argument_unit == "1" else f", {one.argument_unit}"
        where = f"each {one.argument}" if one.labels else f"{one.argument}{unit}"
        lengths = ", ".join(f"{length:.2g}" for length in one.lengths) or "none: independent"
        cells = (
            one.component if one.component != component else "",
            f"`{one.name}`",
            f"`{one.equation}`".replace("|", "\\|"),
            where,
            f"{len(one.at)}, {one.unit}",
            f"{one.size:.2g} ({amount(one.size, one.unit)})"
            if one.unit.startswith("log ")
            else amount(one.size, one.unit),
            lengths,
            one.why.replace("|", "\\|"),
            amount(LIMITS[one.name].sizes * one.size, one.unit),
        )
        component = one.component
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main(table: str) -> None:
    """Print one of them, of `demo`."""
    study = load_study("demo")
    if table == "effects":
        print(catalogue_table())
    elif table == "signatures":
        print(signature_table(get_baseline("B").forward(study, priors={"set": "paun2020"})))
    else:
        model = get_baseline("linear-constant").forward(study)
        start = pack(model.parameters, start_of(model.parameters))
        print(component_table(components(model, start, study_data(study))))


if __name__ == "__main__":
    main(sys.argv[1])
