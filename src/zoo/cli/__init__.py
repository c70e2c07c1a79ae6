"""The command `zoo`: data, simulation, sampling, comparison, diagnosis; each imports only what it needs."""

from __future__ import annotations

import os
import warnings
from typing import Annotated

import typer

from zoo.cli import (
    blind,
    compare,
    datasets,
    diagnose,
    doctor,
    importing,
    list_effects,
    report,
    sample,
    show_priors,
    simulate,
)
from zoo.cli.command import show_tracebacks

HELP = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(
    name="zoo",
    help="Bayesian models of pulmonary blood flow: from one beat of measurements to a comparison of models.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings=HELP,
)
blind_app = typer.Typer(
    name="blind",
    help="Check the diagnosis on cases whose effect is withheld: make them, run it, score the answers.",
    no_args_is_help=True,
    context_settings=HELP,
)


def _version(wanted: bool) -> None:
    if wanted:
        from zoo import __version__

        typer.echo(f"zoo {__version__}")
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_version, is_eager=True, help="Version; `zoo version` has all that matter."
        ),
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks of errors.")] = False,
) -> None:
    """Options of all commands."""
    # said by ArviZ 0.23 on its first import of a day, of a version that zoo does not use
    warnings.filterwarnings("ignore", r"\s*ArviZ is undergoing a major refactor", FutureWarning)
    warnings.filterwarnings("ignore", "PyTensor could not link to a BLAS", UserWarning)  # solves cost more
    show_tracebacks(debug or bool(os.environ.get("ZOO_DEBUG")))


for function in (
    datasets.fetch,
    datasets.studies,
    datasets.version,
    doctor.doctor,
    simulate.simulate,
    show_priors.priors,
    sample.sample,
    compare.compare,
    diagnose.diagnose,
    list_effects.effects,
    report.report,
):
    app.command()(function)
app.command(name="import")(importing.import_)
app.command(name="import-beats")(importing.import_beats)
for function in (blind.make, blind.run, blind.score):
    blind_app.command()(function)
app.add_typer(blind_app)
