"""`zoo fetch`, `zoo studies`, `zoo version`: what is there."""

from __future__ import annotations

from typing import Annotated

import typer

from zoo.cli.command import command
from zoo.cli.screen import plain_table, say


@command
def fetch(name: Annotated[str, typer.Argument(metavar="NAME", help="Data set, such as mouse-c6.")]) -> None:
    """Get measured data: from ZOO_DATA_DIR, this user's cache or the public source, checked by SHA-256."""
    from zoo.blood.fetch import fetch_dataset

    for path in fetch_dataset(name):
        say(f"{path}  sha256 as expected")


@command
def studies() -> None:
    """List the built-in studies."""
    from zoo.blood.fetch import FetchError
    from zoo.blood.study import list_studies, load_study

    table = plain_table("study", "vessels", "period (s)", "observed", "conventions")
    for name in list_studies():
        try:
            study = load_study(name)
        except FetchError:
            table.add_row(name, "", "", f"its data are missing: zoo fetch {name}", "")
            continue
        observed = ", ".join(f"{s.label} ({len(s.value)} samples)" for s in study.series) or "nothing"
        table.add_row(name, str(len(study.vessels)), f"{study.period_s:g}", observed, study.conventions.name)
    say(table)


@command
def version() -> None:
    """Versions of this package and of the libraries that shape the draws."""
    from zoo.core.inference.record import versions

    for name, value in versions().items():
        say(f"{name} {value}")
