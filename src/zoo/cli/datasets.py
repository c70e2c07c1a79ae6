"""`zoo fetch`, `zoo studies`, `zoo version`: what is there."""

from __future__ import annotations

from typing import Any

from zoo.cli.command import argument, command
from zoo.cli.options import JSON
from zoo.cli.screen import plain_table, say, say_json


@command
def fetch(name: str = argument("NAME", "Data set, such as mouse-c6.")) -> None:
    """Get measured data: from ZOO_DATA_DIR, this user's cache or the public source, checked by SHA-256."""
    from zoo.blood.fetch import fetch_dataset

    for path in fetch_dataset(name):
        say(f"{path}  sha256 as expected")


@command
def studies(
    folders: list[str] | None = argument("[STUDY]...", "Studies of your own, to be checked.", default=None),
    as_json: bool = JSON,
) -> None:
    """List the built-in studies, or read some of your own and say what they hold and what is odd in them."""
    from zoo.blood.fetch import FetchError
    from zoo.blood.study import list_studies, load_study

    rows: list[dict[str, Any]] = []
    for name in folders or list_studies():
        try:
            study = load_study(name)
        except FetchError:
            if folders:
                raise
            rows.append({"study": name, "observed": [f"its data are missing: zoo fetch {name}"]})
            continue
        observed = [f"{s.label} ({s.n_samples} samples)" for s in study.series]
        rows.append(
            {
                "study": name,
                "vessels": len(study.vessels),
                "period_s": study.period_s,
                "observed": observed,
                "conventions": study.conventions.name,
            }
        )
    if as_json:
        say_json(rows)
        return
    table = plain_table("study", "vessels", "period (s)", "observed", "conventions")
    for row in rows:
        cells = (str(row.get(x, "")) for x in ("vessels", "period_s"))
        listed = ", ".join(row["observed"]) or "nothing"
        table.add_row(row["study"], *cells, listed, row.get("conventions", ""))
    say(table)


@command
def version(as_json: bool = JSON) -> None:
    """Versions of this package and of the libraries that shape the draws."""
    from zoo.core.inference.record import versions

    if as_json:
        say_json(versions())
        return
    for name, value in versions().items():
        say(f"{name} {value}")
