"""Input impedance of a tree at its root: measured, of the baseline, and with the leading set of causes."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from zoo.blood.impedance import Impedance, ImpedanceError, measured_impedance, modelled_impedance
from zoo.core.forward import SolveError
from zoo.plots.style import COLOURS, DASHED, INK, grid_behind, handles_of, legend_below, new_figure
from zoo.plots.subject import study_of


def impedances_of(d: Any) -> dict[str, Impedance]:
    """Input impedance of a study: measured, of the baseline, and with the leading set of causes.

    Parameters
    ----------
    d : Diagnosis

    Returns
    -------
    dict of str to Impedance
        Empty where there is no study, or the pressure at the root's inlet is not observed.
    """
    if study_of(d) is None or "pressure_mmHg" not in d.sets.noise:
        return {}
    base = d.sets.search.fitted
    plain = base.forward.model.configure(base.forward.theta(base.point.u))
    try:
        found = {"measured": measured_impedance(d.data, plain, noise_mmHg=d.sets.noise["pressure_mmHg"])}
    except ImpedanceError:
        return {}
    last = len(found["measured"].value) - 1
    solved = {"baseline": base}
    if d.sets.leader:
        solved[f"baseline + {d.sets.name(d.sets.leader)}"] = d.sets.solved[d.sets.leader]
    for name, one in solved.items():
        try:
            case = one.forward.model.configure(one.forward.theta(one.point.u))
            found[name] = modelled_impedance(case, recorded_ml_s=plain.inflow_ml_s, harmonics=last)
        except SolveError:
            continue
    return found


def impedance_figure(found: dict[str, Impedance]) -> Figure:
    """Modulus and phase of input impedances by harmonic.

    Parameters
    ----------
    found : dict of str to Impedance
        "measured", with its intervals, and others.

    Returns
    -------
    matplotlib.figure.Figure
        Two panels; bars are 95 % intervals. Hollow dots are harmonics in which the flow is nearly zero: there
        the impedance says more of the flow record than of the tree.
    """
    own = found["measured"]
    k = np.arange(len(own.value))
    with new_figure((6.8, 4.8)) as figure:
        top, bottom = figure.subplots(2, 1, sharex=True)
        for axes, value, low, high in (
            (top, own.modulus, own.modulus_low, own.modulus_high),
            (bottom, own.phase, own.phase_low, own.phase_high),
        ):
            axes.vlines(k, low, high, color=INK, lw=1.2, alpha=0.6)
            axes.plot(k[~own.weak], value[~own.weak], "o", color=INK, ms=5, label="measured, 95 %")
            axes.plot(
                k[own.weak], value[own.weak], "o", color=INK, mfc="white", ms=5, label="measured, weak flow"
            )
            grid_behind(axes, "y")
        others = [name for name in found if name != "measured"]
        for name, colour, line in zip(others, (COLOURS[1], COLOURS[0]), (DASHED, "-"), strict=False):
            top.plot(k, found[name].modulus, color=colour, ls=line, lw=1.3, label=name)
            bottom.plot(k, found[name].phase, color=colour, ls=line, lw=1.3)
        top.set_yscale("log")
        top.set_ylabel("modulus (mmHg s/ml)")
        bottom.set_ylabel("phase (rad)")
        bottom.set_xlabel(f"harmonic of the beat ({own.frequency_Hz[1]:.3g} Hz)")
        legend_below(figure, handles_of(top), 2)
    return figure
