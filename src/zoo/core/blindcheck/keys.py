"""What a key says about a case: the cause that its data withhold."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.diagnosis.hypothesis import NONPARAMETRIC, NULL
from zoo.core.effects import EVERYWHERE, Location

KINDS = ("none", "outside", "listed", "component", "pair")
SECOND = "second-effect"
"""Label of a case of kind "outside" that has two listed effects at once."""
PAIR = "pair"
"""Kind, and label of what was drawn again, of a case with causes in two components at once."""


TrueFunctions = Callable[[str, Any], NDArray[np.float64] | None]


@dataclass(frozen=True)
class TrueEffect:
    """An effect that a case was made with.

    Parameters
    ----------
    name : str
    location : Location
    amplitude : float, optional
        In the unit of the effect's parameter; None where there is no stated size to compare it with.
    prior : (float, float), optional
        Central 95 % interval of the prior that the amplitude was drawn from.
    """

    name: str
    location: Location = EVERYWHERE
    amplitude: float | None = None
    prior: tuple[float, float] | None = None


@dataclass(frozen=True)
class CaseKey:
    """What the key says about a case.

    Parameters
    ----------
    case : str
    kind : {"none", "outside", "listed", "component", "pair"}
        Whether the case has no effect, one that no diagnosis lists, a listed one, one that is known by its
        component alone, or two of these.
    label : str
        "no-gap", the effect's name, or "second-effect".
    effects : tuple of TrueEffect
    noise : float
        Standard deviation of the noise, in the unit of the data; NaN if unknown.
    before : float
        Model discrepancy of the refitted baseline: rms of the noise-free data minus the fit, in the unit of
        the data; NaN if unknown.
    truth : array (n_series, n_times), optional
        The data without noise.
    digest : str
        Checksum of the case's data; empty where the key has none.
    tags : mapping of str to str
        What else tells cases apart, such as the layout of the sensors; scores can be grouped by it.
    components : tuple of str
        Of the simulator, that the effects belong to.
    functions : function, optional
        From a component's name and a stated function to the true values at its points (n,), NaN where the
        true function was not visited, or None where the truth is no such function.
    """

    case: str
    kind: str
    label: str
    effects: tuple[TrueEffect, ...] = ()
    noise: float = math.nan
    before: float = math.nan
    truth: NDArray[np.float64] | None = field(default=None, compare=False)
    digest: str = ""
    tags: Mapping[str, str] = field(default_factory=dict)
    components: tuple[str, ...] = ()
    functions: TrueFunctions | None = field(default=None, compare=False)

    @property
    def by_component(self) -> bool:
        """Whether the cause is known by its component alone."""
        return self.kind in ("component", PAIR)

    @property
    def names(self) -> frozenset[str]:
        """Explanations that are right: those of the effects, "no-gap", or "unlisted"."""
        if self.kind == "none":
            return frozenset((NULL,))
        if self.kind == "outside" and self.label != SECOND:
            return frozenset((NONPARAMETRIC, *self.components))
        if self.by_component:
            return frozenset(self.components)
        return frozenset(e.name for e in self.effects)

    @property
    def accepted(self) -> frozenset[str]:
        """What a probability may stand for: of two effects, also that neither explains the data alone."""
        return self.names | {NONPARAMETRIC} if self.label == SECOND else self.names
