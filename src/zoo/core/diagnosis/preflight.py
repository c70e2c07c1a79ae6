"""What is checked with at most ten solves before a search: mistakes that would make it worthless."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence

from zoo.core.diagnosis.file import DiagnosisError
from zoo.core.diagnosis.fitting import Fitting
from zoo.core.effects import Effect
from zoo.core.forward import ForwardModel
from zoo.core.words import listed

MOST = 10
"""Solves at most."""
STEADY = 1e-6
"""Rms difference of two solves at the same parameters, in parts of the range, up to which they are one."""
SEARCH = 190
"""Solves that a search of two parameters and two effects takes; others take it in proportion."""


def preflight(
    fitting: Fitting, model: ForwardModel, effects: Sequence[Effect], tick: Callable[[str, float], None]
) -> None:
    """Solve the baseline twice and each effect once, and say how long a search may take.

    Parameters
    ----------
    fitting : Fitting
    model : ForwardModel
        The baseline, which solves anew whatever it is asked for.
    effects : sequence of Effect
    tick : callable
        Called with a text and the share done.

    Raises
    ------
    DiagnosisError
        If two solves at the same parameters differ.

    Warns
    -----
    UserWarning
        Of an effect none of whose starts changes a sample, as where the simulator does not read what it sets.
    """
    began, baseline = time.monotonic(), fitting.forward
    first, again = baseline(baseline.start), fitting.model(baseline=model)(baseline.start)
    if first is None or again is None:  # another start may do better
        return
    apart = fitting.family.relative(first - again)
    if apart > STEADY:
        raise DiagnosisError(
            f"{model.name}: two solves at the same parameters differ by {apart:.2g} of the data's range: fix "
            "its random numbers, by a seed inside of the simulator, so that it computes the same each time"
        )
    solves = 2
    for one in effects:
        places, starts = one.locations(model), one.parameters[0].starts
        if len(places) != 1 or solves + len(starts) > MOST:
            continue
        changed = fitting.model((one.at(places[0]),))
        for start in starts:
            u = changed.start
            u[baseline.n_base] = changed.parameters[baseline.n_base].coordinate(start)
            solves += 1
            series = changed(u)
            if series is None or (series != first).any():
                break
        else:
            sizes = listed(f"{x:g}" for x in starts)
            warnings.warn(
                f"effect {one.name}: {one.parameters[0].name} = {sizes} changes no sample of "
                f"{model.name}, as where the simulator does not read what the effect sets",
                stacklevel=2,
            )
    seconds = (time.monotonic() - began) / solves
    size = (len(baseline.low) + len(effects)) / 4.0
    least = SEARCH * size
    tick(f"at least {least:.0f} solves of {seconds:.2g} s: {least * seconds / 60.0:.1g} min", 0.0)
