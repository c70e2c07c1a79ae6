"""`zoo simulate`: one solve, every vessel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from zoo.cli.checks import numbers
from zoo.cli.command import Role, UsageError, Without, command, option
from zoo.cli.options import STUDY, StudyOptions
from zoo.cli.screen import say, warn
from zoo.core.outputs import output_file, write_file

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from zoo.blood.solver import Solution
    from zoo.blood.study import Study

POSITIONS = (0.0, 0.5, 1.0)
WALLS = ("stiffness_out_g_cm_s2", "youngs_modulus_g_cm_s2", "wall_thickness_cm", "wall_thickness_out_cm")
"""Fields of a vessel in whose place a stiffness stands."""


@command
def simulate(
    study: str = STUDY,
    wall: str | None = option(None, "linear (eq. 3.3), tangent (eq. 3.4) or olufsen; the study's if absent."),
    stiffness: str | None = option(
        None, "chi, g/(cm s2): one value, or one per vessel with commas; the study's if absent."
    ),
    f1: float | None = option(None, "chi = f1 exp(f2 r0) + f3 (eq. 3.5)."),
    f2: float | None = option(None, "See --f1."),
    f3: float | None = option(None, "See --f1; alone it is the stiffness."),
    gamma: str | None = option(None, "Shape of the tangent wall: one value, or one per vessel."),
    psi1: str = option("1", "Factor on R1: one value, or one per vessel."),
    psi2: str = option("1", "Factor on R2."),
    c: str = option("1", "Factor on C."),
    output: Path | None = option(
        None, "waves.nc, or waves.csv in the long format.", "--output", "-o", Role.WRITES
    ),
    plot: Path | None = option(None, "Figure of the waves: .png, .pdf or .svg.", Role.WRITES),
    times: int = option(512, "Times in the beat, from its start."),
    *,
    options: Annotated[StudyOptions, Without("fix")],
) -> None:
    """Solve at one set of parameters: every vessel at positions 0, 0.5 and 1; pressure, flow and area."""
    import numpy as np

    from zoo.blood.network import Network
    from zoo.blood.physics import physics_words
    from zoo.blood.resolution import resolve_solver
    from zoo.blood.solver import Solver
    from zoo.blood.study import check_physics

    loaded = options.load(study)
    if output is not None and output_file(output, "--output").suffix not in (".nc", ".csv"):
        raise UsageError(f"--output {output}: unknown ending {output.suffix!r}; use .nc or .csv")
    if plot is not None:
        from zoo.plots import figure_path

        figure_path(output_file(plot, "--plot"))
    if times < 2:
        raise UsageError(f"--times {times}: give at least 2 times in the beat")
    wall = loaded.wall if wall is None else wall
    if wall == "tangent" and gamma is None:
        raise UsageError("--wall tangent needs --gamma, such as --gamma 5.2")
    if wall != "tangent" and gamma is not None:
        raise UsageError("--gamma belongs to the tangent wall: add --wall tangent, or leave it out")
    given = _stiffness(stiffness, f1, f2, f3, loaded)
    if given is not None:
        for key in options.changes():
            if key.removeprefix("vessel.") in (*WALLS, "stiffness_g_cm_s2"):
                raise UsageError(
                    f"--set {key}: --stiffness or --f3 stands in its place; leave one of them out"
                )
        walls: list[dict[str, Any]] = [dict.fromkeys(WALLS) | {"stiffness_g_cm_s2": value} for value in given]
        vessels = tuple(replace(v, **wall) for v, wall in zip(loaded.vessels, walls, strict=True))
        check_physics(vessels, radius_pressure_mmHg=loaded.radius_pressure_mmHg)
        loaded = replace(loaded, vessels=vessels)
    network = Network.from_study(loaded)
    order = [[v.id for v in loaded.vessels].index(int(i)) for i in network.ids]

    def each(option: str, text: str) -> np.ndarray:
        values = np.array(numbers(option, text, loaded))
        if np.any(values <= 0):
            raise UsageError(f"{option} {text}: must be positive")
        return values[order] if len(values) > 1 else np.full(len(order), values[0])

    parameters: dict[str, Any] = {
        "stiffness": network.stiffness_in,
        "gamma": each("--gamma", gamma if gamma is not None else "2"),
        "psi1": each("--psi1", psi1),
        "psi2": each("--psi2", psi2),
        "c": each("--c", c),
    }
    resolution = resolve_solver(loaded, Solver.for_study(loaded, wall), **parameters)
    time_s = np.arange(times) * loaded.period_s / times
    positions = [(int(i), p) for i in network.ids for p in POSITIONS]
    solver = Solver.for_study(loaded, wall, series=positions, times_s=time_s, options=resolution.options)
    solution = solver.solve(**parameters)
    waves = _waves(solution, [int(i) for i in network.ids], time_s)
    waves.attrs |= {
        "study": loaded.name,
        "study_checksum": loaded.checksum,
        "conventions": loaded.conventions.name,
        "wall": wall,
        "physics": "; ".join(physics_words(loaded)),
        "beats": solution.beats,
        "steps_per_beat": solution.steps_per_beat,
        "distance_from_periodic_state_mmHg": solution.distance_mmHg,
        "grid": resolution.text,
    }
    for name, values in parameters.items():
        unit = "g cm-1 s-2" if name == "stiffness" else "1"
        waves[name] = ("vessel", values, {"units": unit})
    if output is not None:
        _write_waves(waves, output)
    if plot is not None:
        from zoo.plots import save_figure, waves_figure

        save_figure(waves_figure(waves, loaded), plot)
    error = {}
    if loaded.series:
        at_data = Solver.for_study(loaded, wall, options=resolution.options).solve(**parameters)
        error = {s.quantity: 0.0 for s in loaded.series}
        for i, s in enumerate(loaded.series):
            error[s.quantity] += float(np.nansum(np.square(getattr(at_data, s.quantity)[i] - s.value)))
    say(*_simulation_summary(loaded, wall, physics_words(loaded), waves, solution, error), resolution.text)
    say(*(f"wrote {path}" for path in (output, plot) if path is not None))


def _stiffness(
    stiffness: str | None, f1: float | None, f2: float | None, f3: float | None, study: Study
) -> list[float] | None:
    """A stiffness for each vessel in the study's order; None for the study's or the walls' own."""
    from zoo.blood.baseline import get_baseline
    from zoo.blood.network import stiffness_profile
    from zoo.core.parameters import start_of

    profile = [f1, f2, f3]
    if stiffness is not None:
        if any(value is not None for value in profile):
            raise UsageError("--stiffness and --f1 --f2 --f3 are two ways to say the same: give one of them")
        values = numbers("--stiffness", stiffness, study)
        return values if len(values) > 1 else values * len(study.vessels)
    if f3 is None and f1 is None and f2 is None and any(v.stiffness for v in study.vessels):
        return None
    if f3 is None and f1 is None and f2 is None:
        f3 = float(start_of(get_baseline("linear-constant").forward(study).parameters)["f3"])
        warn(
            f"no stiffness is given: solved with {f3:.3g} g cm-1 s-2, where the prior of this study begins "
            "(`zoo priors`); give --stiffness, or --f3 (with --f1 and --f2 for eq. 3.5)"
        )
    if f3 is None:
        raise UsageError("--f1 and --f2 need --f3 in chi = f1 exp(f2 r0) + f3: give it too")
    if (f1 is None) != (f2 is None):
        raise UsageError(
            "--f1 and --f2 belong together in chi = f1 exp(f2 r0) + f3: give both, or --f3 alone"
        )
    unit = study.conventions.stiffness_radius_unit_cm
    radius_cm = [v.radius_cm for v in study.vessels]
    return [float(x) for x in stiffness_profile(radius_cm, f1 or 0.0, f2 or 0.0, f3, unit)]


def _waves(solution: Solution, vessels: Sequence[int], time_s: np.ndarray) -> xr.Dataset:
    """Dataset with dimensions vessel, position, time."""
    import xarray as xr

    from zoo.blood.case import UNITS

    shape = (len(vessels), len(POSITIONS), len(time_s))
    waves = xr.Dataset(
        {
            quantity: (
                ("vessel", "position", "time"),
                getattr(solution, quantity).reshape(shape),
                {"units": unit},
            )
            for quantity, unit in UNITS.items()
        },
        coords={
            "vessel": list(vessels),
            "position": ("position", list(POSITIONS), {"units": "1"}),
            "time": ("time", time_s, {"units": "s"}),
        },
    )
    return waves


def _write_waves(waves: xr.Dataset, path: Path) -> None:
    if path.suffix == ".nc":
        write_file(path, waves.to_netcdf(engine="h5netcdf"))
        return
    from zoo.blood.case import UNITS

    long = waves[list(UNITS)].to_array("quantity", name="value").rename(time="time_s")
    table = long.transpose("vessel", "position", "quantity", "time_s").to_series()
    write_file(path, table.to_csv(float_format="%.9g"))


def _simulation_summary(
    study: Study,
    wall: str,
    physics: Sequence[str],
    waves: xr.Dataset,
    solution: Solution,
    sse: Mapping[str, float],
) -> list[str]:
    from zoo.blood.case import UNITS
    from zoo.core.data import squared

    root = next(v for v in study.vessels if v.parent is None)
    pressure = waves["pressure_mmHg"].sel(vessel=root.id, position=0.0).to_numpy()
    flow = waves["flow_ml_s"].sel(vessel=root.id, position=0.0).to_numpy()
    lines = [
        f"{study.name}: {wall} wall, conventions {study.conventions.name}",
        *physics,
        f"pressure at the inlet of {root.name or f'vessel {root.id}'}: systolic {pressure.max():.2f}, "
        f"diastolic {pressure.min():.2f}, mean {pressure.mean():.2f} mmHg; mean flow {flow.mean():.4f} ml/s",
        f"periodic after {solution.beats} beats of {solution.steps_per_beat} steps, "
        f"{solution.distance_mmHg:.1g} mmHg from the periodic state; status: {solution.reason or 'ok'}",
    ]
    for quantity, value in sse.items():  # of different units, so not added
        n = sum(s.n_samples for s in study.series if s.quantity == quantity)
        name, unit = quantity.split("_")[0], squared(UNITS[quantity])
        lines.append(f"sum of squared errors against the {n} observed values of {name}: {value:.4g} {unit}")
    return lines
