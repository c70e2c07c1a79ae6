"""A score in words: the rates, Markdown tables, and the files of a score."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zoo.core.blindcheck.check_score import CheckScore
from zoo.core.blindcheck.sealing import replace_file

HEADLINES = (
    ("effect_or_group_first", "true effect, or the group that holds it, ranked first"),
    ("effect_first", "true effect ranked first"),
    ("false_alarms", "no-effect cases with a discrepancy found"),
    ("outside_called_unlisted", "outside cases called unlisted, or no listed effect above 50 %"),
    ("second_effect_one_of_two_first", "of two effects, one (or its group) ranked first"),
    ("shrinkage_within_10_points", "stated shrinkage within 10 points of the true one"),
    ("shrinkage_interval_holds_truth", "its 95 % interval holds the true one"),
    ("amplitude_interval_holds_truth", "95 % interval of the effect parameter holds the true one"),
    ("place_exact", "location named is the true one"),
    ("place_within_1", "location named is the true one or next to it"),
)
"""Rates of a summary, in words."""


def rate_text(rate: Mapping[str, Any]) -> str:
    """Such as "95 % (38 of 40; 84 to 99 %)"."""
    if not rate["n"]:
        return "–"
    low, high = (f"{100 * rate[x]:.0f}" for x in ("low", "high"))
    return f"{100 * rate['share']:.0f} % ({rate['count']} of {rate['n']}; {low} to {high} %)"


def rates_text(score: CheckScore) -> str:
    """The rates that count any case, a line each, with their 95 % intervals."""
    s = score.summary
    rows = [(words, rate_text(s[name])) for name, words in HEADLINES if s[name]["n"]]
    width = max((len(words) for words, _ in rows), default=0)
    lines = [f"{s['n']} cases, {s['failed']} without an answer"]
    return "\n".join(lines + [f"{words:<{width}}  {text}" for words, text in rows])


def score_table(score: CheckScore) -> str:
    """A score in Markdown: rates, mean scores, reliability, and the rates of each grouping."""
    s = score.summary
    lines = [f"{s['n']} cases, {s['failed']} without an answer.", "", "| | |", "|---|---|"]
    lines += [f"| {words} | {rate_text(s[name])} |" for name, words in HEADLINES]
    lines += [
        f"| log score by explanation (uniform guess) | {s['log_score']:.2f} ({s['uniform_log_score']:.2f}) |",
        f"| log score by group | {s['group_log_score']:.2f} ({s['uniform_group_log_score']:.2f}) |",
        f"| Brier score by explanation | {s['brier']:.3f} ({s['uniform_brier']:.3f}) |",
        f"| Brier score by group | {s['group_brier']:.3f} ({s['uniform_group_brier']:.3f}) |",
        f"| screening, minutes of one core | {s['screening_seconds'] / 60:.1f} |",
        "",
        "| stated probability of the leading group | cases | mean stated | right | 95 % range if reliable |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {b.low:g} to {b.high:g} | {b.n} | {b.stated:.3f} | {b.right} | {b.band[0]} to {b.band[1]} |"
        for b in score.reliability
    ]
    for what, rows in score.by.items():
        lines += ["", f"| {what} | cases | effect or group first | right | shrinkage within 10 points |"]
        lines += ["|---|---|---|---|---|"]
        for value, part in rows.items():
            rates = ("effect_or_group_first", "right", "shrinkage_within_10_points")
            cells = " | ".join(rate_text(part[name]) for name in rates)
            lines.append(f"| {value} | {part['n']} | {cells} |")
    return "\n".join(lines) + "\n"


def write_score(score: CheckScore, out: Path) -> None:
    """Write score.json, score.md and cases.csv into a folder, which is made if it is not there."""
    out.mkdir(parents=True, exist_ok=True)
    record = score.record()
    replace_file(out / "score.json", json.dumps(record, indent=1, ensure_ascii=False) + "\n")
    replace_file(out / "score.md", score_table(score))
    with (out / "cases.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(record["cases"][0]))
        writer.writeheader()
        writer.writerows(record["cases"])
