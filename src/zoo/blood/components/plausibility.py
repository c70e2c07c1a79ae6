"""Whether what a component would have to be off by can be, in a sentence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from zoo.blood.components.curves import factors
from zoo.core.components import FreeFunction

MOST_SIZES = 2.0
"""A function is plausible up to so many of its prior sizes, where nothing else is said."""


@dataclass(frozen=True)
class Limit:
    """Up to which size a function can be believed.

    Parameters
    ----------
    sizes : float
        In prior sizes of the function.
    subject : str
        What would have to be off, such as "the radii would have to be off".
    reason : str
        Why the limit is where it is.
    """

    sizes: float
    subject: str
    reason: str


LIMITS = {
    "flow-record": Limit(
        2.0,
        "the recorded inflow would have to be off",
        "flow by ultrasound is good to about 6 % of its range, random errors included to twice that",
    ),
    "flow-filter": Limit(
        3.0,
        "the gain of the flow's harmonics would have to be off",
        "a mean over unlike beats takes up to a third from the higher harmonics",
    ),
    "flow-timing": Limit(
        2.5,
        "the inflow's harmonics would have to be shifted",
        "records that are aligned by hand or by the ECG may differ by some per cent of a beat, not more",
    ),
    "wall-law": Limit(
        2.0,
        "the slope of the wall's law would have to differ",
        "arteries stiffen as they are stretched, to about twice the linear law's slope at these stretches",
    ),
    "wall-in-time": Limit(
        2.0,
        "the walls' stiffness would have to change within the beat",
        "viscous stress is some per cent of the elastic one, and muscle is slower than a mouse's beat",
    ),
    "stiffness-scatter": Limit(
        2.5,
        "the stiffness of single vessels would have to differ",
        "tests of excised arteries differ by tens of per cent, not by a factor of two",
    ),
    "stiffness-by-radius": Limit(
        2.5,
        "the stiffness would have to depend on the radius",
        "the distensibility of the lung's arteries hardly depends on their diameter",
    ),
    "outlet-impedance": Limit(
        2.0,
        "the outlets' impedance would have to differ from the circuit's",
        "a tree of small arteries behind an outlet differs by a factor of two from its three-element circuit",
    ),
    "outlet-state": Limit(
        2.0,
        "the outlets' resistance would have to change with the pressure",
        "small vessels are distended by a few per cent for each mmHg, and resistance goes with r^-4",
    ),
    "outlet-resistance": Limit(
        2.0,
        "the resistances of single outlets would have to differ from their nominal shares",
        "a share goes with r^4: it is off by half where the radius is off by a tenth",
    ),
    "outlet-first-resistance": Limit(
        2.5,
        "R1 of single outlets would have to differ from its nominal value",
        "R1 is a fifth of the total by rule only",
    ),
    "outlet-compliance": Limit(
        2.0,
        "the compliances of single outlets would have to differ from their nominal shares",
        "nominal compliances follow the resistances and share their errors",
    ),
    "friction-law": Limit(
        2.0,
        "friction would have to be another function of the velocity",
        "profiles between flat and parabolic change friction by a factor of two",
    ),
    "viscosity-by-radius": Limit(
        2.0,
        "the viscosity would have to differ",
        "haematocrit and vessel size change the viscosity of blood by a third, seldom by more than half",
    ),
    "junction-loss": Limit(
        2.0,
        "junctions would have to lose or gain pressure",
        "losses at a branching are of the order of the dynamic pressure, and a gain is none of a junction",
    ),
    "radius-scatter": Limit(
        1.5,
        "the radii would have to be off",
        "micro-CT of an excised lung can be by half a voxel, 5 to 15 % of the radii of a mouse",
    ),
    "length-scatter": Limit(
        1.5,
        "the lengths would have to be off",
        "where a vessel ends in a branching is known to about its diameter",
    ),
    "radius-by-size": Limit(
        2.0,
        "the radii would have to be off, more in vessels of one size",
        "an image at a pressure 10 mmHg away shows radii 20 % off, and narrow vessels are blurred most",
    ),
    "sensor-filter": Limit(
        3.0,
        "the sensor's gain would have to change with frequency",
        "an underdamped fluid-filled line does; a pressure-tip catheter does not",
    ),
    "sensor-timing": Limit(
        3.0,
        "the sensor's harmonics would have to be delayed",
        "lines and amplifiers delay by milliseconds, not more",
    ),
    "sensor-curve": Limit(
        2.0,
        "the sensor's reading would have to be bent",
        "transducers are held to 1 mmHg and 1 % of the reading",
    ),
}
"""By the functions' names."""


def plausible(function: FreeFunction, values: ArrayLike) -> tuple[bool, str]:
    """Whether learned values of a free function can be believed, and a sentence that says why.

    Parameters
    ----------
    function : FreeFunction
    values : array (n_points,)
        Learned values, in its unit; their root mean square is compared with its limit.

    Returns
    -------
    bool
    str
        Such as "the radii would have to be off by 12 %: micro-CT of an excised lung can be by ...".
    """
    rms = float(np.sqrt(np.mean(np.asarray(values, dtype=np.float64) ** 2)))
    limit = LIMITS.get(
        function.name, Limit(MOST_SIZES, f"{function.name} would have to differ", function.why)
    )
    believed = rms <= limit.sizes * function.size
    bound = amount(limit.sizes * function.size, function.unit)
    verdict = f"up to {bound} is believed" if believed else f"more than {bound} is not believed"
    return believed, f"{limit.subject} by {amount(rms, function.unit)}: {limit.reason} ({verdict})"


def amount(size: float, unit: str) -> str:
    """A size in words: logarithms as per cent, other numbers with their unit."""
    if unit.startswith("log "):
        factor = float(factors(size))
        return f"{100 * (factor - 1):.3g} %" if factor < 2 else f"a factor of {factor:.3g}"
    if unit == "dynamic pressure":
        return f"{size:.3g} times the dynamic pressure"
    return f"{1e3 * size:.3g} ms" if unit == "s" else f"{size:.3g} {unit}".removesuffix(" 1")
