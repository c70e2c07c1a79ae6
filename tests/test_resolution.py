"""Cells and steps from a stated accuracy: finer solves are the judge."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from zoo.blood import resolution
from zoo.blood.baseline import get_baseline
from zoo.blood.case import Case, simulate, solver_of
from zoo.blood.effects import CATALOGUE
from zoo.blood.network import Network
from zoo.blood.resolution import ACCURACY_PERCENT, NOISE_SHARE, Resolution, resolve, resolve_solver
from zoo.blood.solver import Physics, Solver, SolverArgumentError, SolverOptions
from zoo.blood.study import Blood, Series, Study, StudyError, Vessel, Windkessel, load_study
from zoo.core.effects import EVERYWHERE
from zoo.core.forward import SolveError
from zoo.core.parameters import pack, start_of

HUMAN = Path(__file__).parent / "data" / "human"
STIFF = {"human": 4e5, "demo": 5.17e4, "short": 4e5}
SITES = [(1, 0.0, "pressure_mmHg"), (1, 0.5, "flow_ml_s"), (7, 0.5, "pressure_mmHg"), (7, 1.0, "flow_ml_s")]


def human() -> Study:
    """Seven vessels of a human's size, pressures and flows at two sites."""
    study = load_study(HUMAN)
    times = np.arange(64) * study.period_s / 64
    return replace(study, time_s=times, series=tuple(Series(*site, np.zeros(64)) for site in SITES))


def short() -> Study:
    """The same with a vessel of 3 mm between the abdominal aorta and the legs."""
    study = human()
    link = Vessel(8, "link", 0.3, 0.6, 0.6, 5, None)
    vessels = [replace(v, parent=8) if v.parent == 5 else v for v in study.vessels]
    return replace(study, vessels=(*vessels, link))


def plain_demo() -> Study:
    """The demo without its table [numerics]."""
    return replace(load_study("demo"), numerics={})


STUDIES = {"human": human, "demo": plain_demo, "short": short}


def case_of(name: str, study: Study) -> Case:
    solver = Solver.for_study(study)
    one = np.ones(len(solver.network.ids))
    arrays = {"stiffness": STIFF[name] * one, "gamma": 2 * one, "psi1": one, "psi2": one, "c": one}
    return Case(
        network=solver.network,
        inflow_time_s=study.inflow_time_s,
        inflow_ml_s=study.inflow_ml_s,
        conventions=study.conventions,
        wall="linear",
        options=SolverOptions(),
        physics=Physics(),
        **arrays,
    )


def chosen(name: str, study: Study) -> tuple[Case, Resolution]:
    case = case_of(name, study)
    series = [(s.vessel, s.position, s.quantity) for s in study.series]
    return case, resolve(study, case, series, study.time_s)


def errors_of(case: Case, study: Study, options: SolverOptions) -> np.ndarray:
    """Root mean square over a beat against cells and steps of a quarter of the size, each in its unit."""
    series = [(s.vessel, s.position, s.quantity) for s in study.series]
    fine = replace(options, refine=4, tolerance_mmHg=1e-5, max_beats=200)
    waves = [simulate(replace(case, options=o), series, study.time_s) for o in (options, fine)]
    return np.asarray(np.sqrt(np.mean((waves[0] - waves[1]) ** 2, axis=1)) / np.ptp(waves[1], axis=1))


@pytest.mark.parametrize("name", STUDIES)
def test_a_finer_solve_is_within_the_stated_error(name: str) -> None:
    study = STUDIES[name]()
    case, found = chosen(name, study)
    errors = 100 * errors_of(case, study, found.options)
    assert found.met
    assert found.error_percent <= ACCURACY_PERCENT
    assert errors.max() <= found.error_percent
    assert errors.max() > 0.1 * found.error_percent  # nor is it far more than is there


@pytest.mark.parametrize("name", STUDIES)
def test_waves_cross_most_of_a_cell_in_a_step_but_never_all(name: str) -> None:
    study = STUDIES[name]()
    case, found = chosen(name, study)
    solver = solver_of(replace(case, options=found.options), (), np.empty(0))
    solution = solver.solve(case.stiffness)
    cells, length = solver.grid()
    courant = solution.fastest_cm_s * cells / length * case.network.period_s / solution.steps_per_beat
    assert solution.steps_per_beat == found.options.least_steps
    assert courant.max() < 0.95
    assert courant.max() == pytest.approx(solution.max_cfl, rel=1e-12)
    assert np.all((courant > 0.5) | (cells <= 2) | (name == "short"))


def test_the_shortest_vessel_is_one_cell_and_the_others_keep_theirs() -> None:
    _, without = chosen("human", human())
    case, found = chosen("short", short())
    cells = dict(zip(case.network.ids.tolist(), found.cells, strict=True))
    assert cells[8] == 1
    assert sum(found.cells) < 2 * sum(without.cells)
    old = replace(case, options=SolverOptions(dx_cm=0.15))  # two cells, and all as fine as that
    cells_of_old, _ = solver_of(old, (), np.empty(0)).grid()
    assert cells_of_old.sum() > 5 * sum(found.cells)


def test_steps_stay_the_same_around_the_stiffness() -> None:
    study = human()
    case, found = chosen("human", study)
    solver = solver_of(replace(case, options=found.options), (), np.empty(0))
    assert {solver.solve(f * case.stiffness).steps_per_beat for f in (0.6, 0.8, 1.0, 1.1)} == {
        found.options.least_steps
    }
    stiffer = solver.solve(4 * case.stiffness)  # more where the waves need them
    assert stiffer.ok
    assert stiffer.steps_per_beat > 1.5 * found.options.least_steps


def test_a_known_noise_sets_the_limit_where_it_is_smaller() -> None:
    study = human()
    case, found = chosen("human", study)
    quiet = replace(study, noise_sd={"flow_ml_s": 1e3, "v7@0.5 pressure_mmHg": 0.02})
    _, finer = chosen("human", quiet)
    assert sum(finer.cells) > 1.2 * sum(found.cells)
    pulse = np.ptp(simulate(case, [SITES[2]], study.time_s))
    error = errors_of(case, study, finer.options)[2] * pulse
    assert error < NOISE_SHARE * 0.02
    assert finer.worst == "pressure at 0.5 of v7"
    assert finer.limit_percent == pytest.approx(100 * NOISE_SHARE * 0.02 / pulse, rel=0.05)


def test_accuracy_is_asked_for_in_the_study() -> None:
    study = human()
    found = [chosen("human", replace(study, numerics={"accuracy_percent": a}))[1] for a in (0.3, 0.1, 0.02)]
    cells = [sum(one.cells) for one in found]
    assert cells[0] < cells[1] < cells[2]
    assert [one.limit_percent for one in found] == pytest.approx([0.3, 0.1, 0.02])
    assert found[0].options.tolerance_mmHg > found[2].options.tolerance_mmHg


@pytest.mark.parametrize(("part", "heard"), [(1.0, False), (1 / 6, True)])
def test_softer_walls_than_the_cells_were_chosen_for_are_warned_about(part: float, heard: bool) -> None:
    flow = get_baseline("A").forward(human())
    medians = start_of([replace(p, start=None) for p in flow.parameters])
    softer = flow.configure(pack(flow.parameters, medians | {"f3": part * medians["f3"]}))
    fine = replace(softer, options=replace(softer.options, refine=4, tolerance_mmHg=1e-5))
    times = flow.outputs.times
    taken, exact = (simulate(case, tuple(SITES), times) for case in (softer, fine))
    error = np.sqrt(np.mean((taken - exact) ** 2, axis=1)) / np.ptp(exact, axis=1)
    assert (100 * error.max() > 1.5 * ACCURACY_PERCENT) == heard
    words = flow.warning_at(softer)
    if not heard:
        assert words == ""
        return
    stated = float(re.search(r"the discretisation error is (\S+) %", words)[1])  # type: ignore[index]
    assert 0.7 < stated / (100 * error.max()) < 2
    asked = float(re.search(r"--accuracy (\S+),", words)[1])  # type: ignore[index]
    finer = get_baseline("A").forward(replace(human(), numerics={"accuracy_percent": asked}))
    assert flow.warning_at(replace(softer, options=finer.options)) == ""


def test_what_cannot_be_reached_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resolution, "MOST_WORK", 1e5)
    study = replace(human(), numerics={"accuracy_percent": 1e-3})
    _, found = chosen("human", study)
    assert not found.met
    assert "more than the 0.001 % asked for" in found.text
    assert "--accuracy" in found.text
    assert "\n" not in found.text


def test_a_choice_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    study = human()
    chosen("human", study)
    monkeypatch.setattr(resolution, "_chosen", None)  # not called again
    _, again = chosen("human", human())
    _, softer = chosen("human", replace(study, numerics={"tolerance_mmHg": 1e-3}))
    assert softer.cells == again.cells
    assert softer.options.tolerance_mmHg == 1e-3


def test_studies_of_the_paper_keep_their_grid() -> None:
    demo, given = load_study("demo"), SolverOptions(tolerance_mmHg=resolution.GIVEN_CELLS_MMHG)
    assert get_baseline("B").forward(demo).options == given
    published = replace(demo, conventions=demo.conventions.replace(truncate_lengths=True), numerics={})
    flow = get_baseline("B").forward(published)
    assert flow.options == given
    assert flow.resolution is not None
    assert flow.resolution.cells == tuple(
        np.maximum(2, np.floor(40 * flow.network.length_cm + 1e-9)).astype(int)
    )
    asked = SolverOptions(dx_cm=0.1)
    assert get_baseline("B").forward(plain_demo(), options=asked).options is asked


def test_a_model_has_what_was_chosen_in_its_record() -> None:
    study = plain_demo()
    flow = get_baseline("B").forward(study)
    assert flow.resolution is not None
    assert flow.options == flow.resolution.options
    from zoo import model_B

    made_with = model_B(study).zoo.settings["solver options"]
    assert made_with["cells"] == flow.options.cells
    assert made_with["grid"] == flow.resolution.text
    assert made_with["error_percent"] <= ACCURACY_PERCENT
    theta = pack(flow.parameters, start_of([replace(p, start=None) for p in flow.parameters]))
    same = get_baseline("B").forward(load_study("demo"))
    waves = [model.solve(model.configure(theta)) for model in (flow, same)]
    rms = np.sqrt(np.mean((waves[0] - waves[1]) ** 2, axis=1))
    assert np.all(100 * rms < ACCURACY_PERCENT * np.ptp(waves[1], axis=1))


MISTAKES = [
    ({"accuracy": 0.1}, "accuracy: unknown field; did you mean 'accuracy_percent'?"),
    ({"accuracy_percent": 20}, "accuracy_percent = 20: must be below 10"),
    ({"max_beats": 2**31 - 1}, "max_beats = 2147483647: must be at most 268435456"),
    ({"dx_cm": -1.0}, "dx_cm = -1.0: must be positive"),
    ({"steps_per_beat": 8}, "steps_per_beat = 8: must be at least 32"),
    ({"dx_cm": 1.0, "accuracy_percent": 0.1}, "two ways to say how long cells are; leave one out"),
]


@pytest.mark.parametrize(("table", "words"), MISTAKES)
def test_a_mistake_is_one_line(table: dict[str, object], words: str, tmp_path: Path) -> None:
    study = replace(human(), numerics=table)
    with pytest.raises(StudyError) as caught:
        chosen("human", study)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    lines = [f"{name} = {value!r}".replace("'", '"') for name, value in table.items()]
    for file in HUMAN.iterdir():
        (tmp_path / file.name).write_text(file.read_text())
    path = tmp_path / "study.toml"
    path.write_text("\n".join([path.read_text(), "[numerics]", *lines, ""]))
    with pytest.raises(StudyError) as caught:
        load_study(tmp_path)
    assert words in str(caught.value)
    assert f"{path}: numerics" in str(caught.value)


def test_too_few_steps_for_a_short_vessel() -> None:
    study = replace(short(), numerics={"steps_per_beat": 256})
    with pytest.raises(Exception, match="steps_per_beat = 256: waves cross vessel 8 in less than a step"):
        chosen("short", study)
    case, found = chosen("human", replace(human(), numerics={"steps_per_beat": 1024}))
    solver = solver_of(replace(case, options=found.options), (), np.empty(0))
    assert solver.solve(case.stiffness).steps_per_beat == 1024


def test_accuracy_does_not_fit_truncated_lengths() -> None:
    demo = load_study("demo")
    study = replace(
        demo,
        conventions=demo.conventions.replace(truncate_lengths=True),
        numerics={"accuracy_percent": 0.1},
    )
    with pytest.raises(StudyError, match="truncate_lengths has cells of its own"):
        get_baseline("B").forward(study)


def test_a_start_that_cannot_be_solved_says_what_to_give() -> None:
    study = human()
    loads = Windkessel(5e6, 5e7, 2.5e-4)
    vessels = tuple(v if v.windkessel is None else replace(v, windkessel=loads) for v in study.vessels)
    with pytest.raises(StudyError, match=r"cells and steps cannot be chosen .* give dx_cm"):
        get_baseline("H").forward(replace(study, vessels=vessels))


def test_a_throat_has_cells_of_its_own() -> None:
    study = human()
    case, found = chosen("human", study)
    severity = np.array([0.0, 0, 0, 0, 0, 0, 0.3])
    physics = Physics(
        throat_severity=severity, throat_length=np.full(7, 2.0), throat_position=np.full(7, 0.5)
    )
    cells, length = solver_of(replace(case, options=found.options, physics=physics), (), np.empty(0)).grid()
    assert length[-1] / cells[-1] <= 2.0 / 6
    assert tuple(cells[:-1]) == found.cells[:-1]


def test_twice_as_long_cells_for_the_effect_of_the_grid() -> None:
    study = human()
    case, found = chosen("human", study)
    case = replace(case, options=found.options)
    twice = CATALOGUE["coarse-grid"].apply(case, (1.0,), EVERYWHERE)  # type: ignore[misc]
    moved = simulate(twice, SITES, study.time_s)
    plain = simulate(case, SITES, study.time_s)
    half = replace(
        found.options, cells=tuple(n // 2 for n in found.cells), least_steps=found.options.least_steps // 2
    )
    np.testing.assert_allclose(
        moved, simulate(replace(case, options=half), SITES, study.time_s), rtol=1e-12, atol=1e-12
    )
    assert np.abs(moved - plain).max() > 0


def test_cells_of_another_network_are_refused() -> None:
    network = Network.from_study(human())
    flow = load_study(HUMAN)
    with pytest.raises(SolverArgumentError, match="3 values for 7 vessels"):
        Solver(network, flow.inflow_time_s, flow.inflow_ml_s, options=SolverOptions(cells=(1, 2, 3)))
    with pytest.raises(SolverArgumentError, match=r"cells\[1\] = 0: must be a whole number from 1"):
        SolverOptions(cells=(1, 0))
    with pytest.raises(SolverArgumentError, match="least_steps"):
        SolverOptions(least_steps=70000)


def test_a_simulation_is_looked_at_where_it_is_asked() -> None:
    study = load_study(HUMAN)  # nothing is observed
    one = np.ones(7)
    found = resolve_solver(
        study, Solver.for_study(study), stiffness=4e5 * one, gamma=2 * one, psi1=one, psi2=one, c=one
    )
    assert found.met
    assert ("pressure at" in found.text) != ("flow at" in found.text)


# --- phantoms: walls that are nearly rigid, and flow without a pulse


def tube(stiffness: float, flow: float = 50.0, swing: float = 0.0, **numerics: float) -> Study:
    """A tube of 8 cm and 0.5 cm with a resistance of 200 dyn s/cm5 behind it."""
    times = np.arange(40) / 40
    vessel = Vessel(1, "tube", 8.0, 0.5, 0.5, None, None, resistance=200.0, stiffness_g_cm_s2=stiffness)
    return Study(
        "tube", 1.0, Blood(1.06, 0.04, velocity_profile_order=2.0), (vessel,), times,
        flow + swing * np.sin(2 * np.pi * times), np.empty(0), (), source=Path("study"), numerics=numerics,
    )  # fmt: skip


def solved(study: Study) -> np.ndarray:
    """The pressure at both ends, mmHg."""
    solver = Solver.for_study(study)
    chi = solver.network.stiffness_in
    options = resolve_solver(
        study, solver, stiffness=chi, gamma=2 + 0 * chi, psi1=1 + 0 * chi, psi2=1 + 0 * chi, c=1 + 0 * chi
    ).options
    ends = Solver.for_study(study, series=[(1, 0.0), (1, 1.0)], options=options)
    return ends.solve(chi).pressure_mmHg


@pytest.mark.parametrize("stiffness", [1e7, 1e9])
def test_a_steady_flow_is_solved_and_has_poiseuilles_pressure(stiffness: float) -> None:
    inlet, outlet = solved(tube(stiffness)).mean(axis=1)
    assert outlet == pytest.approx(50 * 200 / 1333.22, rel=1e-4)
    assert inlet - outlet == pytest.approx(50 * 8 * 8 * 0.04 / (np.pi * 0.5**4) / 1333.22, rel=2e-2)
    almost = solved(tube(stiffness, swing=1e-9)).mean(axis=1)
    np.testing.assert_allclose(almost, [inlet, outlet], rtol=1e-5)


def test_a_wall_for_which_no_step_is_short_enough_is_told() -> None:
    with pytest.raises(SolveError, match=r"waves cross vessel 1 at 3.55e.03 m/s, .* softer wall"):
        solved(tube(2e11))


def test_cells_too_short_for_a_rigid_wall_are_told_with_the_vessel_and_its_wave_speed() -> None:
    with pytest.raises(
        SolveError, match=r"CFL. in vessel 1, whose waves run at 251 m/s at rest, .* softer one"
    ):
        solved(tube(1e9, dx_cm=0.01))


def test_the_default_tolerance_follows_the_pulse() -> None:
    """The inflow less its mean, scaled by 1e-5: the pulse is that of a tight solve, not that of the start."""
    study = load_study(HUMAN)
    flow = study.inflow_ml_s.mean() + 1e-5 * (study.inflow_ml_s - study.inflow_ml_s.mean())
    small = replace(study, inflow_ml_s=flow)
    loose, tight = (
        Solver.for_study(small, options=SolverOptions(dx_cm=1.0, tolerance_mmHg=t))
        .solve(4e5)
        .pressure_mmHg[0]
        for t in (None, 1e-9)
    )
    assert np.ptp(tight) < 1e-2
    assert np.abs(loose - tight).max() < 1e-3 * np.ptp(tight)
