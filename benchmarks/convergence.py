"""Accuracy of the solver: order of convergence, beats to the periodic state, the published solver's waves.

Prints the tables that docs/numerics.md quotes and draws its figures.

Usage: python -m benchmarks.convergence [--figures docs/figures] [--finest 16]
"""

from __future__ import annotations

import argparse
import gzip
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from benchmarks.paun2020.synthetic import Truth
from matplotlib.figure import Figure
from numpy.typing import NDArray

from zoo.blood.conventions import PUBLISHED_CODE
from zoo.blood.fetch import FetchError
from zoo.blood.network import Network, stiffness_profile
from zoo.blood.resolution import GIVEN_CELLS_MMHG
from zoo.blood.solver import Solution, Solver, SolverError, SolverOptions
from zoo.blood.study import Study, load_study
from zoo.core.errors.gaussian_process import gp_sequential
from zoo.plots.style import COLOURS, INK, STYLE

Array = NDArray[np.float64]

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
# medians of models A and H in Table 4 of Paun et al. 2020, doi 10.1098/rsif.2020.0886
MEDIANS: dict[str, dict[str, Any]] = {
    "linear": {"stiffness": 5.17e4, "psi1": 0.21, "psi2": 0.88, "c": 1.44},
    "tangent": {"stiffness": 9.17e4, "gamma": 5.18, "psi1": 0.37, "psi2": 0.94, "c": 1.60},
}
SLOW = {"stiffness": 2e5, "psi1": 1.0, "psi2": 2.5, "c": 2.5}  # a corner of the prior's box
QUANTITIES = {"pressure_mmHg": "pressure (mmHg)", "flow_ml_s": "flow (ml/s)"}
STEPS = 2048  # of the coarsest grid in the study of convergence
TIGHT: dict[str, Any] = {"tolerance_mmHg": 1e-8, "max_beats": 400}


def smooth_inflow(study: Study) -> Study:
    """The study with an inflow that has all derivatives: 0.55 exp(4 - 1/(x (1 - x))) ml/s, x = t/0.058 s."""
    x = np.clip(np.arange(8192) / 8192 * study.period_s / 0.058, 1e-9, 1 - 1e-9)
    flow = np.where(x < 1 - 1e-9, 0.55 * np.exp(4.0 - 1.0 / (x * (1.0 - x))), 0.0)
    return replace(study, inflow_time_s=np.arange(8192) / 8192 * study.period_s, inflow_ml_s=flow)


def everywhere(study: Study) -> list[tuple[int, float]]:
    """Inlet and outlet of every vessel."""
    return [(v.id, x) for v in study.vessels for x in (0.0, 1.0)]


def solve(study: Study, wall: str, values: dict[str, Any], **options: Any) -> Solution:
    """Waves at both ends of every vessel, 256 times in the beat."""
    times = np.arange(256) * study.period_s / 256
    solver = Solver.for_study(
        study, wall, series=everywhere(study), times_s=times, options=SolverOptions(**options)
    )
    return solver.solve(**values)


def norms(difference: Array) -> tuple[float, float]:
    """Root mean square and maximum."""
    return float(np.sqrt(np.mean(difference**2))), float(np.abs(difference).max())


def order_of_convergence(studies: dict[str, Study], finest: int) -> dict[tuple[str, str, str], Array]:
    """Differences between successive grids, dx and dt halved together; prints them and the orders."""
    grids = [2**i for i in range(int(np.log2(finest)) + 1)]
    found: dict[tuple[str, str, str], Array] = {}
    print("== order of convergence: difference to the grid twice as fine, both ends of all vessels")
    print(f"grid r: cells of about 0.025/r cm, {STEPS} r steps per beat, to within 1e-8 mmHg of periodic")
    print(f"{'wall':8} {'inflow':7} {'quantity':14} {'r':>3} {'RMS':>9} {'maximum':>9}  order: RMS  maximum")
    for wall, values in MEDIANS.items():
        for inflow, study in studies.items():
            waves = [solve(study, wall, values, refine=r, steps_per_beat=STEPS, **TIGHT) for r in grids]
            for name in QUANTITIES:
                steps = [getattr(waves[i], name) - getattr(waves[i + 1], name) for i in range(len(grids) - 1)]
                sizes = np.array([norms(step) for step in steps])
                found[wall, inflow, name] = sizes
                for i, (rms, largest) in enumerate(sizes):
                    orders = np.log2(sizes[i - 1] / sizes[i]) if i else None
                    text = "" if orders is None else f"  {orders[0]:10.2f}  {orders[1]:7.2f}"
                    print(f"{wall:8} {inflow:7} {name:14} {grids[i]:3d} {rms:9.2e} {largest:9.2e}{text}")
    print()
    return found


def default_accuracy(studies: dict[str, Study]) -> None:
    """Default settings against a grid four times finer, solved to a tight periodic state."""
    print(
        "== default settings against a grid 4 times finer (steps 4 times shorter) at the tight periodic state"
    )
    print("largest differences at 256 times; MPA: its inlet and outlet; all: both ends of all vessels")
    print(
        f"{'study':9} {'wall':8} {'conventions':15} {'beats':>5} {'steps':>6} {'|u|+c':>6} "
        f"{'MPA mmHg':>9} {'outlet':>7} {'all mmHg':>9} {'all ml/s':>9}"
    )
    for study in studies.values():
        for wall, values in MEDIANS.items():
            coarse = solve(study, wall, values)
            fine = solve(study, wall, values, refine=4, steps_per_beat=coarse.steps_per_beat, **TIGHT)
            pressure = np.abs(coarse.pressure_mmHg - fine.pressure_mmHg)
            flow = np.abs(coarse.flow_ml_s - fine.flow_ml_s).max()
            print(
                f"{study.name:9} {wall:8} {study.conventions.name:15} {coarse.beats:5d} "
                f"{coarse.steps_per_beat:6d} {coarse.max_cfl:6.3f} {pressure[0].max():9.4f} "
                f"{pressure[1].max():7.4f} {pressure.max():9.4f} {flow:9.1e}"
            )
    print()


def likelihood(studies: dict[str, Study]) -> None:
    """What the grid does to the log-density of the Gaussian process, whose noise is 0.0019 mmHg."""
    print("== -2 log-likelihood of the Gaussian process (w 5.36e4, b 137) against the grid")
    print("mouse-c6: at model B's published medians; demo: at the parameters that made it")
    truth = Truth()
    grids: dict[str, dict[str, Any]] = {
        "default": {},
        "dx/2": {"refine": 2},
        "dx/4": {"refine": 4},
        "dx/8": {"refine": 8},
    }
    print(f"{'study':9} " + " ".join(f"{name:>10}" for name in grids))
    for study in studies.values():
        values: dict[str, Any] = {"stiffness": 4.31e4, "psi1": 0.28, "psi2": 0.87, "c": 1.35}
        if study.name == "demo":
            radius = Network.from_study(study).radius_in_cm
            values = {name: getattr(truth, name) for name in ("psi1", "psi2", "c")}
            values["stiffness"] = stiffness_profile(radius, truth.f1, truth.f2, truth.f3)
        cells = []
        for options in grids.values():
            solver = Solver.for_study(study, options=SolverOptions(**options))
            residual = study.values - solver.solve(**values).pressure_mmHg
            cells.append(-2.0 * gp_sequential(residual, study.time_s, 5.36e4, 137.0).sum())
        print(f"{study.name:9} " + " ".join(f"{cell:10.1f}" for cell in cells))
    print()


def conservation(studies: dict[str, Study]) -> None:
    """Volume over a periodic beat and flow at junctions."""
    print("== conservation over the last beat, at a tolerance of 1e-7 mmHg")
    print(
        f"{'study':9} {'wall':8} {'inflow ml':>10} {'(out - in)/in':>14} {'largest junction defect ml/s':>29}"
    )
    for study in studies.values():
        for wall, values in MEDIANS.items():
            s = solve(study, wall, values, tolerance_mmHg=1e-7, max_beats=400)
            print(
                f"{study.name:9} {wall:8} {s.inflow_ml:10.6f} {s.outflow_ml / s.inflow_ml - 1:14.1e} "
                f"{s.junction_defect_ml_s:29.1e}"
            )
    print()


def beats_to_periodicity(study: Study) -> dict[str, dict[str, Array]]:
    """True distance from the periodic state against beats, plain and extrapolated; prints those needed."""
    cases = {"A, linear": ("linear", MEDIANS["linear"]), "H, tangent": ("tangent", MEDIANS["tangent"])}
    cases["slow, linear"] = ("linear", SLOW)
    wanted = (1e-1, 1e-2, 2e-3, 1e-4, 1e-6)
    print("== beats until the estimated distance from the periodic state is below a tolerance, mmHg")
    print(
        "slow: stiffness 2e5, psi1 1, psi2 2.5, c 2.5; the distance is the largest in any vessel, at any time"
    )
    print(
        f"{'case':13} {'beats':13} " + " ".join(f"{t:>7g}" for t in wanted) + "   true / estimated distance"
    )
    found: dict[str, dict[str, Array]] = {}
    for case, (wall, values) in cases.items():
        steps = solve(study, wall, values).steps_per_beat
        exact = solve(study, wall, values, steps_per_beat=steps, tolerance_mmHg=1e-10, max_beats=400)
        found[case] = {}
        for kind, accelerate in (("plain", False), ("extrapolated", True)):
            points: dict[int, tuple[float, float]] = {}
            for tolerance in np.geomspace(3.0, 1e-7, 90):
                try:
                    s = solve(
                        study,
                        wall,
                        values,
                        steps_per_beat=steps,
                        tolerance_mmHg=float(tolerance),
                        max_beats=60,
                        accelerate=accelerate,
                    )
                except SolverError:
                    break
                away = float(np.abs(s.pressure_mmHg - exact.pressure_mmHg).max())
                points[s.beats] = (s.distance_mmHg, away)
            beats = np.array(list(points), dtype=float)
            distance = np.array(list(points.values()))
            found[case][kind] = np.column_stack([beats, distance])
            needed = [beats[distance[:, 0] <= t] for t in wanted]
            cells = " ".join(f"{int(n[0]) if len(n) else '> 60':>7}" for n in needed)
            known = distance[(distance[:, 1] > 1e-7) & (distance[:, 0] < 1.0)]
            ratio = known[:, 1] / known[:, 0]
            print(f"{case:13} {kind:13} {cells}   {ratio.min():.2g} to {ratio.max():.2g}")
    print()
    return found


def published_waveforms(study: Study) -> tuple[Array, Array, Array] | None:
    """The published solver's waves at model A's medians, or None when ZOO_DATA_DIR does not hold them.

    Returns
    -------
    time_s : array (512,)
        Row k stands for step 16 (k + 1) of 8192, see docs/conventions.md.
    pressure, flow : array (42, 512)
        mmHg and ml/s, at both ends of every vessel.
    """
    path = Path(os.environ.get("ZOO_DATA_DIR", "")) / "reference" / "linear_constant_A.csv.gz"
    if not path.is_file():
        return None
    with gzip.open(path, "rt") as file:
        table = np.loadtxt(file, delimiter=",", skiprows=1)
    step = 16 * (np.arange(len(table)) + 1) % 8192
    return step * study.period_s / 8192, table[:, 1::2].T, table[:, 2::2].T


def against_the_published_solver(study: Study) -> dict[str, Array] | None:
    """Default solve with its conventions against its waves; prints the differences."""
    given = published_waveforms(study)
    if given is None:
        print("== the published solver's waveforms: not in ZOO_DATA_DIR, left out")
        return None
    times, pressure, flow = given
    solver = Solver.for_study(study, "linear", series=everywhere(study), times_s=times)
    s = solver.solve(**MEDIANS["linear"])
    difference = s.pressure_mmHg - pressure
    rms = np.sqrt(np.mean(difference**2, axis=1))
    worst = int(np.argmax(rms))
    vessel, position = everywhere(study)[worst]
    print("== against the published solver (model A's medians, its conventions): pressure mmHg, flow ml/s")
    print(f"MPA, inlet:  RMS {rms[0]:.4f}, maximum {np.abs(difference[0]).max():.4f}")
    print(f"MPA, outlet: RMS {rms[1]:.4f}, maximum {np.abs(difference[1]).max():.4f}")
    print(
        f"all vessels: RMS at most {rms.max():.4f} (vessel {vessel} at {position:g}), "
        f"maximum {np.abs(difference).max():.4f}; flow: maximum {np.abs(s.flow_ml_s - flow).max():.5f}"
    )
    print()
    order = np.argsort(times)
    return {
        "time": times[order],
        "ours": s.pressure_mmHg[:, order],
        "theirs": pressure[:, order],
        "rms": rms,
    }


def save(figure: Figure, path: Path) -> None:
    """An SVG that does not change from run to run, with its text as text."""
    with mpl.rc_context({**STYLE, "svg.hashsalt": "zoo", "svg.fonttype": "none"}):
        figure.savefig(path, metadata={"Date": None})
    print(f"wrote {path}")


def draw_convergence(found: dict[tuple[str, str, str], Array], path: Path) -> None:
    """Difference to the next grid over the cell length, with lines of slope 2."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.6, 3.6), layout="constrained")
        for axes, (name, label) in zip(figure.subplots(1, 2), QUANTITIES.items(), strict=True):
            for i, wall in enumerate(MEDIANS):
                for inflow, mark in (("smooth", "o-"), ("demo", "s--")):
                    rms = found[wall, inflow, name][:, 0]
                    dx = 0.025 / 2.0 ** np.arange(len(rms))
                    axes.loglog(
                        dx, rms, mark, color=COLOURS[i], ms=4, lw=1.2, label=f"{wall} wall, {inflow} inflow"
                    )
            top = max(found[wall, "smooth", name][0, 0] for wall in MEDIANS)
            axes.loglog(dx, 2.2 * top * (dx / dx[0]) ** 2, color=INK, lw=1, ls=":", label="slope 2")
            axes.set_xticks(dx, [f"{x:.3g}" for x in dx])
            axes.minorticks_off()
            axes.set_xlabel("cell length (cm)")
            axes.set_title(label)
        figure.axes[0].set_ylabel("RMS difference to the next grid")
        lines, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(lines, labels, loc="outside lower center", ncols=3, fontsize="small")
    save(figure, path)


def draw_beats(found: dict[str, dict[str, Array]], path: Path) -> None:
    """True distance from the periodic state over the beats computed."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.6, 3.2), layout="constrained")
        for axes, (case, kinds) in zip(
            figure.subplots(1, len(found), sharey=True), found.items(), strict=True
        ):
            for (kind, points), colour, mark in zip(kinds.items(), COLOURS, ("o-", "s-"), strict=False):
                axes.semilogy(points[:, 0], points[:, 2], mark, color=colour, ms=3.5, lw=1.2, label=kind)
            axes.axhline(GIVEN_CELLS_MMHG, color=INK, lw=1, ls=":", label="default tolerance")
            axes.set_title(case)
            axes.set_xlabel("beats")
            axes.set_xlim(0, None)
            axes.minorticks_off()
        figure.axes[0].set_ylabel("largest distance from the\nperiodic state (mmHg)")
        figure.axes[-1].legend(fontsize="small")
    save(figure, path)


def draw_published(waves: dict[str, Array], path: Path) -> None:
    """Waves of the MPA and two terminals, their differences, and the RMS difference of every vessel."""
    places = {0: "MPA, inlet", 9: "vessel 5, outlet", 41: "vessel 21, outlet"}
    every = slice(None, None, 3)
    time = 1e3 * waves["time"][every]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.6, 5.0), layout="constrained")
        grid = figure.add_gridspec(2, 2, height_ratios=(1.6, 1))
        top, below = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])
        bars = figure.add_subplot(grid[:, 1])
        for (row, label), colour in zip(places.items(), COLOURS, strict=False):
            top.plot(time, waves["theirs"][row, every], color=colour, lw=3, alpha=0.35)
            top.plot(time, waves["ours"][row, every], color=colour, lw=1, label=label)
            below.plot(time, waves["ours"][row, every] - waves["theirs"][row, every], color=colour, lw=1)
        top.set_title("pressure (mmHg); broad: published solver")
        top.legend(fontsize="small")
        below.set_title("difference (mmHg)")
        below.set_xlabel("time in the beat (ms)")
        vessel = np.arange(1, len(waves["rms"]) // 2 + 1)
        for k, end in enumerate(("inlet", "outlet")):
            bars.barh(vessel + 0.4 * k - 0.2, waves["rms"][k::2], 0.38, color=COLOURS[k], label=end)
        bars.set_yticks(vessel)
        bars.invert_yaxis()
        bars.set_title("RMS difference in each vessel (mmHg)")
        bars.legend(fontsize="small")
    save(figure, path)


def main() -> None:
    """Print the tables and draw the figures."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0] if __doc__ else None)
    parser.add_argument("--figures", type=Path, default=FIGURES, help="folder to draw to")
    parser.add_argument("--finest", type=int, default=16, help="finest grid, a power of 2 of at least 4")
    given = parser.parse_args()
    given.figures.mkdir(parents=True, exist_ok=True)
    demo = load_study("demo")
    studies = {"demo": demo}
    try:
        studies["mouse-c6"] = load_study("mouse-c6")
    except FetchError as error:
        print(f"without mouse-c6: {error}\n")
    default_accuracy(studies)
    likelihood(studies)
    conservation(studies)
    beats = beats_to_periodicity(demo)
    draw_beats(beats, given.figures / "periodicity.svg")
    if "mouse-c6" in studies:
        waves = against_the_published_solver(load_study("mouse-c6", PUBLISHED_CODE))
        if waves is not None:
            draw_published(waves, given.figures / "published.svg")
    orders = order_of_convergence({"smooth": smooth_inflow(demo), "demo": demo}, given.finest)
    draw_convergence(orders, given.figures / "convergence.svg")


if __name__ == "__main__":
    main()
