"""A score in words: text, Markdown tables, and the files of a score."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from zoo.core.blindcheck.scoring import Rate, Score
from zoo.core.inference.record import versions
from zoo.core.outputs import write_file

SCORE_FILES = "score.json", "score.md", "cases.csv"
"""What `write_score` writes."""
FORMAT = 3
CONSTANT = "best constant answer"
RATES = (
    ("first", "what is true first"),
    ("group_first", "what is true, or its group, first"),
    ("false_alarms", "no effect, and something else first"),
)


def log_text(summary: Mapping[str, Any]) -> str:
    """The log score; where a truth was impossible, how many were and the mean of the others."""
    if not summary["impossible"]:
        return f"{summary['log_score']:.3f}"
    least = f"{len(summary['impossible'])} below 1e-6"
    return f"{summary['log_score']:.3f} ({least}; the others {summary['log_score_of_possible']:.3f})"


def summary_rows(s: Mapping[str, Any], *, sizes: bool = True) -> list[tuple[str, str, str]]:
    """A summary in words: what, its figure, that of the best constant answer; with or without sizes."""
    best, always = s["constant"], f"always {s['constant']['always']}"
    rows = [
        ("log score", log_text(s), f"{best['log_score']:.3f}"),
        ("Brier score", f"{s['brier']:.3f}", f"{best['brier']:.3f}"),
    ]
    for name, words in RATES:
        if s[name].n:
            constant = "always no-gap" if name == "false_alarms" else always
            rows.append((words, str(s[name]), f"{100 * best[name].share:.0f} % ({constant})"))
            if name == "group_first":
                rows.append(("mean rank of its group", f"{s['mean_rank']:.2f}", "–"))
                rows.append(("mean size of the leading group", f"{s['group_size']:.1f}", "1"))
    if s["sure"].n:
        text = f"{s['sure'].count} of {s['sure'].n} ({s['sure_stated']:.3f} stated)"
        rows.append(("stated with more than 90 %, right", text, "–"))
    if sizes and s["parameter"].n:
        words = "95 % interval of the effect parameter holds the true one"
        prior = best["parameter"]
        rows.append(
            (words, str(s["parameter"]), f"{100 * prior.share:.0f} % (the prior's)" if prior.n else "–")
        )
        if prior.n:
            rows.append(("its width over the prior's, median", f"{s['parameter_width']:.3f}", "1"))
    if sizes and s["left"].n:
        words = "95 % interval of what the leader leaves holds what it leaves"
        rows.append((words, str(s["left"]), "–"))
        constant = f"{best['left_error']:.3g} (always {best['left']:.3g})"
        rows.append(("size of the error of what it leaves, median", f"{s['left_error']:.3g}", constant))
    return rows


def score_text(score: Score) -> str:
    """The score beside the best constant answers, a line each."""
    s = score.summary
    rows = summary_rows(s)
    wide, middle = (max(len(row[i]) for row in rows) for i in (0, 1))
    title = f"{s['n']} cases, {s['failed']} without an answer"
    lines = [f"{title:<{wide + middle + 4}}  {CONSTANT}".rstrip()]
    return "\n".join(lines + [f"{a:<{wide}}  {b:<{middle}}  {c}" for a, b, c in rows])


def _table(heads: str, rows: list[str]) -> list[str]:
    return ["", f"| {heads} |", "|---" * (heads.count(" | ") + 1) + "|", *(f"| {row} |" for row in rows)]


def _group_row(name: str, s: Mapping[str, Any]) -> str:
    """A summary in a row of a Markdown table, under `GROUP_HEADS`."""
    best, first, sure = s["constant"], s["first"], s["sure"]
    return (
        f"{name} | {s['n']} | {log_text(s)} | {best['log_score']:.3f} "
        f"| {s['brier']:.3f} | {best['brier']:.3f} | {first.count}, {s['group_first'].count} of {first.n} "
        f"| {best['first'].count} ({best['always']}) | {sure.count} of {sure.n}"
    )


GROUP_HEADS = (
    "{} | cases | log score | constant | Brier | constant | it, or its group, first | constant "
    "| right of those above 90 %"
)


def score_table(score: Score) -> str:
    """A score in Markdown: all cases, each grouping, reliability; then the same by component."""
    lines = []
    for title, part in (("cases", score), ("cases, by component", score.components)):
        if part is None:
            continue
        s = part.summary
        rows = [" | ".join(row) for row in summary_rows(s, sizes=part is score)]
        lines += _table(f"{s['n']} {title}, {s['failed']} without an answer | | {CONSTANT}", rows)
        for what, groups in part.by.items():
            lines += _table(GROUP_HEADS.format(what), [_group_row(v, own) for v, own in groups.items()])
        heads = "stated probability of the leading group | cases | mean stated | right | 95 % range"
        rows = [
            f"{b.low:g} to {b.high:g} | {b.n} | {b.stated:.3f} | {b.right} | {b.band[0]} to {b.band[1]}"
            for b in part.reliability
        ]
        lines += _table(heads, rows)
        if s["impossible"]:
            rows = [
                f"{c['case']} | {c['label']} | {' or '.join(c['right'])} | {c['probability']:.1e} "
                f"| {c['leader']} ({c['stated']:.3f})"
                for c in part.cases
                if c["case"] in s["impossible"]
            ]
            lines += _table("below 1e-6 | true | asked for | probability | said", rows)
    return "\n".join(lines[1:]) + "\n"


def _plain(value: Any) -> Any:
    """For JSON; a number that is not finite is a text."""
    if isinstance(value, Rate):
        low, high = value.interval
        return _plain(asdict(value) | {"share": value.share, "low": low, "high": high})
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


def _record(score: Score) -> dict[str, Any]:
    """What score.json has of a score."""
    return {
        "summary": score.summary,
        "by": score.by,
        "reliability": [asdict(b) | {"inside": b.inside} for b in score.reliability],
        "cases": [{**c, "right": " ".join(c["right"])} for c in score.cases],
    }


def write_score(score: Score, out: Path) -> None:
    """Write score.json, score.md and cases.csv into a folder, which is made if it is not there."""
    out.mkdir(parents=True, exist_ok=True)
    record = {"format": FORMAT, "versions": versions(), "without_key": score.without_key, **_record(score)}
    record = _plain(record | ({"components": _record(score.components)} if score.components else {}))
    write_file(out / "score.json", json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    write_file(out / "score.md", score_table(score))
    table = pd.DataFrame(record["cases"], dtype=object)
    write_file(out / "cases.csv", table.to_csv(index=False, lineterminator="\r\n"))
