"""The log-density compiled by numba beside the C linker, and NUTS of nutpie, PyMC and zoo.

`python -m benchmarks.in_numba` compares processor times of the log-density, and of it with its gradient, at
the same points in the same run; `--what samplers --models BHG --samplers nutpie,zoo` gives effective samples
a second of processor time, of the parameter that has fewest, with tuning and without compilation. Figures are
kept in `benchmarks/latest.json`.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from typing import Any

import arviz as az
import numpy as np
import nutpie
import pymc as pm
from benchmarks.measured import keep, options, processor_times

from zoo import load_study, sample
from zoo.core.arviz_lines import dataset
from zoo.models import get_model

SPREAD = 0.02
"""Of the points in the unconstrained space around a model's first one."""


def evaluations(model: Any, mode: str, graph: list[Any]) -> Callable[[], object]:
    """A function that evaluates a graph at the next of a row of points, none of them twice."""
    function, around = model.compile_fn(graph, mode=mode), model.initial_point()
    rng = np.random.default_rng(1)
    return lambda: function({k: x + SPREAD * rng.standard_normal(np.shape(x)) for k, x in around.items()})


def linkers(study: str, letters: str, repeats: int) -> Iterator[tuple[str, float]]:
    """Processor time with numba over that with the C linker."""
    for letter in letters:
        model = get_model(letter)(load_study(study))
        for what, graph in (("logp", [model.logp()]), ("gradient", [model.logp(), model.dlogp()])):
            runs = [evaluations(model, mode, graph) for mode in ("NUMBA", "CVM")]
            numba, c = processor_times(runs, repeats)
            print(f"{letter}, {what}: numba {1e3 * numba:.1f} ms, C {1e3 * c:.1f} ms, ratio {numba / c:.3f}")
            yield f"numba_over_c_{what}_{letter}", numba / c


def samplers(study: str, letters: str, names: str, tune: int, draws: int) -> Iterator[tuple[str, float]]:
    """Effective samples a second of one chain of each sampler."""
    settings: dict[str, Any] = {"draws": draws, "tune": tune, "chains": 1}
    for letter in letters:
        for name in names.split(","):
            model = get_model(letter)(load_study(study))
            if name == "nutpie":
                compiled = nutpie.compile_pymc_model(model)
            elif name == "pymc":
                with model:
                    _, step = pm.init_nuts(chains=1, random_seed=1, progressbar=False)
            solves, start = model.zoo.op.counts["solves"], time.process_time()
            if name == "nutpie":
                found = nutpie.sample(compiled, **settings, cores=1, seed=1, progress_bar=False)
            elif name == "pymc":
                quiet: dict[str, Any] = {"progressbar": False, "compute_convergence_checks": False}
                with model:
                    found = pm.sample(**settings, cores=1, step=step, random_seed=1, **quiet)
            else:
                found = sample(
                    model, method="nuts", **settings, cores=0, seed=1, progress=False, groups=False
                )
            seconds, solves = time.process_time() - start, model.zoo.op.counts["solves"] - solves
            posterior = dataset(found)[[rv.name for rv in model.free_RVs]]
            least = float(min(x.min() for x in az.ess(posterior).data_vars.values()))
            print(
                f"{letter}, {name}: {least:.0f} effective of {draws} draws after {tune}, {solves} solves, "
                f"{seconds:.0f} s: {least / seconds:.3f} a second, {1e3 * least / solves:.1f} a 1000 solves",
                flush=True,
            )
            yield f"effective_a_second_{name}_{letter}", least / seconds


def main() -> None:
    given = options(
        __doc__, what="linkers", study="mouse-c6", models="BG", samplers="nutpie,pymc,zoo", repeats=15,
        tune=300, draws=300,
    )  # fmt: skip
    logging.getLogger("pymc").setLevel(logging.ERROR)
    found = (
        linkers(given.study, given.models, given.repeats)
        if given.what == "linkers"
        else samplers(given.study, given.models, given.samplers, given.tune, given.draws)
    )
    keep({"numba_study": given.study, **dict(found)}, given.output)


if __name__ == "__main__":
    main()
