"""What is checked with at most ten solves before a search: mistakes that would make it worthless."""

from __future__ import annotations

import pickle
import time
import warnings
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from zoo.core.diagnosis.coordinates import SearchModel
from zoo.core.diagnosis.file import DiagnosisError
from zoo.core.diagnosis.fitting import Fitting
from zoo.core.effects import AddedEffect, Effect
from zoo.core.forward import ForwardModel
from zoo.core.words import listed, unit_words

Array = NDArray[np.float64]

MOST = 10
"""Solves at most."""
TOGETHER = 4
"""Of these, how many are kept for effects together once one changed nothing by itself."""
STEADY = 1e-6
"""Rms difference of two solves at the same parameters, in parts of the range, up to which they are one."""
NEAR = 1e-12
"""Part of an effect's first start at which it has to be as good as absent."""
SEARCH = 100
"""Solves that a search of two parameters and two effects takes at least; others take it in proportion."""


def preflight(
    fitting: Fitting, model: ForwardModel, effects: Sequence[Effect], tick: Callable[[str, float], None]
) -> None:
    """Solve the baseline twice and effects, each or together, and say how long a search may take.

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
        Of an effect none of whose starts changes a sample, as where the simulator does not read what it sets
        or a threshold is not reached; of one that changes the series even at a size next to 0; of two that do
        the same.
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
    solves, seen, silent = 2, dict[bytes | str, str](), list[AddedEffect]()
    for one in effects:
        places, amplitude = one.locations(model), one.parameters[0]
        if len(places) != 1:
            continue
        changed = fitting.model((one.at(places[0]),))
        same = seen.setdefault(_configured(changed) or one.name, one.name)
        if same != one.name:
            warnings.warn(
                f"effects {same} and {one.name} do the same to {model.name}: leave one of them out, since "
                "their probability is divided between them",
                stacklevel=2,
            )
        left = MOST - solves - TOGETHER * bool(silent)
        silent += changed.added
        if left <= 0 or not amplitude.low <= 0.0 <= amplitude.high:
            continue  # without 0 it replaces a part at any size
        u, start = changed.start, NEAR * amplitude.starts[0]
        u[baseline.n_base] = changed.parameters[baseline.n_base].coordinate(start)
        solves += 1
        series = changed(u)
        if series is None or (series != first).any():
            silent.pop()
        if series is not None and fitting.family.relative(series - first) > STEADY:
            warnings.warn(_jump(fitting, changed, u, start), stacklevel=2)

    def idle(group: Sequence[AddedEffect]) -> list[AddedEffect]:
        """Those that change nothing at any start, sought in all of them together, then in halves."""
        nonlocal solves
        together, half = fitting.model(tuple(group)), len(group) // 2
        starts = [one.effect.parameters[0].starts for one in group]
        for k in range(max(map(len, starts), default=0)):
            if solves == MOST:
                return []
            u, at = together.start, baseline.n_base
            for one, sizes in zip(group, starts, strict=True):
                u[at] = together.parameters[at].coordinate(sizes[min(k, len(sizes) - 1)])
                at += len(one.effect.parameters)
            solves += 1
            try:
                series = together(u)
            except Exception:  # what is wrong with one is told where it is solved alone
                if not half:
                    raise
                series = None
            if series is None or (series != first).any():
                return [*idle(group[:half]), *idle(group[half:])] if half else []
        return list(group)

    for added in idle(silent):
        sizes = listed(f"{x:g}" for x in added.effect.parameters[0].starts)
        warnings.warn(
            f"effect {added.name}: {added.effect.parameters[0].name} = {sizes} changes no sample of "
            f"{model.name} before its parameters are fitted: the simulator does not read what the effect "
            "sets, or a threshold is not reached there",
            stacklevel=2,
        )
    seconds = (time.monotonic() - began) / solves
    size = (len(baseline.low) + len(effects)) / 4.0
    least = SEARCH * size
    tick(f"at least {least:.0f} solves of {seconds:.2g} s: {least * seconds / 60.0:.1g} min", 0.0)


def _configured(changed: SearchModel) -> bytes | None:
    """What is solved with an effect at its first start, to compare it with another's; None if unknown."""
    try:
        return pickle.dumps(changed.model.configure(changed.theta(changed.start)), protocol=5)
    except Exception:  # what is wrong with it is told where it is solved
        return None


def _jump(fitting: Fitting, changed: SearchModel, u: Array, size: float) -> str:
    """That an effect changes the series where its size is next to 0: which one, and by how much."""
    data, model, [one] = fitting.data, fitting.forward, changed.added
    found, without = changed.series(u), model.series(model.start)
    assert found is not None
    assert without is not None
    rms = np.sqrt(np.mean((found - without) ** 2, axis=1))
    i = int(np.argmax(rms / np.ptp(data.values, axis=1)))
    much = f"{data.labels[i]} of {model.model.name} by {rms[i]:.2g}{unit_words(data.units[i])} (rms)"
    return (
        f"effect {one.name}: {one.effect.parameters[0].name} = {size:.2g} already changes {much}, although 0 "
        "is the baseline: let what its function changes vanish with the size; if it replaces a part of the "
        "simulator, give it bounds without 0"
    )
