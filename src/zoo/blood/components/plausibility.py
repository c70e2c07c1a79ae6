"""Whether what a component would have to be off by can be, in a sentence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from zoo.blood.components.declared import TABLE
from zoo.core.components import FreeFunction
from zoo.core.words import size_words

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


LIMITS = {name: Limit(**said["limit"]) for name, said in TABLE.items()}
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
    """A size in words, of pressures in parts of the dynamic one, and of times in ms."""
    if unit == "dynamic pressure":
        return f"{size:.3g} times the dynamic pressure"
    return size_words(1e3 * size, "ms") if unit == "s" else size_words(size, unit)
