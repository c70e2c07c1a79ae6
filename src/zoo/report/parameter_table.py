"""What the parameters are, and their posteriors as rows of a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from zoo.blood.case import UNITS
from zoo.core.inference.convergence import Diagnostics
from zoo.core.inference.elements import scalars
from zoo.core.posterior.comparison import record_of

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


def parameter_rows(
    posterior: Any, names: Sequence[str], check: Diagnostics, model: pm.Model | None
) -> list[dict[str, Any]]:
    """Name, meaning, unit, quantiles and diagnostics of each scalar of a posterior."""
    squared = "mmHg²"
    if model is not None and {s.quantity for s in record_of(model).study.series} != {"pressure_mmHg"}:
        squared = "unit of the series, squared"
    judged = {p.name: p for p in check.verdict.parameters}
    draws = {name: posterior[name].transpose("chain", "draw", ...).to_numpy() for name in names}
    rows = []
    for label, values in scalars(draws):
        base = label.partition("[")[0]
        meaning, unit = MEANINGS.get(base, ("", ""))
        rows.append(
            {
                "name": label,
                "meaning": meaning,
                "unit": squared if base == "sigma2" else unit,
                "quantiles": np.quantile(values.astype(float), (0.5, 0.025, 0.975)),
                "judged": judged.get(label),
            }
        )
    return rows
