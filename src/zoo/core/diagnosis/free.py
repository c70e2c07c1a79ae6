"""Free discrepancies of no listed cause: the sizes, lengths and kinds that are integrated over."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from zoo.core.diagnosis.discrepancy import SIZE_GRID, SIZE_PART
from zoo.core.diagnosis.hypothesis import ranges
from zoo.core.errors.spectral import GroupErrors, Spectral

Array = NDArray[np.float64]
Kind = tuple[float, bool]


def free_discrepancies(
    errors: Spectral,
    noise: Mapping[str, GroupErrors],
    *,
    correlated: bool = False,
    every: int = 1,
    shared: Sequence[float] | None = None,
) -> tuple[list[dict[str, GroupErrors]], Array, list[Kind]]:
    """Discrepancies of all sizes and lengths beside a noise, in all quantities or in one.

    Parameters
    ----------
    errors : Spectral
    noise : mapping of group to GroupErrors
    correlated : bool
        A discrepancy of its own in each series, which is smooth or rough; else one that is smooth and shared
        by the series to some degree.
    every : int
        Stride in the grids of sizes and lengths.
    shared : sequence of float, optional
        Correlations between series; those of the errors if absent.

    Returns
    -------
    errors : list of mappings of group to GroupErrors
    log_weights : array
        Logarithms of their prior weights: half-normal sizes, a log-normal length.
    kinds : list of (float, bool)
        Correlation between series, and whether it is rough.
    """
    alone = all(len(rows) == 1 for rows in errors.rows.values())
    rhos = (0.0,) if alone or correlated else tuple(errors.shared if shared is None else shared)
    # a discrepancy with a physical cause is smooth; noise may be either
    roughs = (False, True) if correlated else (False,)
    scales = {q: SIZE_PART * size for q, size in ranges(errors.on).items()}
    # what is wrong with the sensors of one quantity does not show in the other
    quantities = tuple(errors.groups)
    wheres = [quantities, *([(q,) for q in quantities] if len(quantities) > 1 else [])]
    cells = list(product(errors.length_grid[::every], SIZE_GRID[::every], rhos, roughs, wheres))
    found = [
        {
            q: replace(
                e,
                delta=size * scales[q] if q in where else 0.0,
                length=float(length),
                shared=float(rho),
                rough=rough,
            )
            for q, e in noise.items()
        }
        for length, size, rho, rough, where in cells
    ]
    weights = np.array(
        [math.log(size) - 0.5 * size**2 + errors.length_log_prior(length) for length, size, *_ in cells]
    )
    return found, weights - logsumexp(weights), [(float(rho), rough) for _, _, rho, rough, _ in cells]
