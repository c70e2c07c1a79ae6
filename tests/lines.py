"""What both lines of PyMC and ArviZ must agree on: WAIC of the nine models, and the file of a posterior.

`python tests/lines.py` writes what the line that runs it gives into tests/data/lines.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zoo
from zoo.core.arviz_lines import ARVIZ_1, InferenceData, datasets, made, of_draws
from zoo.core.posterior.arviz_groups import add_groups
from zoo.core.posterior.comparison import compare
from zoo.core.posterior.storage import save_posterior
from zoo.models import get_model

FOLDER = Path(__file__).parent / "data" / "lines"
LINES = ("pymc-5", "pymc-6")
OURS = LINES[ARVIZ_1]
IN_NUMBA = [] if ARVIZ_1 else [pytest.mark.nightly]
"""Marks of what numba takes long to compile: the later line does it by default, the older one on request."""
COLUMNS = [
    "waic",
    "waic_se",
    "p_waic",
    "waic_leave_one_out",
    "waic_one_observation",
    "difference",
    "difference_se",
]


def compiled_by_numba(test: Any) -> Any:
    """A test with these marks."""
    for mark in IN_NUMBA:
        test = mark(test)
    return test


def posterior(model: Any, n_draws: int = 50) -> InferenceData:
    """Draws of two chains around the values that a model suggests, the same on both lines."""
    rng = np.random.default_rng(7)
    dims = model.named_vars_to_dims
    shape = {name: [len(model.coords[d]) for d in dims.get(name, ())] for name in model.zoo.parameters}
    draws = {
        name: np.multiply(value, np.exp(0.003 * rng.standard_normal((2, n_draws, *shape[name]))))
        for name, value in model.zoo.suggested.items()
    }
    return of_draws({"posterior": draws}, model.coords, dims)


def waic_of_nine() -> dict[str, dict[str, float]]:
    """WAIC of the nine models on the demo study, at those draws."""
    models = {name: get_model(name)(zoo.load_study("demo")) for name in "ABCDEFGHI"}
    table = compare({name: posterior(model) for name, model in models.items()}, models)
    return {str(name): row for name, row in table[COLUMNS].astype(float).to_dict("index").items()}


def posterior_with_groups() -> InferenceData:
    """A small posterior of model F, whose stiffness is a vector, with three of ArviZ's groups."""
    from gaussian import a_record

    model = get_model("F")(zoo.load_study("demo"))
    groups = datasets(add_groups(posterior(model, n_draws=3), model, n_prior=2, seed=1))
    idata = made({name: groups[name] for name in ("posterior", "prior", "log_likelihood")})
    a_record().attach(idata)
    return idata


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    save_posterior(posterior_with_groups(), FOLDER / f"{OURS}.nc")
    (FOLDER / f"{OURS}.json").write_text(json.dumps(waic_of_nine(), indent=1) + "\n", encoding="utf-8")
