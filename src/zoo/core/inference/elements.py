"""Draws as arrays, and element by element."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from zoo.core.arviz_lines import InferenceData, dataset


def scalars(draws: Mapping[str, np.ndarray]) -> Iterator[tuple[str, np.ndarray]]:
    """Name and draws of every scalar element of the variables.

    Parameters
    ----------
    draws : mapping
        Variable -> array (n_chains, n_draws, ...).

    Yields
    ------
    tuple
        `name` or `name[i, j]`, and an array (n_chains, n_draws).
    """
    for name, values in draws.items():
        values = np.asarray(values)
        if values.ndim == 2:
            yield name, values
            continue
        for index in np.ndindex(values.shape[2:]):
            yield f"{name}[{', '.join(str(i) for i in index)}]", values[(slice(None), slice(None), *index)]


def arrays(idata: InferenceData, var_names: Sequence[str] | None = None) -> dict[str, np.ndarray]:
    """Draws of a posterior's variables, or of those that are named, as arrays (n_chains, n_draws, ...)."""
    posterior = dataset(idata)
    names = posterior.data_vars if var_names is None else var_names
    return {str(name): posterior[name].transpose("chain", "draw", ...).to_numpy() for name in names}
