"""What a diagnosis may be told about a field: phases of a record, candidate measurements, words."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.components import FreeFunction
from zoo.core.data import Data
from zoo.core.effects import Effect
from zoo.core.forward import ForwardModel

Array = NDArray[np.float64]
NOISE_PART = 0.01
"""Noise of a measurement that is only planned, as a part of its peak."""
QUARTERS = ("first quarter", "second quarter", "third quarter", "fourth quarter")


@dataclass(frozen=True)
class Candidate:
    """A measurement that could be made.

    Parameters
    ----------
    output : hashable
        What the forward model is asked for.
    words : mapping
        What it is, for diagnosis.json, such as {"vessel": 3, "position": 0.5}.
    group : str
        Group of observed series whose noise it would have; where none is observed, the next one counts.
    noise_part : float
        Noise as a part of its peak.
    text : str
        What it is in words, such as "flow midway in vessel 3".
    """

    output: Hashable
    words: Mapping[str, Any]
    group: str = ""
    noise_part: float = NOISE_PART
    text: str = ""


@dataclass(frozen=True)
class Hooks:
    """Optional knowledge of a field.

    Parameters
    ----------
    about : str or tuple of str
        Group of series whose discrepancy the verdict states, or groups of one unit; the first group if empty
        or not observed.
    phases : callable
        ``phases(data, rows) -> names, index``: names of the phases of a record and the phase (n_times,) of
        each sample. Quarters of the record if absent.
    candidates : callable
        ``candidates(data, baseline) -> sequence of Candidate``; none if absent.
    advice : str
        What to check where the baseline misses the data by far.
    labels : mapping of str to str
        What parameters of the baseline are called, by name; their own label or name if absent.
    warnings : tuple of str
        What is odd about the data themselves; they come first among the answer's.
    smooth : bool
        Whether solutions are smooth in the parameters down to rounding, so that a fit may end with
        differences as fine as its posterior; false for a solver whose time step follows its parameters.
    components : callable
        ``components(baseline, theta (n_values,), data) -> sequence of FreeFunction``: functions that
        components of the simulator may lack, for the baseline at those values of its parameters; none if
        absent.
    component_of : callable
        ``component_of(effect) -> str``: the component that a listed effect belongs to, empty if none; its
        family if absent.
    plausible : callable
        ``plausible(function, values (n_points,)) -> bool, sentence``: whether what was learned of a function
        can be believed, and why.
    """

    about: str | tuple[str, ...] = ""
    phases: Callable[[Data, list[int]], tuple[Sequence[str], NDArray[np.int_]]] | None = None
    candidates: Callable[[Data, ForwardModel], Sequence[Candidate]] | None = None
    advice: str = "check units, inputs and parameters"
    labels: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    smooth: bool = True
    components: Callable[[ForwardModel, Array, Data], Sequence[FreeFunction]] | None = None
    component_of: Callable[[Effect], str] = attrgetter("family")
    plausible: Callable[[FreeFunction, Array], tuple[bool, str]] | None = None

    def rows(self, data: Data) -> list[int]:
        """Series that the verdict is about."""
        asked = (self.about,) if isinstance(self.about, str) else self.about
        there = [group for group in asked if group in data.rows] or data.groups[:1]
        return [i for group in there for i in data.rows[group]]

    def phases_of(self, data: Data, rows: list[int]) -> tuple[tuple[str, ...], NDArray[np.int_]]:
        """Names of the phases, and that of each sample."""
        if self.phases is None:
            return QUARTERS, np.arange(data.n_times) * len(QUARTERS) // data.n_times
        names, index = self.phases(data, rows)
        return tuple(names), np.asarray(index)
