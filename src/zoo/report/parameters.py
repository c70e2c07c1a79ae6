"""What the parameters are, and their posteriors as rows of a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from zoo.blood.case import UNITS
from zoo.core.inference.convergence import Diagnostics
from zoo.core.inference.elements import scalars
from zoo.core.posterior.comparison import record_of
from zoo.report.words import number

if TYPE_CHECKING:
    import pymc as pm

MEANINGS = {
    "f1": ("stiffness: f1 in f1 exp(f2 r0) + f3", "g cm⁻¹ s⁻²"),
    "f2": ("stiffness: f2 in f1 exp(f2 r0) + f3", "1/radius unit"),
    "f3": ("stiffness: constant part", "g cm⁻¹ s⁻²"),
    "m_chi": ("stiffness: mean of the population", "g cm⁻¹ s⁻²"),
    "v_chi": ("stiffness: variance of the population", "(10⁴ g cm⁻¹ s⁻²)²"),
    "chi": ("stiffness of a vessel", "g cm⁻¹ s⁻²"),
    "gamma": ("shape of the tangent wall", "–"),
    "psi1": ("factor on the nominal R1", "–"),
    "psi2": ("factor on the nominal R2", "–"),
    "c": ("factor on the nominal C", "–"),
    "sigma2": ("variance of the errors", "mmHg²"),
    "w": ("error kernel: weights", "s⁻²"),
    "b": ("error kernel: bias", "–"),
}
"""Parameter -> what it is, and its unit."""
for _quantity, _unit in UNITS.items():
    _word = _quantity.partition("_")[0]
    MEANINGS |= {
        f"noise_{_quantity}": (f"standard deviation of the noise, {_word}", _unit),
        f"amplitude_{_quantity}": (f"amplitude of the error kernel, {_word}", _unit),
        f"w_{_quantity}": (f"error kernel: weights, {_word}", "cycle⁻²"),
        f"b_{_quantity}": (f"error kernel: bias, {_word}", "–"),
    }


class Row(NamedTuple):
    """One scalar of a posterior, as text."""

    name: str
    meaning: str
    unit: str
    median: str
    low: str
    high: str
    rhat: str
    bulk: str
    tail: str
    passes: bool


def parameter_rows(
    posterior: Any, names: Sequence[str], check: Diagnostics, model: pm.Model | None
) -> list[Row]:
    unit = "mmHg²"
    if model is not None:
        quantities = {series.quantity for series in record_of(model).study.series}
        unit = "mmHg²" if quantities == {"pressure_mmHg"} else "unit of the series, squared"
    judged = {p.name: p for p in check.verdict.parameters}
    draws = {name: posterior[name].transpose("chain", "draw", ...).to_numpy() for name in names}
    rows = []
    for label, values in scalars(draws):
        base = label.partition("[")[0]
        meaning, own = MEANINGS.get(base, ("", ""))
        median, low, high = (number(q) for q in np.quantile(values.astype(float), (0.5, 0.025, 0.975)))
        p = judged.get(label)
        rhat, bulk, tail = "–", "–", "–"
        if p is not None:
            rhat, bulk, tail = f"{p.rhat:.3f}", f"{p.ess_bulk:.0f}", f"{p.ess_tail:.0f}"
        chosen = unit if base == "sigma2" else own
        rows.append(Row(label, meaning, chosen, median, low, high, rhat, bulk, tail, p is None or p.passes))
    return rows
