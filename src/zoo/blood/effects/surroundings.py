"""Effects on what surrounds the vessels."""

from __future__ import annotations

import numpy as np

from zoo.blood.case import Case, with_offset
from zoo.blood.effects.catalogue import effect
from zoo.core.effects import EffectParameter, Location


@effect(
    "external-pressure",
    "surroundings",
    equation="p = wall(A) + p_ext in all vessels",
    source="Clark et al. 2011, doi 10.1152/japplphysiol.00775.2010 (vessels within the lung's tissue)",
    signature="vessels are wider or narrower at the same pressure; almost that of sensor-offset",
    parameters=[EffectParameter("p_ext", "mmHg", 3.0, -12.0, 12.0, (3.0, -3.0))],
    why="pleural pressure at rest is about -4 mmHg; some above 0 under ventilation",
)
def external_pressure(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """The vessels lie in a pressure other than that of the pressures' zero (the chest's)."""
    offset = np.full(len(case.network.ids), values[0] * case.conventions.mmhg)
    return with_offset(case, offset, offset)
