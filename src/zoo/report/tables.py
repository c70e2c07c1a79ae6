"""Tables of a diagnosis, the same for its page and the screen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from zoo.blood.effects import CATALOGUE
from zoo.core.diagnosis import DiagnosisFile
from zoo.core.diagnosis.file import (
    CauseResult,
    ComponentResult,
    Estimate,
    LearnedFunction,
    LocationShare,
    SetResult,
)
from zoo.core.words import estimate, listed, percent, size_words, span, unit_words
from zoo.plots.subject import TOLD, leading_sets, location_of, set_name
from zoo.report.filters import spanned, with_error
from zoo.report.parameter_table import MEANINGS

SHOWN_SETS, SHOWN_PLACES = 12, 3
"""Sets of causes, and places of an effect, that are told."""


class Table(NamedTuple):
    """Cells in words; columns whose heads are among `numbers` stand at the right; last rows are folded."""

    name: str
    heads: tuple[str, ...]
    numbers: tuple[str, ...]
    rows: list[list[str]]
    folded: int = 0

    def only(self, *heads: str, first: int | None = None) -> Table:
        """Some of the columns of the first rows."""
        at = [self.heads.index(head) for head in heads]
        return self._replace(heads=heads, rows=[[row[i] for i in at] for row in self.rows[:first]])


def _in(unit: str) -> str:
    return "" if unit == "1" else f" ({unit})"


def _unlikely(rows: Sequence[CauseResult | ComponentResult]) -> int:
    """How many of them have a probability below 1 %."""
    return sum(one.probability < TOLD for one in rows)


def _prior(p: float) -> str:
    """In percent with two digits, since a prior may be small."""
    return f"{100 * p:.2g} %"


def sets_table(file: DiagnosisFile, most: int = SHOWN_SETS) -> Table:
    """The leading sets of causes, and that of none."""
    zero = next(row.log_evidence for row in file.sets if not row.causes)
    left = f"residual{_in(file.gap.unit)}"

    def cells(row: SetResult) -> list[str]:
        error = "" if row.solved else f" ± {row.log_evidence_error:.1f}"
        return [
            set_name(row),
            listed(row.components) if row.causes else "",
            _prior(math.exp(row.log_prior)),
            f"{row.log_evidence - zero:+.1f}{error}",
            percent(row.probability),
            "" if row.gap_after is None else f"{row.gap_after:.2g}",
            "yes" if row.solved else "no",
        ]

    return Table(
        "sets of causes (these and no others; if not solved, by the linear model)",
        ("causes", "components", "prior", "log evidence", "probability", left, "solved"),
        ("prior", "log evidence", "probability", left, "solved"),
        [cells(row) for row in leading_sets(file, most)],
    )


def components_table(file: DiagnosisFile) -> Table:
    """Components of the simulator, the most probably wrong first."""

    def cells(c: ComponentResult) -> list[str]:
        others = [row.components[c.name] for row in file.sensitivity]
        share = f"{percent(c.share.mean)} ({percent(c.share.low)} to {percent(c.share.high)})"
        return [
            c.name,
            percent(c.probability),
            percent(c.prior_probability),
            f"{percent(min(others))} to {percent(max(others))}",
            share,
            ", ".join(c.confounded),
            percent(c.group_probability) if c.confounded else "",
        ]

    numbers = ("probability", "before the data", "other priors", "share of the error", "any of them")
    return Table(
        "components of the simulator",
        ("component", *numbers[:4], "confounded with", numbers[4]),
        numbers,
        [cells(c) for c in file.components],
        _unlikely(file.components),
    )


def causes_table(file: DiagnosisFile) -> Table:
    """Listed effects and free functions, most probable first."""

    def cells(c: CauseResult) -> list[str]:
        what = CATALOGUE[c.name].statement if c.name in CATALOGUE and not c.free else ""
        return [
            c.name,
            c.component,
            percent(c.probability),
            percent(c.prior_probability),
            ", ".join(map(_size, c.estimates)),
            places_text(c.places),
            "Free function." if c.free else what,
        ]

    return Table(
        "effects and free functions",
        ("cause", "component", "probability", "before the data", "size", "place", "is"),
        ("probability", "before the data"),
        [cells(c) for c in file.causes],
        _unlikely(file.causes),
    )


def _size(e: Estimate) -> str:
    if e.interval is None:
        return f"{e.name} {estimate(e.mean, e.sd, e.unit)}"
    return f"{e.name} {span(e.mean, e.interval)}{unit_words(e.unit)}"


def places_text(places: Sequence[LocationShare]) -> str:
    """Such as "vessel 2 and below (70 %), everywhere (30 %)"."""
    shown = [p for p in places[:SHOWN_PLACES] if p.probability >= TOLD]
    return ", ".join(f"{location_of(p)} ({percent(p.probability)})" for p in shown)


def functions_table(file: DiagnosisFile) -> Table:
    """Each learned function where it is largest."""

    def cells(component: str, f: LearnedFunction) -> list[str]:
        return [
            f.name.replace("-", " "),
            component,
            percent(f.probability),
            *f.largest,
            size_words(f.prior_size, f.unit),
            f"{f.law}; leaves {percent(f.laws[0].left)}" if f.laws else "",
        ]

    return Table(
        "learned functions",
        ("function", "component", "probability", "largest at", "value", "prior size", "nearest simple law"),
        ("probability", "value", "prior size"),
        [cells(c.name, f) for c in file.components for f in c.functions if f.probability >= TOLD],
    )


def sensitivity_table(file: DiagnosisFile) -> Table:
    """Probabilities under each prior."""
    heads = ("no cause", *(c.name for c in file.components))
    rows = [[row.nothing, *(row.components[name] for name in heads[1:])] for row in file.sensitivity]
    return Table(
        "sensitivity to priors",
        ("prior", *heads),
        heads,
        [[one.prior, *map(percent, row)] for one, row in zip(file.sensitivity, rows, strict=True)],
    )


def series_table(file: DiagnosisFile) -> Table:
    """The model error in each observed series."""
    numbers = ("error before", "error after", "removed", "noise", "residual before", "residual after")
    return Table(
        "model error in each series",
        ("series", "unit", *numbers),
        numbers,
        [
            [
                row.series,
                row.unit,
                spanned(row.before),
                spanned(row.after),
                percent(max(0.0, 1.0 - row.after.mean / row.before.mean) if row.before.mean > 0.0 else 0.0),
                f"{row.noise_floor:.2g}",
                f"{row.residual_rms_before:.3g}",
                f"{row.residual_rms_after:.3g}",
            ]
            for row in file.gap.per_series
        ],
    )


def states_table(file: DiagnosisFile) -> Table:
    """What is left in other states."""
    rows = []
    for s in file.states:
        rows.append([s.state, "baseline", "", spanned(s.baseline), ""])
        if s.sensor is not None:
            rows.append([s.state, "sensor's discrepancy", "", spanned(s.sensor), ""])
        for c in s.carried:
            fixed = listed(c.functions).replace("-", " ")
            rows.append([s.state, listed(c.names), fixed, spanned(c.error), "yes" if c.holds else "no"])
        rows += [[s.state, name, "", "cannot be solved", "no"] for name in s.failed]
    left = f"left{_in(file.gap.unit)}"
    return Table(
        "other states",
        ("state", "explanation", "fixed", left, "holds"),
        (left,),
        rows,
    )


def parameters_table(file: DiagnosisFile) -> Table:
    """The baseline's parameters without a cause and over all sets."""
    before, after = file.base_parameters["base"], file.base_parameters["over all sets"]
    rows = []
    for name, alone in before.items():
        shift = after[name].mean - alone.mean
        rows.append(
            [
                name,
                *MEANINGS.get(name, file.labels.get(name, ("", "–"))),
                estimate(alone.mean, alone.sd),
                estimate(after[name].mean, after[name].sd),
                f"{shift:+.3g}",
                f"{shift / alone.sd:+.1f}" if alone.sd > 0.0 else "",
            ]
        )
    numbers = ("baseline", "over all sets", "shift", "shift / sd")
    return Table(
        "parameters of the baseline",
        ("parameter", "is", "unit", *numbers),
        numbers,
        rows,
    )


def posteriors_table(file: DiagnosisFile) -> Table:
    """Sampled posteriors of the baseline and the leading sets of listed effects."""
    numbers = ("log marginal likelihood ± SE", "elpd (WAIC)", "difference ± SE", "elpd (PSIS-LOO)")
    rows = [
        [
            name,
            "yes" if one["converged"] else "no",
            with_error(one["log_marginal_likelihood"], one["log_marginal_likelihood_se"]),
            with_error(one["elpd_waic"], None),
            with_error(one["elpd_waic_difference"], one["elpd_waic_difference_se"]),
            with_error(one["elpd_loo"], None),
            ", ".join(f"{k} {estimate(v['mean'], v['sd'])}" for k, v in one["parameters"].items()),
        ]
        for name, one in (file.posteriors or {}).items()
    ]
    heads = ("set", "converged", *numbers, "parameters: mean ± sd")
    return Table("sampled posteriors", heads, numbers, rows)
