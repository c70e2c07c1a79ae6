"""`zoo doctor`: what this machine has that decides whether, and how fast, zoo works."""

from __future__ import annotations

from zoo.cli.command import command
from zoo.cli.options import JsonOption
from zoo.cli.screen import plain_table, say, say_json

SOLVES = 20
"""Solves of the study `demo` that are timed."""


@command
def doctor(as_json: JsonOption = False) -> None:
    """Show compiler, BLAS, versions, cores, data and the time of a solve, and what is missing of these."""
    from zoo.core.inference.record import versions

    found = {"versions": versions()} | examine()
    if as_json:
        say_json(found)
        return
    table = plain_table("", "", heads=False)
    for name, text in (versions() | examine()).items():
        table.add_row(name, text)
    say(table)


def examine() -> dict[str, str]:
    """What is there, by name."""
    import os
    import shutil

    import pytensor
    from threadpoolctl import threadpool_info  # type: ignore[import-untyped]

    libraries = threadpool_info()
    blas = sorted(f"{one['internal_api']} {one['version']} ({one['num_threads']})" for one in libraries)
    own = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "C++ compiler": pytensor.config.cxx or "none, so that PyTensor is slow; install one, such as g++",
        "PyTensor's linker": str(pytensor.config.linker),
        "PyTensor's cache": str(pytensor.config.compiledir),
        "BLAS and threads": ", ".join(blas),
        "cores": f"{own} of {os.cpu_count()}",
        "graphviz": shutil.which("dot") or "none, which only pm.model_to_graphviz needs",
        "measured data": _measured(),
        "one solve": f"{1e3 * seconds_of_a_solve():.3g} ms (study demo, model A)",
    }


def _measured() -> str:
    """Built-in studies whose data are there, and how to get the others."""
    from zoo.blood.fetch import FetchError
    from zoo.blood.study import list_studies, load_study

    told = []
    for name in list_studies():
        try:
            load_study(name)
            told.append(name)
        except FetchError:
            told.append(f"{name} (missing: zoo fetch {name})")
    return ", ".join(told)


def seconds_of_a_solve() -> float:
    """Of the study demo by the baseline of model A, the least of some solves."""
    import time

    from zoo.blood.baseline import get_baseline
    from zoo.blood.study import load_study
    from zoo.core.parameters import start_of

    forward = get_baseline("A").forward(load_study("demo"))
    values = start_of(forward.parameters)
    theta = [float(values[p.name]) for p in forward.parameters]
    times = []
    for i in range(SOLVES):
        theta[0] *= 1.0 + 1e-6 * i  # no solve that is remembered
        began = time.perf_counter()
        forward.solve(forward.configure(theta))
        times.append(time.perf_counter() - began)
    return min(times)
