"""A score in words: the rates, Markdown tables, and the files of a score."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zoo.core.blindcheck.check_score import CheckScore
from zoo.core.outputs import write_file

SCORE_FILES = "score.json", "score.md", "cases.csv"
"""What `write_score` writes."""
HEADLINES = (
    ("right", "what is true or its group ranked first, any kind"),
    ("effect_or_group_first", "true effect or its group ranked first"),
    ("effect_first", "true effect ranked first"),
    ("false_alarms", "no-effect cases with a discrepancy found"),
    ("outside_called_unlisted", "outside cases called unlisted or left open"),
    ("second_effect_one_of_two_first", "of two effects, one (or its group) ranked first"),
    ("gap_interval_holds_truth", "95 % interval of the baseline's discrepancy holds the true one"),
    ("left_interval_holds_truth", "95 % interval of what the leader leaves holds what it leaves"),
    ("amplitude_interval_holds_truth", "95 % interval of the effect parameter holds the true one"),
    ("amplitude_beyond_5_sd", "effect parameter more than 5 stated sds from the true one"),
    ("prior_only", "leading probability within 1 % of what the prior alone gives"),
    ("prior_only_right", "those of them that are right"),
    ("sure", "leading probability above 0.9999"),
    ("sure_right", "those of them that are right"),
    ("place_exact", "location named is the true one"),
    ("place_within_1", "location named is the true one or next to it"),
)
"""Rates of a summary, in words."""


MEANS = (
    ("leader_brier", "Brier score of the leading group's probability"),
    ("log_score", "log score by explanation"),
    ("group_log_score", "log score by group"),
    ("brier", "Brier score by explanation"),
    ("group_brier", "Brier score by group"),
)
"""Mean scores of a summary, in words."""


def rate_text(rate: Mapping[str, Any]) -> str:
    """Such as "95 % (38 of 40; 84 to 99 %)"."""
    if not rate["n"]:
        return "–"
    low, high = (f"{100 * rate[x]:.0f}" for x in ("low", "high"))
    return f"{100 * rate['share']:.0f} % ({rate['count']} of {rate['n']}; {low} to {high} %)"


def rates_text(score: CheckScore) -> str:
    """The rates that a constant answer can have, with 95 % intervals, a line each beside that answer."""
    s, best = score.summary, score.constants
    rows = [
        (words, rate_text(s[name]), constant_text(best[name]))
        for name, words in HEADLINES
        if name in best and s[name]["n"]
    ]
    wide, middle = (max((len(row[i]) for row in rows), default=0) for i in (0, 1))
    lines = [f"{s['n']} cases, {s['failed']} without an answer; in the last column the best constant answer"]
    return "\n".join(lines + [f"{a:<{wide}}  {b:<{middle}}  {c}" for a, b, c in rows])


def constant_text(constant: Mapping[str, Any] | None) -> str:
    """Such as "9 % (always taper)"; a dash where no constant answer says anything."""
    if not constant or not constant.get("n", 1):
        return "–"
    value = f"{100 * constant['share']:.0f} %" if "share" in constant else f"{constant['value']:.3f}"
    return f"{value} ({constant['answer']})"


def size_rows(score: CheckScore) -> list[tuple[str, str, str]]:
    """What is said of sizes, in words: its figure, and that of the best constant answer."""
    s, best = score.summary, score.constants
    rows = []
    if s["left_ratio"]["n"]:
        words = "what the leader leaves, above a fifth of the noise: stated over true"
        rows.append((words, _spread_text(s["left_ratio"]), _spread_text(best["left_ratio"], constant=True)))
    if s["left_error"]["n"]:
        words = "below: size of the error, median, upper quartile, largest"
        rows.append((words, _sizes_text(s["left_error"]), _sizes_text(best["left_error"], constant=True)))
    for name, words in (("gap", "the baseline's discrepancy"), ("left", "what the leader leaves")):
        own, constant = s[f"{name}_interval_holds_truth"], best[f"{name}_interval_holds_truth"]
        if own["n"]:
            told = f"{constant['width']:.3g} (holds {100 * constant['share']:.0f} %)"
            rows.append((f"width of the interval of {words}, median", f"{own['width']:.3g}", told))
    own = s["amplitude_interval_holds_truth"]
    if own["n"] and math.isfinite(own["width_over_prior"]):
        words = "width of the effect parameter's interval over the prior's, median"
        rows.append((words, f"{own['width_over_prior']:.3g}", "1"))
    return rows


def _spread_text(x: Mapping[str, Any], *, constant: bool = False) -> str:
    text = f"{x['median']:.2f} (quartiles {x['low']:.2f} and {x['high']:.2f}, worst {x['worst']:.3g})"
    return f"{text}, {x['answer']}" if constant else f"{text}, {x['n']} cases"


def _sizes_text(x: Mapping[str, Any], *, constant: bool = False) -> str:
    text = f"{x['median']:.3g}, {x['high']:.3g}, {x['worst']:.3g}"
    return f"{text}, {x['answer']}" if constant else f"{text}, {x['n']} cases"


COMPONENT_HEADLINES = (
    ("component_or_pair_of_them_first", "true component, or a group of at most two that holds it, first"),
    ("component_first", "true component itself first"),
    ("wrong_and_sure", "listed effect or component first with more than 90 %, and wrong"),
    ("both_found", "of two components, both found"),
    ("one_found", "of two components, one found"),
    ("noise_recognised", "no cause: no-gap, or correlated-noise in the leading group"),
)
"""Rates of a summary by component, in words."""


def component_rows(summary: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Scores by component in words: each with its figure, and that of the best constant answer."""
    if not summary:
        return []
    best = summary["constants"]
    rows = [
        (words, rate_text(summary[name]), constant_text(best[name]))
        for name, words in COMPONENT_HEADLINES
        if summary[name]["n"]
    ]
    rows += [
        (words, f"{summary[name]:.3f}", constant_text(best[name]))
        for name, words in (("log_score", "log score by component"), ("brier", "Brier score by component"))
        if math.isfinite(summary[name])
    ]
    if summary["group_sizes"]:
        sizes = ", ".join(f"{many} of {size}" for size, many in summary["group_sizes"].items())
        rows.append(("leading groups of so many components", sizes, ""))
    if summary["functions"]:
        for name, words in (
            ("points_held", "95 % band of the learned function holds the true one, points"),
            ("narrow_points_held", "those of them where the band is half the prior's or less"),
        ):
            x = summary[name]
            told = f"{100 * x['share']:.0f} % ({x['count']} of {x['n']})" if x["n"] else "–"
            rows.append((words, told, constant_text(best.get(name))))
        words = "functions with a direction in which the data halve the prior's sd; of these directions, mean"
        narrowed = rate_text(summary["functions_with_narrowed_directions"])
        rows.append((words, f"{narrowed}; {summary['narrowed_directions']:.1f}", ""))
        rows.append(("width of the band over the prior's, median", f"{summary['width_over_prior']:.2f}", "1"))
    return rows


def _component_table(found: Mapping[str, Any]) -> list[str]:
    """Scores by component in Markdown, all and by kind and number of series."""
    if not found:
        return []
    lines = []
    for name, summary in {"all": found, **found["by"]}.items():
        lines += ["", f"| by component: {name}, {summary['n']} cases | | best constant answer |"]
        lines += ["|---|---|---|"]
        lines += [f"| {words} | {own} | {constant} |" for words, own, constant in component_rows(summary)]
    heads = "cases | mean stated | right | 95 % range if reliable"
    for name, words in (
        ("reliability", "stated probability of the leading component"),
        ("reliability_all", "of every component and of none"),
    ):
        lines += ["", f"| {words} | {heads} |", "|---|---|---|---|---|"]
        lines += [
            f"| {b['low']:g} to {b['high']:g} | {b['n']} | {b['stated']:.3f} | {b['right']} "
            f"| {b['band'][0]} to {b['band'][1]} |"
            for b in found[name]
        ]
    return lines


def score_table(score: CheckScore) -> str:
    """A score in Markdown: rates, mean scores, reliability, and the rates of each grouping."""
    s, best = score.summary, score.constants
    lines = [f"{s['n']} cases, {s['failed']} without an answer. Sizes are in the unit of the data.", ""]
    lines += ["| | | best constant answer |", "|---|---|---|"]
    lines += [
        f"| {words} | {rate_text(s[name])} | {constant_text(best.get(name))} |" for name, words in HEADLINES
    ]
    lines += [f"| {words} | {own} | {constant} |" for words, own, constant in size_rows(score)]
    lines += [f"| {words} | {s[name]:.3f} | {constant_text(best[name])} |" for name, words in MEANS]
    lines += [
        f"| screening, minutes of one core | {s['screening_seconds'] / 60:.1f} | |",
        "",
        "| stated probability of the leading group | cases | mean stated | right | 95 % range if reliable |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {b.low:g} to {b.high:g} | {b.n} | {b.stated:.3f} | {b.right} | {b.band[0]} to {b.band[1]} |"
        for b in score.reliability
    ]
    if score.amplitudes:
        heads = "cases | mean | largest | beyond 5 | within the 95 % interval"
        lines += ["", f"| (stated - true)/stated sd of the parameter of | {heads} |"]
        lines += ["|---|---|---|---|---|---|"]
        lines += [
            f"| {name} | {z['n']} | {z['mean']:.2f} | {z['largest']:.2f} | {z['beyond_5_sd']} | {z['held']} |"
            for name, z in score.amplitudes.items()
        ]
    rates = ("effect_or_group_first", "right", "left_interval_holds_truth", "amplitude_interval_holds_truth")
    for what, rows in score.by.items():
        lines += ["", f"| {what} | cases | effect or group first | right | left held | parameter held |"]
        lines += ["|---|---|---|---|---|---|"]
        for value, part in rows.items():
            cells = " | ".join(rate_text(part[name]) for name in rates)
            lines.append(f"| {value} | {part['n']} | {cells} |")
    return "\n".join(lines + _component_table(score.components)) + "\n"


def write_score(score: CheckScore, out: Path) -> None:
    """Write score.json, score.md and cases.csv into a folder, which is made if it is not there."""
    out.mkdir(parents=True, exist_ok=True)
    record = score.record()
    write_file(out / "score.json", json.dumps(record, indent=1, ensure_ascii=False) + "\n")
    write_file(out / "score.md", score_table(score))
    table = io.StringIO(newline="")
    writer = csv.DictWriter(table, list(record["cases"][0]))
    writer.writeheader()
    writer.writerows(record["cases"])
    write_file(out / "cases.csv", table.getvalue())
