"""`zoo doctor`: what this machine has that decides whether, and how fast, zoo works."""

from __future__ import annotations

from typing import Any

from zoo.cli.command import command
from zoo.cli.options import JSON
from zoo.cli.screen import plain_table, say, say_json

SOLVES = 20
"""Solves of the study `demo` that are timed."""


@command
def doctor(as_json: bool = JSON) -> None:
    """Show compiler, BLAS, versions, cores, data and the time of a solve, and what is missing of these."""
    found = examine()
    if as_json:
        say_json(found)
        return
    table = plain_table("", "", heads=False)
    for name, text in (found["versions"] | _in_words(found)).items():
        table.add_row(name, text)
    say(table)


def examine() -> dict[str, Any]:
    """What is there, by name with unit; None where it is missing."""
    import os
    from importlib import metadata

    import pytensor
    from threadpoolctl import threadpool_info  # type: ignore[import-untyped]

    from zoo.core.inference.record import versions
    from zoo.core.model import missing_for_graphs

    own = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "versions": versions() | {name: metadata.version(name) for name in ("numba", "scipy")},
        "cxx_compiler": pytensor.config.cxx or None,
        "pytensor_linker": str(pytensor.config.linker),
        "pytensor_cache": str(pytensor.config.compiledir),
        "pytensor_blas_flags": pytensor.config.blas__ldflags or None,
        "blas": [
            {"library": one["internal_api"], "version": one["version"], "threads": one["num_threads"]}
            for one in sorted(threadpool_info(), key=lambda one: (one["internal_api"], str(one["version"])))
        ],
        "cores": os.cpu_count(),
        "cores_of_this_process": own,
        "missing_for_graphs": missing_for_graphs(),
        "studies": _studies(),
        "solve_ms": 1e3 * seconds_of_a_solve(),
    }


def _in_words(found: dict[str, Any]) -> dict[str, str]:
    """Rows of the table, with what to do about what is missing."""
    blas = [f"{one['library']} {one['version']} ({one['threads']})" for one in found["blas"]]
    there = [
        name if data else f"{name} (missing: zoo fetch {name})" for name, data in found["studies"].items()
    ]
    lacks = "; ".join(f"no {what}: {remedy}" for what, remedy in found["missing_for_graphs"].items())
    return {
        "C++ compiler": found["cxx_compiler"] or "none, so that PyTensor is slow; install one, such as g++",
        "PyTensor's linker": found["pytensor_linker"],
        "PyTensor's cache": found["pytensor_cache"],
        "PyTensor's BLAS": found["pytensor_blas_flags"] or "none of its own: it takes NumPy's or SciPy's",
        "BLAS and threads": ", ".join(blas),
        "cores": f"{found['cores_of_this_process']} of {found['cores']}",
        "graphs of models": lacks or "by graphviz",
        "measured data": ", ".join(there),
        "one solve": f"{found['solve_ms']:.3g} ms (study demo, model A)",
    }


def _studies() -> dict[str, bool]:
    """Built-in studies, and whether their data are there."""
    from zoo.blood.fetch import FetchError
    from zoo.blood.study import list_studies, load_study

    there = dict.fromkeys(list_studies(), True)
    for name in there:
        try:
            load_study(name)
        except FetchError:
            there[name] = False
    return there


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
