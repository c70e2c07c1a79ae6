"""The pages of the effects and free functions: what each says of itself, and what `demo` shows of it.

`make docs` writes them into docs/generated.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from zoo import load_study
from zoo.blood.baseline import get_baseline
from zoo.blood.blood_flow import BloodFlow, study_data
from zoo.blood.components import component_of, components
from zoo.blood.components.plausibility import LIMITS, amount
from zoo.blood.effects.catalogue import CATALOGUE
from zoo.cli.list_effects import described
from zoo.core.components import FreeFunction
from zoo.core.effects import Effect
from zoo.core.forward import Outputs, SolveError
from zoo.core.parameters import pack, start_of

Array = NDArray[np.float64]
DRAWN = 3
"""Most responses of a free function that a figure shows."""
SMALLEST = 0.03
"""Part of a function's largest response below which another is left out."""
ALIKE = 4
"""Effects, and free functions, that a page names as most like what it shows."""


@dataclass(frozen=True)
class Response:
    """What an effect or a free function does to the pressure at the root's inlet, at its prior's scale.

    Parameters
    ----------
    name : str
    what : str
        The values that an effect is drawn at, and where: those of the largest change of the locations.
    change_mmHg : array (n_shapes, n_times)
        One of an effect; of a function what it can do with one prior standard deviation, the largest first.
    left_mmHg : array (n_shapes, n_times)
        What of it no small change of the baseline's parameters can imitate.
    """

    name: str
    what: str
    change_mmHg: Array
    left_mmHg: Array

    def likeness(self, other: Response) -> float:
        """Correlation of what is left of the first shape with the combination of another's most like it."""
        basis = np.linalg.qr(other.left_mmHg.T)[0]
        return float(np.linalg.norm(basis.T @ self.left_mmHg[0]) / np.linalg.norm(self.left_mmHg[0]))


def rms(x: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(x**2)))


def typical_values(made: Effect) -> tuple[float, ...]:
    """An effect's parameters at the scale of their priors, shapes at their centre."""
    return tuple(min(max(p.scale, p.low), p.high) if p.zero_is_base else p.centre for p in made.parameters)


def responses(
    model: BloodFlow, functions: Iterable[FreeFunction] = (), *, n_times: int = 256
) -> list[Response]:
    """Response to every effect that the baseline can take and a solve can show, and to free functions.

    Parameters
    ----------
    model : BloodFlow
        Such as ``get_baseline("B").forward(study)``; at the start of its parameters.
    functions : iterable of FreeFunction
    n_times : int
        Samples of the beat.

    Returns
    -------
    list of Response

    Raises
    ------
    SolveError
        If the baseline's own solve fails.
    """
    root = int(model.network.ids[int(np.argmin(model.network.parent))])
    times = np.asarray(np.arange(n_times) * (model.network.period_s / n_times), dtype=np.float64)
    outputs = Outputs(((root, 0.0, "pressure_mmHg"),), times)
    start = pack(model.parameters, start_of(model.parameters))

    def solved(changed: Any) -> Array:
        return np.asarray(model.solve(changed, outputs)[0])

    case = model.configure(start)
    plain = solved(case)
    steps = np.diag(1e-3 * start)
    directions = np.linalg.qr(
        np.transpose([solved(model.configure(start + d)) - solved(model.configure(start - d)) for d in steps])
    )[0]

    def left(change: Array) -> Array:
        return change - (change @ directions) @ directions.T

    found = []
    for made in CATALOGUE.values():
        if made.apply is None or not made.offered(model.name):
            continue
        ways = []
        for location in made.locations(model):
            values = typical_values(made.of(model))
            for _ in range(6):
                try:
                    change = solved(made.apply(case, values, location)) - plain
                except SolveError:
                    values = (values[0] / 2, *values[1:])
                    continue
                numbers = (f"{p.name} {v:.3g} {p.unit}" for v, p in zip(values, made.parameters, strict=True))
                what = ", ".join(number.removesuffix(" 1") for number in numbers) + f", {location}"
                ways.append(Response(made.name, what, change[None], left(change[None])))
                break
        found.append(max(ways, key=lambda way: rms(way.change_mmHg)))
    for one in functions:
        step = 0.02 * one.size
        slopes = [
            (solved(one.apply(case, d)) - solved(one.apply(case, -d))) / (2 * step)
            for d in step * np.eye(len(one.at))
        ]
        length = one.lengths[len(one.lengths) // 2] if one.lengths else None
        change = (one.size * one.root(length)).T @ np.array(slopes)
        shapes, sizes, _ = np.linalg.svd(left(change), full_matrices=False)
        kept = shapes[:, : int(np.sum(sizes > SMALLEST * sizes[0]))].T @ change
        found.append(Response(one.name, "", kept, left(kept)))
    return found


def cell(text: object) -> str:
    """For a table in Markdown, with links to DOIs."""
    linked = re.sub(
        r"\bdoi (10\.\d+/[^\s,;]*[^\s,;.):])(?=[\s,;.):]|$)", r"[doi \1](https://doi.org/\1)", str(text)
    )
    return linked.replace("|", "\\|")


def table(head: str, rows: Iterable[Iterable[object]]) -> str:
    """In Markdown."""
    lines = [f"| {head} |", "|---" * (head.count(" | ") + 1) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(map(cell, row)) + " |" for row in rows)]) + "\n"


def effect_words(made: Effect, model: BloodFlow) -> str:
    """What an effect says of itself."""
    said = described(made)
    rows = [
        (p.name, p.text, f"{q.scale:.3g} {q.unit}".removesuffix(" 1"), p.why)
        for p, q in zip(made.parameters, made.of(model).parameters, strict=True)
    ]
    return (
        f"{made.statement}\n\n`{made.equation}`\n\n"
        f"What it does to a beat: {made.signature}.\n\nSource: {cell(made.source)}.\n\n"
        + table("parameter | prior | sd in `demo` | why", rows)
        + f"\nFamily {made.family}, component {component_of(made) or 'none'}. "
        f"Locations: {said['locations']}. Baselines: {', '.join(made.baselines) or 'all'}.\n"
    )


def function_words(one: FreeFunction) -> str:
    """What a free function says of itself."""
    limit = LIMITS[one.name]
    argument = f"{one.argument}, {one.argument_unit}".removesuffix(", 1")
    unit = f" {one.argument_unit}".removesuffix(" 1")
    lengths = ", ".join(f"{length:.2g}" for length in one.lengths)
    rows = [
        ("component", one.component),
        ("free at", f"each {one.argument}, {len(one.at)} in `demo`" if one.labels else
         f"{len(one.at)} points of {argument}, in `demo` {one.at.min():.3g} to {one.at.max():.3g}"),
        ("unit of the values", one.unit),
        ("prior size", f"{one.size:.2g} {one.unit}" + (f" ({amount(one.size, one.unit)})"
         if one.unit == "s" or one.unit.startswith("log ") else "")),
        ("correlation lengths", f"{lengths}{unit}" if lengths else "none: independent"),
        ("why this size", one.why),
        ("believed up to", f"{amount(limit.sizes * one.size, one.unit)}: {limit.reason}"),
    ]  # fmt: skip
    return f"`{one.equation}`\n\n" + table("what | value", rows)


def drawn(response: Response, period_s: float) -> Figure:
    """Its changes of the pressure, and what of them the baseline cannot imitate."""
    figure = Figure(figsize=(5, 3), layout="constrained")
    axes = figure.subplots()
    times = 1e3 * period_s * np.arange(response.change_mmHg.shape[1]) / response.change_mmHg.shape[1]
    for k, change in enumerate(response.change_mmHg[:DRAWN]):
        axes.plot(times, change, f"C{k}", label="change" if k == 0 else None)
        axes.plot(
            times,
            response.left_mmHg[k],
            f"C{k}--",
            label="left by the baseline's parameters" if k == 0 else None,
        )
    axes.set(xlabel="time (ms)", ylabel="pressure (mmHg)")
    axes.legend(fontsize="small")
    return figure


def response_words(response: Response, others: Iterable[Response], folders: dict[str, str]) -> str:
    """The figure and its numbers, and what is most like it."""
    first, left = response.change_mmHg[0], response.left_mmHg[0]
    at = f"at {response.what}. It" if response.what else "at one prior sd, in its largest shapes. The first"
    ordered = sorted(others, key=response.likeness, reverse=True)
    rows = [
        (
            f"[`{one.name}`](../{kind}/{one.name}.md)",
            f"{response.likeness(one):.3f}",
            f"{rms(one.left_mmHg[0]):.2g}",
        )
        for kind in ("effects", "components")
        for one in [one for one in ordered if folders[one.name] == kind][:ALIKE]
    ]
    return (
        f"\n## Signature\n\n![Change of pressure over a beat by {response.name}]({response.name}.svg)\n\n"
        f"Change of pressure at the root's inlet of `demo`, {at} has the mean {first.mean():+.2g} and the "
        f"root mean square {rms(first):.2g} mmHg, of which {rms(left):.2g} mmHg is left (dashed) when the "
        "baseline's parameters imitate as much as they can.\n\n## What it is hard to tell from\n\nWhat is "
        "left of it is most like what is left of these effects and functions, by the correlation (with a "
        "function's best combination of shapes). The nearer that is to 1 and the smaller what is left, the "
        "less noise hides the difference; measuring elsewhere than at the root may tell them apart.\n\n"
        + table("other | correlation | left of it, mmHg", rows)
    )


def write_pages(folder: Path) -> dict[str, str]:
    """A page for each effect and each free function.

    Parameters
    ----------
    folder : Path
        In which ``effects`` and ``components`` are made.

    Returns
    -------
    dict
        By those two names, the table in Markdown that leads to its pages.
    """
    study = load_study("demo")
    model = get_baseline("B").forward(study, priors={"set": "paun2020"})
    functions = components(model, pack(model.parameters, start_of(model.parameters)), study_data(study))
    found = {one.name: one for one in responses(model, functions)}
    pages = {
        "effects": {made.name: (effect_words(made, model), made.statement) for made in CATALOGUE.values()},
        "components": {f.name: (function_words(f), f"{f.component}, by {f.argument}") for f in functions},
    }
    folders = {name: kind for kind, names in pages.items() for name in names}
    tables = {}
    for kind, names in pages.items():
        (folder / kind).mkdir(parents=True, exist_ok=True)
        rows = []
        for name, (words, short) in names.items():
            page, numbers = f"# {name}\n\n{words}", ("", "")
            if one := found.get(name):
                page += response_words(one, [r for r in found.values() if r is not one], folders)
                with mpl.rc_context({"svg.hashsalt": "zoo"}):
                    figure = drawn(one, model.network.period_s)
                    figure.savefig(folder / kind / f"{name}.svg", metadata={"Date": None})
                numbers = (f"{rms(one.change_mmHg[0]):.2g}", f"{rms(one.left_mmHg[0]):.2g}")
            path = folder / kind / f"{name}.md"
            if not path.exists() or path.read_text(encoding="utf-8") != page:  # else Sphinx reads it again
                path.write_text(page, encoding="utf-8")
            rows.append((f"[`{name}`](generated/{kind}/{name}.md)", short, *numbers))
        tables[kind] = table("name | what | change, mmHg | left, mmHg", rows)
    return tables
