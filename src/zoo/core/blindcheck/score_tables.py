"""A score in Markdown tables, and the files of a score."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from zoo.core.blindcheck.scoring import (
    CONSTANT,
    QUESTIONS,
    Asked,
    Event,
    Rate,
    Score,
    paired,
    summary_rows,
)
from zoo.core.inference.record import versions
from zoo.core.outputs import write_file

SCORE_FILES = "score.json", "score.md", "cases.csv"
"""What `write_score` writes."""
FORMAT = 4


def table(heads: str, rows: Sequence[str]) -> str:
    """A Markdown table."""
    lines = [f"| {heads} |", "|---" * (heads.count("|") + 1) + "|", *(f"| {row} |" for row in rows)]
    return "\n".join(lines) + "\n"


def _asked(one: Asked) -> str:
    return (
        f"{one.log.n} | {one.log_text()} | {one.constant_log:.3f} "
        f"| {one.brier.text()} | {one.constant_brier:.3f}"
    )


def score_table(score: Score) -> str:
    """A score in Markdown: all cases, each grouping, reliability, and what was called impossible."""
    s, rows = score.summary, [" | ".join(row) for row in summary_rows(score.summary)]
    found = [table(f"{s['n']} cases, {s['failed']} without an answer | | {CONSTANT}", rows)]
    for what, groups in score.by.items():
        rows = [
            f"{value} | {QUESTIONS[question]} | {_asked(one)}"
            for value, own in groups.items()
            for question, one in own["questions"].items()
        ]
        found.append(table(f"{what} | asked | cases | log score | constant | Brier | constant", rows))
        rows = [
            f"{value} | {own['n']} | {own['first'].count} of {own['first'].n} "
            f"| {own['constant']['first'].count} ({own['constant']['always']}) "
            f"| {own['sure'].count} of {own['sure'].n} "
            f"| {own['false_alarms'].count} of {own['false_alarms'].n}"
            for value, own in groups.items()
        ]
        heads = "cases | most probable is right | constant | right of those above 90 % | false alarms"
        found.append(table(f"{what} | {heads}", rows))
    rows = [
        f"{QUESTIONS[question]} | {b.low:g} to {b.high:g} | {b.n} | {b.stated:.4f} | {b.right} "
        f"| {b.band[0]} to {b.band[1]}{'' if b.inside else ' (outside)'}"
        for question, bins in score.reliability.items()
        for b in bins
    ]
    found.append(table("asked | stated probability | events | mean stated | true | 95 % range", rows))
    rows = [
        f"{case} | {QUESTIONS[question]} | {what} | {p:.1e}"
        for question, one in s["questions"].items()
        for case, what, p in one.unlikely
    ]
    if rows:
        found.append(table("below 1e-6 | asked | what is so | its probability", rows))
    return "\n".join(found)


def paired_table(now: Score, then: Score, name: str = "kind") -> str:
    """Two programs' scores of the same cases beside each other, with differences, in Markdown."""
    rows = []
    for value, questions in paired(now, then, name).items():
        for question, (x, y, log, brier) in questions.items():
            rows.append(
                f"{value} | {QUESTIONS[question]} | {log.n} | {x.log_text()} | {y.log_text()} "
                f"| {log.text('+')} | {x.constant_log:.3f} | {x.brier.mean:.3f} | {y.brier.mean:.3f} "
                f"| {brier.text('+')} | {x.constant_brier:.3f}"
            )
    heads = "cases | log score | former | difference | constant | Brier | former | difference | constant"
    return table(f"{name} | asked | {heads}", rows)


def _plain(value: Any) -> Any:
    """For JSON; a number that is not finite is a text."""
    if isinstance(value, Rate):
        low, high = value.interval
        return _plain(asdict(value) | {"share": value.share, "low": low, "high": high})
    if isinstance(value, Event):
        return {"names": list(value.names), "probability": value.p, "true": value.true}
    if hasattr(value, "__dataclass_fields__"):
        return _plain(vars(value))
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


def write_score(score: Score, out: Path) -> None:
    """Write score.json, score.md and cases.csv into a folder, which is made if it is not there."""
    out.mkdir(parents=True, exist_ok=True)
    told = ("without_key", "summary", "by", "reliability", "cases")
    record: dict[str, Any] = {"format": FORMAT, "versions": versions()}
    record |= {name: _plain(getattr(score, name)) for name in told}
    write_file(out / "score.json", json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    write_file(out / "score.md", score_table(score))
    rows = [{**row, "right": " ".join(row["right"])} | {"events": ""} for row in record["cases"]]
    cases = pd.DataFrame(rows, dtype=object).drop(columns="events", errors="ignore")
    write_file(out / "cases.csv", cases.to_csv(index=False, lineterminator="\r\n"))
