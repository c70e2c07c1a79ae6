"""What the loads at the outlets may lack."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Case
from zoo.blood.components.curves import factors
from zoo.blood.components.setting import Setting
from zoo.core.components import FreeFunction

Array = NDArray[np.float64]
SCATTER_SIZE = 0.4
FIRST_SIZE = 0.3


def _spread(case: Case, values: Array) -> Array:
    """Factor of every vessel, 1 where it is no terminal, (n_vessels,)."""
    scale = np.ones(len(case.network.ids))
    scale[case.network.terminals] = factors(values)
    return scale


def scaled_loads(case: Case, values: Array, of: tuple[str, ...]) -> Case:
    """psi1, psi2 or c -> itself times exp(v) at each terminal."""
    scale = _spread(case, values)
    return replace(case, **{name: getattr(case, name) * scale for name in of})


def functions(setting: Setting) -> tuple[FreeFunction, ...]:
    """The scatter of resistances and compliances over the terminals; of single resistances, theirs alone."""
    network = setting.case.network
    terminals = network.terminals
    labels = tuple(setting.vessels[i] for i in terminals)
    index = np.arange(float(len(terminals)))

    def scatter(name: str, size: float, of: tuple[str, ...], unit: str, why: str) -> FreeFunction:
        letters = {"psi1": "R1", "psi2": "R2", "c": "C"}
        changed = ", ".join(f"{letters[one]} -> {letters[one]} exp(v)" for one in of)
        return FreeFunction(
            name,
            "outlets",
            index,
            size,
            functools.partial(scaled_loads, of=of),
            "terminal",
            "1",
            unit,
            why=why,
            labels=labels,
            equation=f"{changed} at each terminal, independent",
        )

    found = [
        scatter(
            "outlet-resistance",
            SCATTER_SIZE,
            ("psi1", "psi2"),
            "log resistance",
            "0.4: nominal shares follow Poiseuille's law, r^4 (Qureshi et al. 2018, "
            "doi 10.1007/s10237-018-1078-8), and 10 % of a radius is 0.4 in its fourth power",
        )
    ]
    if np.all(network.R2[terminals] > 0):
        found += [
            scatter(
                "outlet-first-resistance",
                FIRST_SIZE,
                ("psi1",),
                "log resistance",
                "assumed: 0.3; nominal R1 is a fifth of the total by rule, and the characteristic impedance "
                "for which it stands goes with r^-2.5: 10 % of a radius is 0.25",
            ),
            scatter(
                "outlet-compliance",
                SCATTER_SIZE,
                ("c",),
                "log compliance",
                "assumed: 0.4, as for resistances: nominal compliances are one time constant over them",
            ),
        ]
    return tuple(found)
