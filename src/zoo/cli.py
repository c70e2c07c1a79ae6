"""The command `zoo`: data, simulation, sampling, comparison, diagnosis; each imports only what it needs."""

from __future__ import annotations

import functools
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer

from zoo.models import MODELS

if TYPE_CHECKING:
    import arviz as az
    import numpy as np
    import xarray as xr

    from zoo.blood.blind import Score
    from zoo.blood.conventions import Conventions
    from zoo.blood.effects import Effect
    from zoo.blood.solver import Solution
    from zoo.blood.study import Study
    from zoo.core.diagnosis.diagnosis import DiagnosisFile

POSITIONS = (0.0, 0.5, 1.0)
QUANTITIES = ("pressure_mmHg", "flow_ml_s", "area_cm2")
DEFAULT_ESS = 400.0
FIRST_CHECK = 500

app = typer.Typer(
    name="zoo",
    help="Bayesian models of pulmonary blood flow: from one beat of measurements to a comparison of models.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
_debug = False


class UsageError(ValueError):
    """An option that cannot be used; its text says what to change."""


@app.callback()
def main(
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks of errors.")] = False,
) -> None:
    """Options of all commands."""
    global _debug
    _debug = debug or bool(os.environ.get("ZOO_DEBUG"))


Command = TypeVar("Command", bound=Callable[..., None])


def _reporting(command: Command) -> Command:
    """Turn errors into one red line and an exit code: 2 for what the user can change, 1 for our faults."""

    @functools.wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        try:
            command(*args, **kwargs)
        except typer.Exit:
            raise
        except KeyboardInterrupt:
            _complain("interrupted; the same command goes on from its checkpoint if it has one")
            raise typer.Exit(130) from None
        except Exception as error:
            if _debug:
                raise
            ours = any(kind.__module__.split(".")[0] in ("zoo", __name__) for kind in type(error).__mro__)
            text = " ".join(str(error).split()) or type(error).__name__
            if isinstance(error, FileExistsError | NotADirectoryError):
                text = f"{error.filename}: is a file where a folder is needed; choose another path"
            if ours or isinstance(error, OSError):
                _complain(text)
                raise typer.Exit(2) from None
            _complain(f"unexpected {type(error).__name__}: {text}; `zoo --debug ...` shows where")
            raise typer.Exit(1) from None

    return run  # type: ignore[return-value]


def _complain(text: str) -> None:
    from rich.console import Console
    from rich.text import Text

    Console(stderr=True).print(Text(f"error: {text}", style="red"), soft_wrap=True)


def _say(*lines: Any) -> None:
    from rich.console import Console
    from rich.text import Text

    for line in lines:
        Console().print(line, highlight=False, soft_wrap=isinstance(line, str | Text))


# -------------------------------------------------------------------------------------------------
# options that several commands share

StudyArgument = Annotated[
    str, typer.Argument(metavar="STUDY", help="A built-in study (see `zoo studies`) or a folder.")
]
ConventionsOption = Annotated[
    str | None,
    typer.Option(
        "--conventions", help="printed or published-code, instead of the study's own.", metavar="NAME"
    ),
]
WallFactor = Annotated[
    float | None, typer.Option("--wall-factor", help="Factor k of the tangent wall: p = k chi tan(...).")
]
RadiusUnit = Annotated[
    float | None, typer.Option("--stiffness-radius-unit", help="Unit of r0 in eq. 3.5, cm.", metavar="CM")
]
Friction = Annotated[
    str | None, typer.Option("--friction", help="Radius of the friction term: current, rest or fixed.")
]
FrictionRadius = Annotated[
    float | None, typer.Option("--friction-radius", help="That of `--friction fixed`, cm.", metavar="CM")
]
Truncate = Annotated[
    bool | None,
    typer.Option("--truncate-lengths/--true-lengths", help="Vessels of whole cells of 0.025 cm, or true."),
]
Mmhg = Annotated[float | None, typer.Option("--mmhg", help="dyn/cm2 in 1 mmHg.")]
SampleLag = Annotated[
    float | None,
    typer.Option(
        "--sample-lag", help="Compare this part of a beat after each sample's time.", metavar="BEATS"
    ),
]
Dx = Annotated[
    float | None, typer.Option("--dx", help="Target cell length, cm (default 0.025).", metavar="CM")
]
Steps = Annotated[int | None, typer.Option("--steps", help="Time steps in a beat; 0 chooses them.")]
Tolerance = Annotated[
    float | None,
    typer.Option("--tolerance", help="Accepted distance from the periodic state, mmHg.", metavar="MMHG"),
]


def _load(name: str, conventions: str | None, switches: Mapping[str, Any]) -> Study:
    """Study with the conventions of the options: a name, single switches, or both."""
    from zoo.blood.conventions import get_conventions
    from zoo.blood.study import load_study

    given = {switch: value for switch, value in switches.items() if value is not None}
    wanted: Conventions | None = None
    if conventions is not None or given:
        base = get_conventions(conventions) if conventions is not None else load_study(name).conventions
        wanted = base.replace(**given)
    return load_study(name, wanted)


def _switches(
    wall_factor: float | None,
    radius_unit: float | None,
    friction: str | None,
    friction_radius: float | None,
    truncate: bool | None,
    mmhg: float | None,
    sample_lag: float | None,
) -> dict[str, Any]:
    return {
        "wall_factor": wall_factor,
        "stiffness_radius_unit_cm": radius_unit,
        "friction": friction,
        "friction_radius_cm": friction_radius,
        "truncate_lengths": truncate,
        "mmhg": mmhg,
        "sample_lag_beats": sample_lag,
    }


def _options(dx: float | None, steps: int | None, tolerance: float | None) -> Any:
    from zoo.blood.solver import SolverOptions

    given: dict[str, Any] = {"dx_cm": dx, "steps_per_beat": steps, "tolerance_mmHg": tolerance}
    return SolverOptions(**{name: value for name, value in given.items() if value is not None})


def _numbers(option: str, text: str, study: Study) -> list[float]:
    """One value, or one for each vessel in the order of the study's network file."""
    values = []
    for part in text.split(","):
        try:
            values.append(float(part))
        except ValueError:
            raise UsageError(
                f"{option} {text}: {part.strip()!r} is not a number; write 5.17e4 or 4e4,5e4"
            ) from None
        if not math.isfinite(values[-1]):
            raise UsageError(f"{option} {text}: {part.strip()!r} is not finite; give a finite number")
    n = len(study.vessels)
    if len(values) not in (1, n):
        raise UsageError(
            f"{option}: {len(values)} values; give one for all vessels, or one for each of the {n} vessels "
            f"of {study.name}, with commas between them"
        )
    return values


def _model_names(text: str) -> list[str]:
    """Letters of models, given with commas."""
    return [_model_name(part) for part in text.split(",") if part.strip()]


def _different_models(text: str) -> list[str]:
    names = _model_names(text)
    if len(names) < 2 or len(set(names)) < len(names):
        raise UsageError(f"--models {text}: give at least two different models, such as --models A,B")
    return names


def _parent_exists(path: Path) -> Path:
    if not path.parent.is_dir():
        raise UsageError(f"{path}: folder {path.parent} does not exist; create it or choose another path")
    return path


# -------------------------------------------------------------------------------------------------
# data


@app.command()
@_reporting
def fetch(name: Annotated[str, typer.Argument(metavar="NAME", help="Data set, such as mouse-c6.")]) -> None:
    """Get measured data: from ZOO_DATA_DIR, this user's cache or the public source, checked by SHA-256."""
    from zoo.blood.fetch import fetch_dataset

    for path in fetch_dataset(name):
        _say(f"{path}  [green]sha256 as expected[/green]")


@app.command()
@_reporting
def studies() -> None:
    """List the built-in studies."""
    from rich.table import Table

    from zoo.blood.fetch import FetchError
    from zoo.blood.study import list_studies, load_study

    table = Table("study", "vessels", "period (s)", "observed", "conventions", box=None, pad_edge=False)
    for name in list_studies():
        try:
            study = load_study(name)
        except FetchError:
            table.add_row(name, "", "", f"its data are missing: zoo fetch {name}", "")
            continue
        observed = ", ".join(f"{s.label} ({len(s.value)} samples)" for s in study.series) or "nothing"
        table.add_row(name, str(len(study.vessels)), f"{study.period_s:g}", observed, study.conventions.name)
    _say(table)


@app.command()
@_reporting
def version() -> None:
    """Versions of this package and of the libraries that shape the draws."""
    from zoo.core.inference.results import versions

    for name, value in versions().items():
        _say(f"{name} {value}")


# -------------------------------------------------------------------------------------------------
# simulate


@app.command()
@_reporting
def simulate(
    study: StudyArgument,
    wall: Annotated[str, typer.Option("--wall", help="linear (eq. 3.3) or tangent (eq. 3.4).")] = "linear",
    stiffness: Annotated[
        str | None,
        typer.Option("--stiffness", help="chi, g/(cm s2): one value, or one per vessel with commas."),
    ] = None,
    f1: Annotated[float | None, typer.Option("--f1", help="chi = f1 exp(f2 r0) + f3 (eq. 3.5).")] = None,
    f2: Annotated[float | None, typer.Option("--f2", help="See --f1.")] = None,
    f3: Annotated[float | None, typer.Option("--f3", help="See --f1; alone it is the stiffness.")] = None,
    gamma: Annotated[
        str | None, typer.Option("--gamma", help="Of the tangent wall: one value, or one per vessel.")
    ] = None,
    psi1: Annotated[str, typer.Option("--psi1", help="Factor on R1: one value, or one per vessel.")] = "1",
    psi2: Annotated[str, typer.Option("--psi2", help="Factor on R2.")] = "1",
    c: Annotated[str, typer.Option("--c", help="Factor on C.")] = "1",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="waves.nc, or waves.csv in the long format.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Figure of the waves: .png, .pdf or .svg.")
    ] = None,
    times: Annotated[int, typer.Option("--times", help="Times in the beat, from its start.")] = 512,
    conventions: ConventionsOption = None,
    wall_factor: WallFactor = None,
    stiffness_radius_unit: RadiusUnit = None,
    friction: Friction = None,
    friction_radius: FrictionRadius = None,
    truncate_lengths: Truncate = None,
    mmhg: Mmhg = None,
    sample_lag: SampleLag = None,
    dx: Dx = None,
    steps: Steps = None,
    tolerance: Tolerance = None,
) -> None:
    """Solve at one set of parameters: every vessel at positions 0, 0.5 and 1; pressure, flow and area."""
    import numpy as np

    from zoo.blood.network import Network
    from zoo.blood.solver import Solver

    switches = _switches(
        wall_factor, stiffness_radius_unit, friction, friction_radius, truncate_lengths, mmhg, sample_lag
    )
    loaded = _load(study, conventions, switches)
    network = Network.from_study(loaded)
    if output is not None and _parent_exists(output).suffix not in (".nc", ".csv"):
        raise UsageError(f"--output {output}: unknown ending {output.suffix!r}; use .nc or .csv")
    if plot is not None:
        _parent_exists(plot)
    if times < 2:
        raise UsageError(f"--times {times}: give at least 2 times in the beat")
    if wall == "tangent" and gamma is None:
        raise UsageError("--wall tangent needs --gamma, such as --gamma 5.2")
    if wall == "linear" and gamma is not None:
        raise UsageError("--gamma belongs to the tangent wall: add --wall tangent, or leave it out")
    order = [[v.id for v in loaded.vessels].index(int(i)) for i in network.ids]

    def each(option: str, text: str) -> np.ndarray:
        values = np.array(_numbers(option, text, loaded))
        return values[order] if len(values) > 1 else np.full(len(order), values[0])

    parameters: dict[str, Any] = {
        "stiffness": _stiffness(stiffness, f1, f2, f3, loaded, network.radius_in_cm, each),
        "gamma": each("--gamma", gamma if gamma is not None else "2"),
        "psi1": each("--psi1", psi1),
        "psi2": each("--psi2", psi2),
        "c": each("--c", c),
    }
    options = _options(dx, steps, tolerance)
    time_s = np.arange(times) * loaded.period_s / times
    places = [(int(i), p) for i in network.ids for p in POSITIONS]
    solver = Solver.for_study(loaded, wall, series=places, times_s=time_s, options=options)
    solution = solver.solve(**parameters)
    waves = _waves(solution, [int(i) for i in network.ids], time_s)
    waves.attrs |= {
        "study": loaded.name,
        "study_checksum": loaded.checksum,
        "conventions": loaded.conventions.name,
        "wall": wall,
        "beats": solution.beats,
        "steps_per_beat": solution.steps_per_beat,
        "distance_from_periodic_state_mmHg": solution.distance_mmHg,
    }
    for name, values in parameters.items():
        waves[name] = ("vessel", values)
    if output is not None:
        _write_waves(waves, output)
    if plot is not None:
        from zoo.plots import save_figure, waves_figure

        save_figure(waves_figure(waves, loaded), plot)
    error = None
    if loaded.series:
        at_data = Solver.for_study(loaded, wall, options=options).solve(**parameters)
        rows = [getattr(at_data, s.quantity)[i] - s.value for i, s in enumerate(loaded.series)]
        error = float(np.sum(np.square(rows)))
    _say(*_simulation_summary(loaded, wall, waves, solution, error))
    _say(*(f"wrote {path}" for path in (output, plot) if path is not None))


def _stiffness(
    stiffness: str | None,
    f1: float | None,
    f2: float | None,
    f3: float | None,
    study: Study,
    radius_cm: np.ndarray,
    each: Callable[[str, str], np.ndarray],
) -> np.ndarray:
    from zoo.blood.network import stiffness_profile

    profile = [f1, f2, f3]
    if stiffness is not None:
        if any(value is not None for value in profile):
            raise UsageError("--stiffness and --f1 --f2 --f3 are two ways to say the same: give one of them")
        return each("--stiffness", stiffness)
    if f3 is None:
        raise UsageError("no stiffness: give --stiffness 5.17e4, or --f3 (with --f1 and --f2 for eq. 3.5)")
    if (f1 is None) != (f2 is None):
        raise UsageError(
            "--f1 and --f2 belong together in chi = f1 exp(f2 r0) + f3: give both, or --f3 alone"
        )
    unit = study.conventions.stiffness_radius_unit_cm
    return stiffness_profile(radius_cm, f1 or 0.0, f2 or 0.0, f3, unit)


def _waves(solution: Solution, vessels: Sequence[int], time_s: np.ndarray) -> xr.Dataset:
    """Dataset with dimensions vessel, position, time."""
    import xarray as xr

    shape = (len(vessels), len(POSITIONS), len(time_s))
    units = {"pressure_mmHg": "mmHg", "flow_ml_s": "ml/s", "area_cm2": "cm2"}
    waves = xr.Dataset(
        {
            quantity: (
                ("vessel", "position", "time"),
                getattr(solution, quantity).reshape(shape),
                {"units": unit},
            )
            for quantity, unit in units.items()
        },
        coords={
            "vessel": list(vessels),
            "position": list(POSITIONS),
            "time": ("time", time_s, {"units": "s"}),
        },
    )
    return waves


def _write_waves(waves: xr.Dataset, path: Path) -> None:
    if path.suffix == ".nc":
        waves.to_netcdf(path, engine="h5netcdf")
        return
    time_s = [f"{t:.9g}" for t in waves["time"].to_numpy()]
    with open(path, "w", newline="") as file:
        file.write("vessel,position,quantity,time_s,value\n")
        for vessel in waves["vessel"].to_numpy():
            for position in POSITIONS:
                for quantity in QUANTITIES:
                    values = waves[quantity].sel(vessel=vessel, position=position).to_numpy()
                    head = f"{vessel},{position:g},{quantity}"
                    file.writelines(f"{head},{t},{v:.9g}\n" for t, v in zip(time_s, values, strict=True))


def _simulation_summary(
    study: Study, wall: str, waves: xr.Dataset, solution: Solution, sse: float | None
) -> list[str]:
    root = next(v for v in study.vessels if v.parent is None)
    pressure = waves["pressure_mmHg"].sel(vessel=root.id, position=0.0).to_numpy()
    flow = waves["flow_ml_s"].sel(vessel=root.id, position=0.0).to_numpy()
    lines = [
        f"[bold]{study.name}[/bold]: {wall} wall, conventions {study.conventions.name}",
        f"pressure at the inlet of {root.name or f'vessel {root.id}'}: systolic {pressure.max():.2f}, "
        f"diastolic {pressure.min():.2f}, mean {pressure.mean():.2f} mmHg; mean flow {flow.mean():.4f} ml/s",
        f"periodic after {solution.beats} beats of {solution.steps_per_beat} steps, "
        f"{solution.distance_mmHg:.1g} mmHg from the periodic state; status: {solution.reason or 'ok'}",
    ]
    if sse is not None:
        n = sum(len(s.value) for s in study.series)
        lines.append(f"sum of squared errors against the {n} observed values: {sse:.4g}")
    return lines


# -------------------------------------------------------------------------------------------------
# sample


def _model_name(name: str) -> str:
    if name.strip().upper() not in MODELS:
        raise UsageError(f"model {name!r}: unknown; there is {', '.join(MODELS)}")
    return name.strip().upper()


def _model(name: str, study: Study) -> Any:
    import zoo

    return getattr(zoo, f"model_{name}")(study)


def _until(text: str | None, draws: int | None) -> float | None:
    """Effective sample size to reach; None for a fixed number of draws."""
    if text is None:
        return DEFAULT_ESS if draws is None else None
    if text.lower() == "none":
        return None
    name, _, number = text.partition("=")
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if name.strip().lower() != "ess" or not (math.isfinite(value) and value > 0):
        raise UsageError(
            f"--until {text}: write --until ess=400, or --until none for a fixed number of draws"
        )
    return value


DrawsOption = Annotated[
    int | None,
    typer.Option(
        "--draws", min=1, help="Stored draws of each chain; without it, until converged.", show_default=False
    ),
]
TuneOption = Annotated[
    int | None,
    typer.Option(
        "--tune", help="Steps to adapt, thrown away; 100 a dimension, at least 600.", show_default=False
    ),
]
ChainsOption = Annotated[int, typer.Option("--chains", help="Chains; at least 4 for a verdict.")]
CoresOption = Annotated[
    int | None,
    typer.Option("--cores", min=1, help="Processes at a time; all cores by default.", show_default=False),
]
StepOption = Annotated[str, typer.Option("--step", help="demetropolisz or metropolis.")]
ThinOption = Annotated[
    int | None,
    typer.Option(
        "--thin",
        help="Steps for each stored draw; a quarter of the dimension by default.",
        show_default=False,
    ),
]
SeedOption = Annotated[
    int | None, typer.Option("--seed", help="Seed; recorded if not given.", show_default=False)
]
UntilOption = Annotated[
    str | None,
    typer.Option(
        "--until",
        help="ess=400 (default without --draws): until every parameter has it and R-hat <= 1.01; or none.",
        show_default=False,
    ),
]
MaxDrawsOption = Annotated[
    int | None,
    typer.Option("--max-draws", help="Limit of --until; 40 times the first check.", show_default=False),
]
ResumeOption = Annotated[
    bool,
    typer.Option("--resume/--fresh", help="Go on from the checkpoint beside the output, or throw it away."),
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")]


@app.command()
@_reporting
def sample(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="A to I.")],
    study: StudyArgument,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="NetCDF file; MODEL-STUDY.nc by default.", show_default=False),
    ] = None,
    draws: DrawsOption = None,
    tune: TuneOption = None,
    chains: ChainsOption = 4,
    cores: CoresOption = None,
    step: StepOption = "demetropolisz",
    thin: ThinOption = None,
    seed: SeedOption = None,
    until: UntilOption = None,
    max_draws: MaxDrawsOption = None,
    resume: ResumeOption = True,
    quiet: QuietOption = False,
    conventions: ConventionsOption = None,
    wall_factor: WallFactor = None,
    stiffness_radius_unit: RadiusUnit = None,
    friction: Friction = None,
    friction_radius: FrictionRadius = None,
    truncate_lengths: Truncate = None,
    mmhg: Mmhg = None,
    sample_lag: SampleLag = None,
) -> None:
    """Sample a model's posterior on a study, until converged; an interrupted run goes on where it was."""
    name = _model_name(model)
    goal = _until(until, draws)
    switches = _switches(
        wall_factor, stiffness_radius_unit, friction, friction_radius, truncate_lengths, mmhg, sample_lag
    )
    loaded = _load(study, conventions, switches)
    path = _parent_exists(Path(f"{name}-{loaded.name}.nc") if output is None else output)
    settings: dict[str, Any] = {
        "tune": tune,
        "chains": chains,
        "cores": cores or _cores(chains),
        "step": step,
        "thin": thin,
    }
    settings |= {"seed": seed, "max_draws": max_draws, "draws": draws or FIRST_CHECK, "until_ess": goal}
    idata = _sample(name, loaded, path, settings, resume=resume, progress=not quiet)
    _say(*_posterior_summary(idata, goal), f"wrote {path}")


def _cores(chains: int) -> int:
    return max(1, min(chains, os.cpu_count() or 1))


def _sample(
    name: str, study: Study, path: Path, settings: Mapping[str, Any], *, resume: bool, progress: bool
) -> az.InferenceData:
    """Run a model with the checkpoint beside its output, and write the output."""
    from zoo.core.inference.sampling import CheckpointError, CheckpointInUseError
    from zoo.core.posterior.files import checkpoint_of, sample_to

    try:
        if not resume:
            _remove_checkpoint(checkpoint_of(path))
        return sample_to(path, _model(name, study), progress=progress, **settings)
    except CheckpointInUseError as error:
        raise UsageError(str(error)) from None
    except CheckpointError as error:
        raise UsageError(f"{error} (--fresh removes it)") from None


def _remove_checkpoint(folder: Path) -> None:
    """Delete the files of a checkpoint that no run is using, and nothing else."""
    from zoo.core.inference.sampling import Folder

    if not folder.is_dir():
        return
    Folder(folder).close()  # refused while another run holds it
    for pattern in ("run.json", "start.pkl", "chain-*.pkl", "*.part", "lock"):
        for file in folder.glob(pattern):
            file.unlink()
    try:
        folder.rmdir()
    except OSError:
        raise UsageError(f"{folder}: holds files that are not a checkpoint's; move them away") from None


def _posterior_summary(idata: az.InferenceData, goal: float | None) -> list[Any]:
    import numpy as np
    from rich.table import Table
    from rich.text import Text

    from zoo.core.inference.results import RunRecord, ess_to_count, geweke, mpsrf, scalars, verdict

    found = verdict(idata, ess=ess_to_count(goal))
    table = Table(box=None, pad_edge=False)
    table.add_column("parameter")
    for column in ("median", "2.5 %", "97.5 %", "R-hat", "ESS bulk", "ESS tail"):
        table.add_column(column, justify="right")
    posterior = idata["posterior"]
    arrays = {str(n): posterior[n].transpose("chain", "draw", ...).to_numpy() for n in posterior.data_vars}
    judged = {p.name: p for p in found.parameters}
    p_values: list[float] = []
    for label, values in scalars(arrays):
        if label in judged:
            p_values += list(geweke(values)) if values.shape[1] >= 40 else []
            p = judged[label]
            cells = [f"{q:.4g}" for q in np.quantile(values, (0.5, 0.025, 0.975))]
            cells += [f"{p.rhat:.3f}", f"{p.ess_bulk:.0f}", f"{p.ess_tail:.0f}"]
            table.add_row(label, *cells, style=None if p.passes else "yellow")
    record = RunRecord.of(idata)
    failed = ", ".join(f"{n} {status}" for status, n in record.failures.items()) or "none"
    paper = f"as the paper tests: multivariate scale reduction factor {mpsrf(arrays):.3f} (limit 1.1)"
    if p_values:
        below = sum(p < 0.05 for p in p_values)
        paper += f"; Geweke p below 0.05 in {below} of {len(p_values)} (expected {0.05 * len(p_values):.1f})"
    return [
        table,
        Text(found.text, style="green" if found.passes else "yellow"),
        paper,
        f"{found.chains} chains of {found.draws} draws, seed {record.seed}; {record.solves} solves "
        f"({record.solves_per_step:.2f} a step), failed: {failed}; {record.wall_seconds:.0f} s",
    ]


# -------------------------------------------------------------------------------------------------
# compare


@app.command()
@_reporting
def compare(
    studies: Annotated[
        list[str],
        typer.Argument(
            metavar="STUDY...", help="Built-in studies (see `zoo studies`) or folders; a table each."
        ),
    ],
    models: Annotated[str, typer.Option("--models", help="With commas, such as A,B.")] = "A,B",
    posteriors: Annotated[
        list[Path] | None,
        typer.Option(
            "--posteriors",
            help="A file, or a folder of files, from `zoo sample`; may be repeated. A.nc and so on in the "
            "working directory are found without.",
        ),
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for table and figures.")] = Path(
        "comparison"
    ),
    criterion: Annotated[
        Literal["waic", "loo"], typer.Option("--ic", help="What ranks: waic or loo.")
    ] = "waic",
    n_draws: Annotated[
        int, typer.Option("--n-draws", help="Draws of each posterior that are scored.")
    ] = 1000,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures.")] = True,
    draws: DrawsOption = None,
    tune: TuneOption = None,
    chains: ChainsOption = 4,
    cores: CoresOption = None,
    seed: SeedOption = None,
    until: UntilOption = None,
    max_draws: MaxDrawsOption = None,
    resume: ResumeOption = True,
    quiet: QuietOption = False,
    conventions: ConventionsOption = None,
    wall_factor: WallFactor = None,
    stiffness_radius_unit: RadiusUnit = None,
    friction: Friction = None,
    friction_radius: FrictionRadius = None,
    truncate_lengths: Truncate = None,
    mmhg: Mmhg = None,
    sample_lag: SampleLag = None,
) -> None:
    """Rank models by how well they predict a study; posteriors that are missing are sampled first.

    The options of sampling are for those; posteriors that are there are taken as they are.
    """
    if posteriors and not resume:
        raise UsageError("--fresh: samples every model anew; leave out --posteriors, or --fresh")
    names = _different_models(models)
    goal = _until(until, draws)
    if n_draws < 10:
        raise UsageError(f"--n-draws {n_draws}: give at least 10")
    switches = _switches(
        wall_factor, stiffness_radius_unit, friction, friction_radius, truncate_lengths, mmhg, sample_lag
    )
    loaded = [_load(study, conventions, switches) for study in studies]
    if len({study.name for study in loaded}) < len(loaded):
        raise UsageError(f"{', '.join(studies)}: two studies of one name; give each once")
    settings: dict[str, Any] = {
        "tune": tune,
        "chains": chains,
        "cores": cores or _cores(chains),
        "seed": seed,
    }
    settings |= {"max_draws": max_draws, "draws": draws or FIRST_CHECK, "until_ess": goal}
    _parent_exists(output.resolve()).mkdir(exist_ok=True)
    for study in loaded:
        folder = output if len(loaded) == 1 else output / study.name
        folder.mkdir(exist_ok=True)
        built, found = _posteriors_of(study, names, posteriors or [], folder, settings, resume, not quiet)
        _compare_on(study, built, found, folder, criterion, n_draws, figures)


def _posteriors_of(
    study: Study,
    names: Sequence[str],
    given: Sequence[Path],
    output: Path,
    settings: Mapping[str, Any],
    resume: bool,
    progress: bool,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Models on a study and their posteriors: given, of an earlier call, in the working directory, or new."""
    from zoo.core.posterior.files import belongs, find, load_for

    files = {name: output / f"{name}.nc" for name in names if (output / f"{name}.nc").is_file()}
    files |= find(given, names, study, say=_say)
    built: dict[str, Any] = {}
    found: dict[str, Any] = {}
    for name in names:
        built[name] = _model(name, study)
        here = Path(f"{name}.nc")
        if name not in files and belongs(here, built[name]):
            files[name] = here
        if name in files and resume:
            found[name] = load_for(files[name], built[name])
            _say(f"model {name}: posterior of {files[name]}")
        else:
            path = output / f"{name}.nc"
            found[name] = _sample(name, study, path, settings, resume=resume, progress=progress)
            _say(f"model {name}: sampled, wrote {path}")
    return built, found


def _compare_on(
    study: Study,
    models: Mapping[str, Any],
    found: Mapping[str, Any],
    output: Path,
    criterion: Literal["waic", "loo"],
    n_draws: int,
    figures: bool,
) -> None:
    from zoo.core.posterior.comparison import compare as rank

    table = rank(found, models, ic=criterion, n_draws=n_draws)
    table.to_csv(output / "comparison.csv")
    _say(*_comparison_summary(table, criterion, study), f"wrote {output / 'comparison.csv'}")
    if figures:
        _figures(table, models, found, study, output)


def _comparison_summary(table: Any, criterion: str, study: Study) -> list[Any]:
    from rich.table import Table
    from rich.text import Text

    name = {"waic": "WAIC", "loo": "PSIS-LOO"}[criterion]
    title = f"{study.name}: models by {name}, lower is better"
    shown = Table(title=title, title_justify="left", box=None, pad_edge=False)
    shown.add_column("model", no_wrap=True)
    for column in ("WAIC", "SE", "as one", "PSIS-LOO", "diff.", "its SE", "weight", "SSE", "converged"):
        shown.add_column(column, justify="right", no_wrap=True)
    for model, row in table.iterrows():
        shown.add_row(
            str(model),
            f"{row['waic']:.1f}",
            f"{row['waic_se']:.1f}",
            f"{row['waic_one_observation']:.1f}",
            f"{row['loo']:.1f}",
            f"{row['difference']:.1f}",
            f"{row['difference_se']:.1f}",
            f"{row['weight']:.2f}",
            f"{row['sse']:.3g}",
            "yes" if row["converged"] else "no",
        )
    legend = (
        "as one: WAIC with the whole series as one observation, which has no standard error; WAIC is of terms"
        " given the past, PSIS-LOO of terms given all other samples: each ranks models, do not mix the two"
    )
    standing = [f"model {model}: {row['standing']}" for model, row in table.iterrows() if row["rank"] > 0]
    unsure = [
        f"model {model}: {row['pareto_k_bad']} points with Pareto k > 0.7: do not trust PSIS-LOO there"
        for model, row in table.iterrows()
        if row["pareto_k_bad"] > 0
    ]
    unsure += [
        f"model {model}: WAIC has terms whose log-likelihood has a variance above 0.4, it may be too low"
        for model, row in table.iterrows()
        if row["waic_warning"]
    ]
    notes = [
        Text(f"model {name}: {row['convergence']}", style="yellow")
        for name, row in table.iterrows()
        if not row["converged"]
    ]
    return [shown, legend, *standing, *unsure, *notes]


def _figures(
    table: Any, models: Mapping[str, Any], found: Mapping[str, Any], study: Study, output: Path
) -> None:
    from zoo import plots
    from zoo.blood import predictive

    def save(figure: Any, name: str) -> None:
        plots.save_figure(figure, output / f"{name}.png")

    save(plots.comparison_figure(table), "comparison")
    medians, loops = {}, {}
    for name, idata in found.items():
        names = list(models[name].zoo.parameters)
        means, predictions = predictive.predictive_draws(models[name], idata)
        save(
            plots.fit_figure(study, means, predictions, title=f"model {name} on {study.name}"), f"fit-{name}"
        )
        save(plots.trace_figure(idata, names), f"trace-{name}")
        save(plots.rank_figure(idata, names), f"rank-{name}")
        single = [n for n in names if idata["posterior"][n].ndim == 2]
        save(plots.pair_figure(idata, single), f"pair-{name}")
        waves = predictive.vessel_waves(models[name], idata, n_draws=100)
        for quantity in ("pressure_mmHg", "flow_ml_s"):
            kind = quantity.split("_")[0]
            errors = any(series.quantity == quantity for series in study.series)
            shown = predictive.bands(predictive.one_place(waves), quantity, (0.95,), errors=errors)
            save(plots.all_vessels_figure(shown, study, title=f"model {name}, {kind}"), f"{kind}-{name}")
        medians[name] = predictive.median_waves(waves)
        loops[name] = predictive.waves_at_medians(models[name], idata)
    vessels = [int(v) for v in next(iter(loops.values()))["vessel"].to_numpy()]
    save(plots.models_figure(medians, study), "pressure")
    save(plots.models_figure(medians, study, quantity="flow_ml_s"), "flow")
    save(plots.loops_figure(loops, vessels=vessels), "loops")
    _say(f"wrote figures to {output}")


# -------------------------------------------------------------------------------------------------
# reproduce

PAPERS = ("paun2020",)


@app.command()
@_reporting
def reproduce(
    paper: Annotated[str, typer.Argument(metavar="PAPER", help="paun2020.")] = "paun2020",
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Folder for posteriors, tables and figures; PAPER by default.",
            show_default=False,
        ),
    ] = None,
    models: Annotated[
        str | None, typer.Option("--models", help="With commas; all nine by default.", show_default=False)
    ] = None,
    study: Annotated[str, typer.Option("--study", help="What to fit.")] = "mouse-c6",
    synthetic: Annotated[
        bool, typer.Option("--synthetic", help="The studies on synthetic data instead: Tables 3 and 5.")
    ] = False,
    data_sets: Annotated[
        int | None,
        typer.Option("--data-sets", help="Synthetic data sets; 20 by default.", show_default=False),
    ] = None,
    vessels: Annotated[
        str | None,
        typer.Option(
            "--vessels",
            help="How many vessels have synthetic data: counts, with commas; 1,3,21 by default.",
            show_default=False,
        ),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option("--samples", help="Samples in a synthetic beat; 256 by default.", show_default=False),
    ] = None,
    points: Annotated[
        int | None,
        typer.Option(
            "--points",
            help="Solves of a pool that all synthetic data sets share; 16000 by default.",
            show_default=False,
        ),
    ] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures.")] = True,
    draws: DrawsOption = None,
    tune: TuneOption = None,
    cores: CoresOption = None,
    seed: Annotated[
        int | None, typer.Option("--seed", help="Seed; 1 by default.", show_default=False)
    ] = None,
    until: UntilOption = None,
    max_draws: MaxDrawsOption = None,
    quiet: QuietOption = False,
) -> None:
    """Do a paper again: its models on its data, its tables beside ours; goes on where it was interrupted."""
    if paper not in PAPERS:
        raise UsageError(f"{paper}: no such paper; {' or '.join(PAPERS)}")
    if synthetic and (models is not None or seed is not None):
        given = "--models" if models is not None else "--seed"
        raise UsageError(f"{given}: leave it out; the synthetic studies have models and seeds of their own")
    own = {"data-sets": data_sets, "vessels": vessels, "samples": samples, "points": points}
    for option, value in own.items():
        if value is not None and not synthetic:
            raise UsageError(
                f"--{option} {value}: is of the synthetic studies; add --synthetic, or leave it out"
            )
    names = list(MODELS) if models is None else _different_models(models)
    folder = Path(paper) if output is None else output
    _parent_exists(folder.resolve())
    settings: dict[str, Any] = {"cores": cores or _cores(4), "tune": tune, "max_draws": max_draws}
    settings |= {"draws": draws or FIRST_CHECK, "until_ess": _until(until, draws)}
    loaded = _load(study, None, {})
    if synthetic:
        counts = _vessel_counts(vessels or "1,3,21", loaded)
        _reproduce_synthetic(
            loaded,
            folder / "synthetic",
            settings
            | {
                "data_sets": 20 if data_sets is None else data_sets,
                "n_times": 256 if samples is None else samples,
                "points": 16_000 if points is None else points,
                "progress": not quiet,
            },
            counts,
            figures=figures,
        )
        return

    from zoo.core.inference.sampling import CheckpointError
    from zoo.paper.reproduce import WAIC_LIMIT, WAIC_LIMITS, table4_lines
    from zoo.paper.reproduce import reproduce as run

    settings |= {"seed": 1 if seed is None else seed, "progress": not quiet}
    try:
        found = run(loaded, folder, names, figures=figures, say=_say, **settings)
    except CheckpointError as error:
        raise UsageError(f"{error}; the folder is {folder}") from None
    limits = "; ".join([f"{WAIC_LIMIT:g}", *(f"{name}: {limit:g}" for name, limit in WAIC_LIMITS.items())])
    _say(
        _text_table(
            ["model", "quantity", "published", "zoo", ""],
            table4_lines(found.parameters, found.scores),
            f"Table 4 of {paper}, published and on {loaded.name}",
        ),
        f"cells: median (2.5 %, 97.5 %); = agrees, x does not (differences of WAIC: within {limits}); "
        "WAIC with the whole series as one observation; ±: Monte Carlo standard error",
        _cost_summary(found.costs),
        *found.lines(),
        f"wrote {folder}",
    )


def _beside(name: str, row: Any) -> str:
    return f"{row[name]:.2g} ({row[f'published_{name}']:.2g})"


def _text_table(headings: Sequence[str], rows: Sequence[Sequence[str]], title: str) -> Any:
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for i, heading in enumerate(headings):
        table.add_column(heading, no_wrap=True, justify="left" if i < 2 else "right")
    for row in rows:
        table.add_row(*row, style={"=": "green", "x": "yellow"}.get(row[-1]))
    return table


def _cost_summary(costs: Any) -> Any:
    headings = ["model", "converged", "R-hat", "ESS", "solves", "minutes", "paper"]
    rows = []
    for model, row in costs.iterrows():
        paper = f"{row['published_iterations']:.0f}{'*' if row['published_emulator'] else ''}"
        if row["published_days"] and row["published_days"] == row["published_days"]:
            paper += f", {row['published_days']:.0f} days"
        rows.append(
            [
                str(model),
                "yes" if row["converged"] else "no",
                f"{row['rhat_max']:.3f}",
                f"{row['ess_min']:.0f}",
                f"{row['solves']:.0f}",
                f"{row['minutes']:.1f}",
                paper,
            ]
        )
    return _text_table(headings, rows, "what the posteriors cost; paper: iterations, * of an emulator")


def _vessel_counts(text: str, study: Study) -> list[int]:
    try:
        counts = [int(part) for part in text.split(",")]
    except ValueError:
        raise UsageError(f"--vessels {text}: give whole numbers with commas, such as 1,3,21") from None
    for count in counts:
        if not 1 <= count <= len(study.vessels):
            raise UsageError(f"--vessels {text}: {study.name} has {len(study.vessels)} vessels")
    return counts


def _reproduce_synthetic(
    base: Study, folder: Path, settings: dict[str, Any], vessels: Sequence[int], *, figures: bool
) -> None:
    from zoo.paper import coverage
    from zoo.paper.reproduce import synthetic_figures, synthetic_tables

    for name, least in (("data_sets", 1), ("n_times", 16), ("points", 1000)):
        if settings[name] < least:
            option = {"n_times": "--samples"}.get(name, f"--{name.replace('_', '-')}")
            raise UsageError(f"{option} {settings[name]}: give at least {least}")
    wanted = [s for s in coverage.SCENARIOS if s.vessels in vessels]
    wanted += [coverage.Scenario(f"mismatch, {n} vessels", "E", n) for n in vessels if n not in (1, 3, 21)]
    scores = coverage.run(base, folder, scenarios=wanted, **settings)
    data_sets = settings["data_sets"]
    table, covered = synthetic_tables(scores), coverage.coverage(scores)
    table.to_csv(folder / "tables-3-and-5.csv")
    covered.to_csv(folder / "coverage.csv", index=False)
    shown = {"converged": lambda row: f"{row['converged']:.0f} of {row['data_sets']:.0f}"}
    for name in ("relative_sse", *(f"density_{name}" for name in coverage.THETA)):
        label = name.replace("density_", "p(") + "|y)" if name.startswith("density_") else "relative SSE"
        shown[label] = functools.partial(_beside, name)
    shown["p(theta|y), kernel"] = lambda row: f"{row['joint_kde']:.2g}"
    shown["p(theta|y), direct"] = lambda row: f"{row['joint_direct']:.2g}"
    shown["ratio to 1 vessel"] = lambda row: (
        f"{row.get('joint_ratio', math.nan):.3g} ({row['published_joint_ratio']:.3g})"
    )
    rows = [[label, *(text(row) for _, row in table.iterrows())] for label, text in shown.items()]
    headings = ["median of", *(str(scenario).replace(", ", ",\n") for scenario in table.index)]
    _say(_text_table(headings, rows, f"Tables 3 and 5: {data_sets} data sets (published)"))
    rows = []
    for (scenario, parameter), group in covered.groupby(["scenario", "parameter"], sort=False):
        cells = [
            f"{row['covered']} of {row['data_sets']}{'' if row['within'] else ' x'}"
            for _, row in group.iterrows()
        ]
        rows.append([str(scenario), str(parameter), *cells])
    headings = ["scenario", "parameter", *(f"{100 * level:.0f} %" for level in coverage.LEVELS)]
    _say(
        _text_table(headings, rows, "how often central intervals hold the truth"),
        "x: outside the central 95 % of the binomial with that probability",
    )
    if figures:
        synthetic_figures(scores, base, folder)
    _say(f"wrote {folder}")


# -------------------------------------------------------------------------------------------------
# diagnose

BARS = 24
"""Characters of a share of 1."""
LEADING = 8
"""Explanations that the screen shows."""
PLACE_WORDS = {
    "everywhere": "everywhere",
    "each_vessel": "each vessel",
    "vessels_and_subtrees": "each vessel, each subtree",
    "sides_and_terminals": "each side, each terminal",
}
"""Function that lists the places of an effect -> what these are."""


@app.command()
@_reporting
def diagnose(
    study: StudyArgument,
    base: Annotated[
        str,
        typer.Option(
            "--base",
            help="linear-constant, linear-radius, tangent-constant, tangent-radius, or a model with that "
            "structure: A to E, H, I.",
        ),
    ] = "linear-constant",
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for what is found.")] = Path("gap"),
    confirm: Annotated[
        bool,
        typer.Option("--confirm/--no-confirm", help="Sample the posteriors of the leading explanations."),
    ] = True,
    effects: Annotated[
        str | None,
        typer.Option(
            "--effects",
            help="Only these, with commas; all of `zoo effects` that fit the base if absent.",
            metavar="NAMES",
            show_default=False,
        ),
    ] = None,
    max_effects: Annotated[int, typer.Option("--max-effects", help="Most effects to add.")] = 3,
    exhaust: Annotated[
        bool,
        typer.Option(
            "--exhaust", help="Add the best listed effects even where a free discrepancy explains more."
        ),
    ] = False,
    cores: Annotated[int, typer.Option("--cores", help="Threads and processes at a time.")] = 2,
    seed: Annotated[int, typer.Option("--seed", help="Of the draws.")] = 1,
    quiet: QuietOption = False,
    conventions: ConventionsOption = None,
    wall_factor: WallFactor = None,
    stiffness_radius_unit: RadiusUnit = None,
    friction: Friction = None,
    friction_radius: FrictionRadius = None,
    truncate_lengths: Truncate = None,
    mmhg: Mmhg = None,
    sample_lag: SampleLag = None,
) -> None:
    """Find what a base model misses in a study: where the gap lies, what causes it, how far it shrinks."""
    import shlex

    from zoo.blood.effects import get_base

    for option, count in (("--max-effects", max_effects), ("--cores", cores)):
        if count < 1:
            raise UsageError(f"{option} {count}: give at least 1")
    if seed < 0:
        raise UsageError(f"--seed {seed}: give at least 0")
    chosen = get_base(base)
    names = _effect_names(effects, chosen.name)
    switches = _switches(
        wall_factor, stiffness_radius_unit, friction, friction_radius, truncate_lengths, mmhg, sample_lag
    )
    loaded = _load(study, conventions, switches)
    _output_folder(output)

    from zoo.core.diagnosis.diagnosis import diagnose as run
    from zoo.core.diagnosis.discrepancy import Harmonics
    from zoo.report import write_diagnosis

    Harmonics(loaded)  # a study without observations is refused before the work
    output.mkdir(exist_ok=True)
    # a base has a wall factor of its own unless one is asked for
    own = loaded.conventions if wall_factor is not None else None
    folder = output / "posteriors" / _run_name(loaded, chosen.name, own, seed)
    if confirm:
        folder.mkdir(parents=True, exist_ok=True)
    with _Telling(not quiet, confirm) as tell:
        found = run(
            loaded,
            chosen.name,
            max_effects=max_effects,
            exhaust=exhaust,
            effects=names,
            conventions=own,
            cores=cores,
            seed=seed,
            tick=tell,
        )
        found.save(output)  # what comes next takes longer and may be stopped
        if confirm:
            found = found.confirmed(cores=cores, seed=seed, folder=folder, tick=tell)
        tell.say("figures and page")
        words = ["zoo", "diagnose", study, "--base", chosen.name, "-o", str(output)]
        words += ["--confirm" if confirm else "--no-confirm", "--max-effects", str(max_effects)]
        words += ["--exhaust"] if exhaust else []
        words += ["--effects", ",".join(names)] if names else []
        words += ["--conventions", conventions] if conventions else []
        words += [*_switch_words(switches), "--cores", str(cores), "--seed", str(seed)]
        written = write_diagnosis(found, output, command=shlex.join(words))
    _say(*_diagnosis_summary(found.file), f"wrote {output}: {', '.join(path.name for path in written)}")


class _Telling:
    """A progress bar that says what is being tried."""

    def __init__(self, wanted: bool, confirm: bool) -> None:
        from zoo.core.inference.progress import bar

        self.bar, self.confirm = bar(wanted), confirm
        self.added = -1

    def __enter__(self) -> _Telling:
        self.bar.__enter__()
        self.task = self.bar.add_task("base", total=100)
        return self

    def __exit__(self, *error: Any) -> None:
        self.bar.__exit__(*error)

    def __call__(self, text: str, share: float) -> None:
        """What is being tried, and the share of this round that is done; each round starts with 0."""
        self.added += share == 0.0
        if share >= 1.0:
            text = "posteriors" if self.confirm else "weighing"
        elif self.added > 0:
            text = f"{text} (beside {self.added} added)"
        self.bar.update(self.task, description=text, completed=100 * share)

    def say(self, text: str) -> None:
        """A word on what follows the screening."""
        self.bar.update(self.task, description=text, completed=100)


def _effect_names(text: str | None, base: str) -> list[str] | None:
    """Effects of an option, each of which the base can take; None for all."""
    from zoo.blood.effects import effects_for

    if text is None:
        return None
    names = [part.strip() for part in text.split(",") if part.strip()]
    if not names:
        raise UsageError("--effects: no names; give some of `zoo effects` with commas, or leave it out")
    return list(effects_for(base, names))


def _output_folder(path: Path) -> None:
    if path.exists() and not path.is_dir():
        raise UsageError(f"--output {path}: is a file; give a folder")
    if not path.exists():
        _parent_exists(path.resolve())
    elif not os.access(path, os.W_OK):
        raise UsageError(f"--output {path}: cannot be written to; choose another folder")


def _run_name(study: Study, base: str, conventions: Conventions | None, seed: int) -> str:
    """Folder of a run's posteriors: another study, base, conventions or seed has another one."""
    import hashlib

    what = repr((study.checksum, study.conventions, conventions, seed)).encode()
    return f"{base}-{hashlib.sha256(what).hexdigest()[:8]}"


def _switch_words(switches: Mapping[str, Any]) -> list[str]:
    """The switches of the conventions that were given, as they are typed."""
    words = []
    for name, value in switches.items():
        option = name.removesuffix("_cm").removesuffix("_beats").replace("_", "-")
        if name == "truncate_lengths" and value is not None:
            words.append("--truncate-lengths" if value else "--true-lengths")
        elif value is not None:
            words += [f"--{option}", str(value)]
    return words


def _bar(share: float) -> str:
    return "█" * max(round(BARS * share), int(share >= 0.005))


def _diagnosis_summary(file: DiagnosisFile) -> list[Any]:
    """What the screen shows of a diagnosis."""
    from rich.table import Table
    from rich.text import Text

    from zoo.report import diagnosis_summary, total_seconds

    unit = str(file.record.get("gap_unit", "mmHg"))
    verdict, *rest = diagnosis_summary(file)
    where = Table(
        title=f"where the gap of {file.base} in {file.study} lies",
        title_justify="left",
        box=None,
        pad_edge=False,
    )
    for heading, justify in (("by", "left"), ("", "left"), ("share", "right"), ("", "left")):
        where.add_column(heading, justify=justify, no_wrap=True)  # type: ignore[arg-type]
    harmonics = dict(sorted(file.where.harmonic.items(), key=lambda item: -item[1])[:4])
    places = {_place(p.vessel, p.subtree): p.probability for p in file.where.place[:4]}
    parts = {"phase": file.where.phase, "series": file.where.series, "harmonic": harmonics}
    parts["place"] = places
    for what, shares in parts.items():
        for k, (name, share) in enumerate(shares.items()):
            where.add_row(what if k == 0 else "", name, _share(share), Text(_bar(share), style="cyan"))
    rows = [h for k, h in enumerate(file.hypotheses) if k < LEADING or h.name in ("no-gap", "unlisted")]
    table = Table(title="explanations, most probable first", title_justify="left", box=None, pad_edge=False)
    for heading in ("explanation", "place", "prob.", "group", "amplitude", f"gap after ({unit})"):
        named = heading in ("explanation", "place")
        table.add_column(heading, justify="left" if named else "right", no_wrap=heading == "explanation")
    for h in rows:
        free = h.name in ("unlisted", "correlated-noise")
        size = ""
        if h.amplitude is not None:
            spread = "" if free else f" ± {h.amplitude.sd:.2g}"
            size = f"{h.amplitude.name} {h.amplitude.mean:.3g}{spread} {h.amplitude.unit}".removesuffix(" 1")
        table.add_row(
            h.name,
            "" if h.place is None else _place(h.place, h.subtree),
            "invisible" if h.name in file.invisible else _share(h.probability),
            str(h.group),
            size,
            "" if free else f"{h.gap_after_mmHg:.2g}",
            style="bold" if h.name in file.cause else None,
        )
    lines: list[Any] = [Text(verdict, style="bold"), *(Text(line) for line in rest), ""]
    lines += [table] if file.hypotheses[0].name == "no-gap" else [where, "", table]  # nothing to place
    if len(file.hypotheses) > len(rows):
        lines.append(
            f"and {len(file.hypotheses) - len(rows)} more; explanations of one group look alike here"
        )
    if file.invisible:
        lines.append(f"this study cannot show: {', '.join(file.invisible)}")
    if file.next_measurement is not None:
        m = file.next_measurement
        lines.append(
            f"next measurement: {m.quantity} in vessel {m.vessel} at {m.position:g}, which tells "
            f"{m.separates[0]} from {m.separates[1]} (expected log odds up to {m.expected_log_odds:.1f})"
        )
    for name, row in (file.confirmation or {}).items():
        converged = "converged" if row["converged"] else "not converged, see report.html"
        lines.append(
            f"posterior of {name}: log marginal likelihood {_number(row['log_marginal_likelihood'])} "
            f"± {_number(row['log_marginal_likelihood_se'])}, elpd (WAIC) {_number(row['elpd_waic'])}; "
            f"{converged}"
        )
    record = file.record
    seconds = total_seconds(record)
    lines.append(f"{record.get('solves', 0)} solves of the screening, {seconds:.0f} s in all")
    return [Text(line) if isinstance(line, str) else line for line in lines]


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"


def _share(share: float) -> str:
    return "<1 %" if 0 < share < 0.005 else f"{100 * share:.0f} %"


def _place(vessel: int | None, subtree: bool) -> str:
    from zoo.blood.effects import Place

    return str(Place(vessel, subtree))


@app.command()
@_reporting
def effects(
    name: Annotated[
        str | None,
        typer.Argument(metavar="[NAME]", help="One effect, such as viscoelastic-wall.", show_default=False),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """List the effects that a base model may lack; with a name, all that is known about one."""
    import json

    from zoo.blood.effects import CATALOGUE, get_effect

    chosen = list(CATALOGUE.values()) if name is None else [get_effect(name)]
    if as_json:
        found = [_effect_fields(effect) for effect in chosen]
        typer.echo(json.dumps(found if name is None else found[0], indent=1, ensure_ascii=False))
    elif name is None:
        _say(_effects_table(chosen))
    else:
        _say(*_effect_lines(chosen[0]))


def _places(effect: Effect) -> str:
    """Where an effect can act, in words."""
    function = getattr(effect.places, "__name__", "")
    return PLACE_WORDS.get(function, function.replace("_", " ") or "some places")


def _effect_fields(effect: Effect) -> dict[str, Any]:
    from dataclasses import asdict

    fields = {
        n: getattr(effect, n) for n in ("name", "family", "statement", "equation", "signature", "source")
    }
    amplitudes = [asdict(amplitude) for amplitude in effect.amplitudes]
    return fields | {"places": _places(effect), "bases": list(effect.bases), "amplitudes": amplitudes}


def _effects_table(chosen: Sequence[Effect]) -> Any:
    """Five columns on a wide screen; on others all but the name in one."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from zoo.blood.effects import FAMILIES, prior_text

    headings = ("effect", "amplitude", "prior", "places", "what it does to a beat")
    wide = Console().width >= 130
    table = Table(box=None, pad_edge=False)
    for heading in headings if wide else ("effect", ", ".join(headings[1:])):
        table.add_column(heading, no_wrap=heading in headings[:2] or (heading == "prior" and wide))
    for family in FAMILIES:
        members = [effect for effect in chosen if effect.family == family]
        if members:
            table.add_row(Text(family, style="bold"))
        for effect in members:
            names = [f"{amplitude.name} ({amplitude.unit})" for amplitude in effect.amplitudes]
            priors = [prior_text(a).removesuffix(f" {a.unit}") for a in effect.amplitudes]
            if wide:
                cells = ["\n".join(names), "\n".join(priors), _places(effect), effect.signature]
            else:
                lines = [f"{name} ~ {prior}" for name, prior in zip(names, priors, strict=True)]
                cells = ["\n".join((*lines, _places(effect), effect.signature))]
            table.add_row(*(Text(cell) for cell in (f"  {effect.name}", *cells)))
    return table


def _effect_lines(effect: Effect) -> list[Any]:
    from rich.table import Table
    from rich.text import Text

    from zoo.blood.effects import prior_text

    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(no_wrap=True)
    table.add_column()
    rows = [(n, str(getattr(effect, n))) for n in ("family", "statement", "equation", "signature")]
    for amplitude in effect.amplitudes:
        words = [f"{amplitude.name} ({amplitude.unit}) ~ {prior_text(amplitude)}", amplitude.why]
        words.append("0 is the base" if amplitude.zero_is_base else "a shape, which no base has")
        rows.append(("amplitude", "; ".join(word for word in words if word)))
    rows += [("places", _places(effect)), ("bases", ", ".join(effect.bases) or "all")]
    rows.append(("source", effect.source))
    for what, text in rows:
        table.add_row(Text(what, style="bold"), Text(text))
    return [Text(effect.name, style="bold"), table]


# -------------------------------------------------------------------------------------------------
# the blind check

blind_app = typer.Typer(
    name="blind",
    help="Check the diagnosis on cases whose effect is withheld: make them, run it, score the answers.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(blind_app)


class _Counting:
    """A progress bar over cases."""

    def __init__(self, wanted: bool, total: int) -> None:
        from zoo.core.inference.progress import bar

        self.bar, self.total = bar(wanted), total

    def __enter__(self) -> _Counting:
        self.bar.__enter__()
        self.task = self.bar.add_task("cases", total=self.total)
        return self

    def __exit__(self, *error: Any) -> None:
        self.bar.__exit__(*error)

    def __call__(self, case: str) -> None:
        """One more is done."""
        self.bar.update(self.task, description=case, advance=1)


def _name_list(option: str, text: str | None) -> list[str] | None:
    if text is None:
        return None
    names = list(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    if not names:
        raise UsageError(f"{option}: no names; give some with commas, or leave it out")
    return names


@blind_app.command("make")
@_reporting
def blind_make(
    folder: Annotated[Path, typer.Argument(metavar="CASES", help="Folder for the cases.")],
    n: Annotated[int, typer.Option("--n", help="Cases.")] = 40,
    seed: Annotated[int, typer.Option("--seed", help="Of the draw.")] = 1,
    key: Annotated[Path, typer.Option("--key", help="File for what is withheld, outside the folder.")] = Path(
        "key.json"
    ),
    effects: Annotated[
        str | None,
        typer.Option(
            "--effects",
            help="Draw from these, with commas; from all of `zoo effects` if absent.",
            metavar="NAMES",
            show_default=False,
        ),
    ] = None,
    layouts: Annotated[
        str, typer.Option("--layouts", help="Where sensors are, with commas.", metavar="NAMES")
    ] = "MPA,MPA+daughters,MPA+distal,MPA+flow",
    networks: Annotated[
        str, typer.Option("--networks", help="mouse, tree (generated), or both.", metavar="NAMES")
    ] = "mouse,tree",
    cores: Annotated[int, typer.Option("--cores", help="Processes at a time.")] = 2,
    quiet: QuietOption = False,
) -> None:
    """Write studies with a withheld effect each, and the key apart; goes on where it was interrupted."""
    from zoo.blood.blind import make

    with _Counting(not quiet, n) as counting:
        path = make(
            folder,
            n,
            seed,
            key,
            effects=_name_list("--effects", effects),
            layouts=_name_list("--layouts", layouts) or [],
            networks=_name_list("--networks", networks) or [],
            cores=cores,
            done=counting,
        )
    _say(f"wrote {n} cases in {folder}, and what they withhold in {path}")


@blind_app.command("run")
@_reporting
def blind_run(
    cases: Annotated[Path, typer.Argument(metavar="CASES", help="Folder of studies, without their key.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the answers.")] = Path("answers"),
    base: Annotated[str, typer.Option("--base", help="As in `zoo diagnose`.")] = "linear-constant",
    confirm: Annotated[
        bool, typer.Option("--confirm/--no-confirm", help="Sample the leading explanations too.")
    ] = False,
    max_effects: Annotated[int, typer.Option("--max-effects", help="Most effects to add.")] = 3,
    seed: Annotated[int, typer.Option("--seed", help="Of the draws.")] = 1,
    cores: Annotated[int, typer.Option("--cores", help="Cases at a time, a process each.")] = 2,
    quiet: QuietOption = False,
) -> None:
    """Diagnose every case of a folder; sees no key, and goes on where it was interrupted."""
    import time

    from zoo.blood.blind import run

    began = time.monotonic()
    total = sum((p / "study.toml").is_file() for p in cases.iterdir()) if cases.is_dir() else 0
    with _Counting(not quiet, total) as counting:
        found = run(
            cases,
            output,
            base=base,
            confirm=confirm,
            max_effects=max_effects,
            seed=seed,
            cores=cores,
            done=counting,
        )
    words = f", {len(found.kept)} of them before" if found.kept else ""
    _say(
        f"{len(found.diagnosed)} cases diagnosed{words}, {len(found.failed)} failed, "
        f"{time.monotonic() - began:.0f} s; answers in {output}"
    )
    for name, reason in found.failed.items():
        _say(f"{name}: {reason}")
    if found.failed:
        _say("mend these and give the command again; what was on the way is in failed.txt in their folders")
        raise typer.Exit(1)


@blind_app.command("score")
@_reporting
def blind_score(
    answers: Annotated[Path, typer.Argument(metavar="ANSWERS", help="Folder of `zoo blind run`.")],
    key: Annotated[
        Path,
        typer.Option("--key", help="Of `zoo blind make`; or a folder of keys made elsewhere, one a case."),
    ] = Path("key.json"),
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the score.")] = Path("score"),
) -> None:
    """Score answers against their key: score.json, score.md, cases.csv and figures."""
    from zoo.blood.blind import score

    _output_folder(output)
    found = score(answers, key, output)

    from zoo.plots import save_figure, score_figures

    figures = [
        save_figure(figure, output / f"{name}.png").name for name, figure in score_figures(found).items()
    ]
    _say(*_score_summary(found))
    _say(f"wrote {output}: score.json, score.md, cases.csv, {', '.join(figures)}")


def _score_summary(found: Score) -> list[Any]:
    from rich.table import Table

    from zoo.blood.blind import FULL_BIN, HEADLINES, rate_text

    s = found.summary
    title = f"{s['n']} cases, {s['failed']} without an answer"
    if found.without_key:
        title += f"; {found.without_key} more answers have no key"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False, show_header=False)
    for name, words in HEADLINES:
        table.add_row(words, rate_text(s[name]))
    for what, label in (("log_score", "log score"), ("brier", "Brier score")):
        group = f"group_{what}"
        table.add_row(
            f"{label} by explanation, by group (uniform guess)",
            f"{s[what]:.3f} ({s[f'uniform_{what}']:.3f}), {s[group]:.3f} ({s[f'uniform_{group}']:.3f})",
        )
    full = [b for b in found.reliability if b.n >= FULL_BIN]
    table.add_row(
        f"bins of stated probability with {FULL_BIN} cases or more that lie within their band",
        f"{sum(b.inside for b in full)} of {len(full)}",
    )
    checked = (
        "the key has the SHA-256 that the cases came with" if found.key_checked else "keys without SHA-256"
    )
    return [table, checked]


# -------------------------------------------------------------------------------------------------
# report


@app.command()
@_reporting
def report(
    studies: Annotated[
        list[str] | None,
        typer.Argument(metavar="STUDY...", help="Studies, a chapter each; all built-in ones if absent."),
    ] = None,
    posteriors: Annotated[
        list[Path] | None,
        typer.Option("--posteriors", help="Folder of posteriors; may be repeated. Here if absent."),
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="HTML file.")] = Path("report.html"),
    models: Annotated[
        str, typer.Option("--models", help="Those to take, with commas.")
    ] = "A,B,C,D,E,F,G,H,I",
    criterion: Annotated[
        Literal["waic", "loo"], typer.Option("--ic", help="What ranks: waic or loo.")
    ] = "waic",
    n_draws: Annotated[
        int, typer.Option("--n-draws", help="Draws of each posterior that are scored.")
    ] = 1000,
    title: Annotated[str, typer.Option("--title", help="Of the page.")] = "Models of blood flow",
    quiet: QuietOption = False,
) -> None:
    """Write one HTML page on stored posteriors: comparison, fits, convergence, how they were made."""
    import shlex

    from zoo.blood.study import list_studies
    from zoo.report import gather, write_chapters

    letters = _model_names(models)
    if n_draws < 10:
        raise UsageError(f"--n-draws {n_draws}: give at least 10")
    _parent_exists(output.resolve())
    names = studies or list(list_studies())
    folders = posteriors or [Path()]
    chapters = gather(names, folders, letters=letters, data=bool(os.environ.get("CI")), say=_say)
    words = ["zoo", "report", *names]
    words += [word for folder in folders for word in ("--posteriors", str(folder))]
    words += ["--models", ",".join(letters), "--ic", criterion, "--n-draws", str(n_draws), "-o", str(output)]
    write_chapters(
        output,
        chapters,
        title=title,
        ic=criterion,
        n_draws=n_draws,
        command=shlex.join(words),
        say=(lambda text: None) if quiet else _say,
    )
    _say(f"wrote {output}")


if __name__ == "__main__":
    sys.exit(app())
