"""The components of a blood-flow simulator, and the free functions by which each may be wrong.

`components` makes them for a study's forward model at given parameters, `component_of` says to which one a
listed effect belongs, and `plausible` whether what was learned can be believed. The site has a page for
each, with its prior size and source.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from zoo.blood.components import (
    fluid_functions,
    geometry_functions,
    inflow_functions,
    junction_functions,
    outlet_functions,
    sensor_functions,
    wall_functions,
)
from zoo.blood.components.plausibility import plausible
from zoo.blood.components.setting import Setting
from zoo.core.components import FreeFunction
from zoo.core.data import Data
from zoo.core.effects import Effect

COMPONENTS = ("inflow", "wall", "outlets", "fluid", "junctions", "geometry", "sensor")

_OF_FAMILY = {
    "inflow": "inflow",
    "wall": "wall",
    "surroundings": "wall",  # an external pressure changes what the wall's law gives at an area
    "outflow": "outlets",
    "fluid": "fluid",
    "junctions": "junctions",
    "geometry": "geometry",
    "sensor": "sensor",
}


def components(model: Any, theta: ArrayLike, data: Data) -> tuple[FreeFunction, ...]:
    """The free functions of a study's simulator, component by component.

    Parameters
    ----------
    model : forward model
        `zoo.blood.blood_flow.BloodFlow`, also with effects: functions act on top of those.
    theta : array (n_values,)
        Its parameters, at which the ranges of the functions' arguments are read off.
    data : Data
        What is observed.

    Returns
    -------
    tuple of FreeFunction
        In the order of `COMPONENTS`. What the model has as parameters already, such as the stiffness of
        each vessel, is left out, and so are a component's functions that these data cannot show at all.

    Raises
    ------
    SolveError
        If the model has no solution at these parameters.
    """
    setting = Setting(model, model.configure(np.asarray(theta, dtype=np.float64)), data)
    modules = (
        inflow_functions,
        wall_functions,
        outlet_functions,
        fluid_functions,
        junction_functions,
        geometry_functions,
        sensor_functions,
    )
    return tuple(function for module in modules for function in module.functions(setting))


def component_of(effect: Effect) -> str:
    """The component that an effect belongs to, by its family; empty for noise, numerics and others.

    Parameters
    ----------
    effect : Effect

    Returns
    -------
    str
        One of `COMPONENTS`, or empty.
    """
    return _OF_FAMILY.get(effect.family, "")
