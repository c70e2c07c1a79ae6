"""No command writes over, renames or deletes a file that it did not make: every one, with all its inputs."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
import typer
from commands import fails, run

from zoo.blood.importing.imported import Imported, ImportedFileError
from zoo.blood.study import STUDY_FILES, load_study
from zoo.cli import app
from zoo.cli.command import Role
from zoo.core.outputs import RECORD, OutputFileError, Run, output_file, output_folder, write_file
from zoo.core.posterior.files import checkpoint_of

INPUTS = {
    "study": "study",
    "studies": "study",
    "states": "state",
    "effects_from": "effects.py",
    "models_from": "models.py",
    "posteriors": "posteriors",
    "file": "vessels.csv",
    "inflow": "inflow.csv",
    "pressure": "pressure.csv",
    "flow": "inflow.csv",
    "observations": "observations.csv",
    "cases": "cases",
    "answers": "answers",
    "key": "key.json",
    "baseline": "base.json",
}
"""Parameter that is read -> what it is given here."""
WORDS: dict[str, tuple[str, ...] | None] = {
    "fetch": None,
    "studies": None,
    "version": None,
    "doctor": None,
    "effects": None,
    "simulate": ("--stiffness", "5e4"),
    "priors": (),
    "sample": (),
    "compare": (),
    "diagnose": ("--quiet",),
    "report": (),
    "import": ("--period", "0.8"),
    "import-beats": ("--length", "6", "--radius", "1.1"),
    "blind make": (),
    "blind run": (),
    "blind score": (),
}
"""Every command -> words that it needs beside its inputs, None if it writes nothing."""
FOREIGN = {
    "priors": ["priors.csv", "priors.png", "prior-predictive.png"],
    "compare": ["comparison.csv", "fit-A.png", "flow.png", "loops.png"],
    "diagnose": ["diagnosis.json", "report.html", "gap.png", "states.png"],
    "import": list(STUDY_FILES),
    "import-beats": list(STUDY_FILES),
    "blind score": ["score.json", "score.md", "cases.csv"],
}
"""Command that writes into a folder -> files of someone else's that may be in its way there."""
EFFECTS = """
from zoo.blood.effects import effect
from zoo.core.effects import EffectParameter


@effect("kept", family="fluid", parameters=[EffectParameter("a", "1", 0.5, -1.0, 3.0, starts=(0.1,))])
def kept(case, values, location):
    '''Nothing.'''
    return case
"""
MODELS = "def model_kept(study, **settings):\n    raise AssertionError('it worked')\n"


def commands() -> dict[str, dict[str, tuple[Any, ...]]]:
    """Command -> parameter -> typer's information on it and its roles."""

    def of(one: typer.Typer, before: str = "") -> Iterator[tuple[str, Any]]:
        for command in one.registered_commands:
            assert command.callback is not None
            name = command.name or command.callback.__name__
            annotations = command.callback.__annotations__
            yield before + name, {n: (get_args(a) or (a,)) for n, a in annotations.items()}
        for group in one.registered_groups:
            assert group.typer_instance is not None
            yield from of(group.typer_instance, f"{group.typer_instance.info.name} ")

    return dict(of(app))


COMMANDS = commands()


def flag(annotation: tuple[Any, ...]) -> list[str]:
    """The option of a parameter; nothing for an argument."""
    (information,) = (a for a in annotation if type(a).__name__ in ("OptionInfo", "ArgumentInfo"))
    names = [information.default, *(information.param_decls or ())]
    return [str(n) for n in names if str(n).startswith("--")][:1]


def reads(annotation: tuple[Any, ...]) -> bool:
    """Whether a parameter is an input, said or not: a study, or any path that is no output."""
    return Role.STUDY in annotation or ("Path" in str(annotation[0]) and Role.WRITES not in annotation)


def words_of(command: str, written: str, target: Path | str) -> list[str]:
    """A call with all inputs that a command can have, and a target in the place of one output."""
    words = [*command.split(), *(["A"] if command == "sample" else []), *(WORDS[command] or ())]
    for name, annotation in COMMANDS[command].items():
        if reads(annotation):
            words += [*flag(annotation), INPUTS[name]]
        elif name == written:
            words += [*flag(annotation), str(target)]
        elif Role.WRITES in annotation and not flag(annotation):
            words.append("new")
    return words


def state(folder: Path) -> dict[str, str]:
    """All that a folder holds."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
        for path in folder.rglob("*")
    }


@pytest.fixture(scope="module")
def made(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Everything that a command can read."""
    here = tmp_path_factory.mktemp("world")
    for folder in ("study", "state", "cases/case-001", "answers/case-001"):
        shutil.copytree(tiny, here / folder)
    (here / "posteriors").mkdir()
    for file in (
        "posteriors/A.nc",
        "posteriors/diary.txt",
        "observations.csv",
        "key.json",
        "base.json",
        "diary.txt",
    ):
        (here / file).write_text(f"{file}, of someone")
    for file in ("answers/case-001/diagnosis.json", "cases/diary.txt", "answers/diary.txt"):
        (here / file).write_text("{}")
    (here / "vessels.csv").write_text("id,parent,length_cm,radius_cm,R1,R2,C\n1,,5,0.6,900,8000,4e-5\n")
    rows = "".join(f"{i * 0.05:.2f},{15 + i % 4}\n" for i in range(16))
    (here / "inflow.csv").write_text("time_s,flow_ml_s\n" + rows)
    (here / "pressure.csv").write_text("time_s,pressure_mmHg\n" + rows)
    (here / "effects.py").write_text(EFFECTS)
    (here / "models.py").write_text(MODELS)
    return here


@pytest.fixture
def world(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy to work in, where no work succeeds."""

    def never(*_: object, **__: object) -> None:
        raise AssertionError("the work began")

    for work in (
        "zoo.blood.solver.Solver.solve",
        "zoo.blood.plugins.add_effects",
        "zoo.blood.plugins.load_models",
        "zoo.core.posterior.files.sample",
        "zoo.core.posterior.storage.load",
        "zoo.report.gather",
        "zoo.blood.importing.table.import_table",
        "zoo.blood.importing.beats.import_beats",
        "zoo.blood.study_diagnosis.diagnose",
        "zoo.blood.blind.make_cases",
        "zoo.blood.blind.diagnose_cases",
        "zoo.blood.blind.score_cases",
        "zoo.core.outputs._put",
    ):
        monkeypatch.setattr(work, never)
    shutil.copytree(made, tmp_path / "world")
    monkeypatch.chdir(tmp_path / "world")
    return tmp_path / "world"


def test_the_table_has_every_command() -> None:
    assert set(WORDS) == set(COMMANDS)
    for name, parameters in COMMANDS.items():
        assert {n for n, annotation in parameters.items() if reads(annotation)} <= set(INPUTS), name
        writes = [n for n, annotation in parameters.items() if Role.WRITES in annotation]
        assert bool(writes) == (WORDS[name] is not None), name
        assert bool(writes) == ("fresh" in parameters), name


@pytest.mark.parametrize("command", [name for name, words in WORDS.items() if words is not None])
def test_no_input_and_no_file_of_others_is_an_output(command: str, world: Path) -> None:
    """Not with --fresh either, and not by another name."""
    parameters = COMMANDS[command]
    given = {n: Path(INPUTS[n]) for n, annotation in parameters.items() if reads(annotation)}
    files = [Path("diary.txt")]
    for one in given.values():
        files += [one] if one.is_file() else [path for path in one.rglob("*") if path.is_file()]
    targets = [*files, Path("link.nc"), Path("hard.png"), Path("pipe.nc")]
    Path("link.nc").symlink_to(files[-1])
    Path("hard.png").hardlink_to(files[-1])
    os.mkfifo("pipe.nc")
    for name, one in given.items():
        if one.is_dir() and Role.SEARCHED not in parameters[name]:
            targets += [one, one / "new.nc", one / ".." / one.name / "new"]
    before = state(world)
    for written in (name for name, annotation in parameters.items() if Role.WRITES in annotation):
        for target in targets:
            fails(*words_of(command, written, target), "--fresh")
    assert state(world) == before


@pytest.mark.parametrize("command", FOREIGN)
def test_files_of_others_in_a_folder_of_results_stay(
    command: str, world: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for plugins in ("add_effects", "load_models"):
        monkeypatch.setattr(f"zoo.blood.plugins.{plugins}", lambda path: None)
    Path("out").mkdir()
    words = ["compare", "study", "-o", "out"] if command == "compare" else words_of(command, "output", "out")
    for name in FOREIGN[command]:
        path = Path("out") / name
        for make, said in (
            (lambda one: one.write_text("mine"), "not as zoo wrote it"),
            (os.mkfifo, "a pipe"),
        ):
            make(path)
            before = state(world)
            for fresh in ([], ["--fresh"]):
                line = fails(*words, *fresh)
                assert f"--output {path}: is " in line
                assert said in line
            assert state(world) == before
            path.unlink()


@pytest.mark.parametrize("command", ["report", "compare"])
def test_posteriors_of_the_working_folder_are_read_too(command: str, world: Path, monkeypatch) -> None:
    monkeypatch.chdir(world / "posteriors")
    before = state(world)
    assert "--output A.nc: is read here" in fails(command, "demo", "-o", "A.nc", "--fresh")
    assert state(world) == before


def test_a_run_replaces_its_own_files_and_no_other_run_does(tiny: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    solve = "simulate", tiny, "--times", 16, "-o", "w.nc", "--stiffness"
    for fresh in ([], [], ["--fresh"], []):
        run(*solve, "5e4", *fresh)
    said = fails(*solve, "6e4")
    assert "--output w.nc: is of another run: --stiffness was '5e4', here it is '6e4'; add --fresh" in said
    run(*solve, "6e4", "--fresh")
    assert "is of another run" in fails(*solve, "5e4")
    assert sorted(path.name for path in tmp_path.iterdir()) == [RECORD, "w.nc"]
    Path("w.nc").rename("moved.nc")
    run(*solve, "5e4")
    Path("w.nc").write_bytes(Path("w.nc").read_bytes() + b"changed")
    for fresh in ([], ["--fresh"]):
        assert "not as zoo wrote it" in fails(*solve, "5e4", *fresh)
    Path("other").mkdir()
    shutil.copy("moved.nc", "other/w.nc")
    monkeypatch.chdir("other")
    assert "not as zoo wrote it" in fails(*solve, "6e4", "--fresh")


def test_the_same_words_on_other_data_are_another_run(tiny: Path, tmp_path: Path, monkeypatch) -> None:
    shutil.copytree(tiny, tmp_path / "study")
    monkeypatch.chdir(tmp_path)
    words = "simulate", "study", "--stiffness", "5e4", "--times", 16, "-o", "w.csv"
    run(*words)
    inflow = tmp_path / "study" / "inflow.csv"
    inflow.write_text(inflow.read_text() + "\n")
    assert "is of another run: study was [" in fails(*words)


def test_a_file_that_is_set_is_read_too(tiny: Path, tmp_path: Path, monkeypatch) -> None:
    shutil.copytree(tiny, tmp_path / "study")
    monkeypatch.chdir(tmp_path)
    other = Path(shutil.copy("study/inflow.csv", "study/other.csv"))
    words = (
        "simulate",
        "study",
        "--stiffness",
        "5e4",
        "--times",
        16,
        "-o",
        "w.csv",
        "--set",
        "inflow=other.csv",
    )
    run(*words)
    run(*words)
    other.write_text(other.read_text() + "\n")
    assert "is of another run: study was [" in fails(*words)


def test_what_a_file_reads_from_beside_it_is_read_too(tiny: Path, tmp_path: Path, monkeypatch) -> None:
    """A module of a package that is imported by one that is imported; the inflow of openBF's network."""
    monkeypatch.chdir(tmp_path)
    Path("more.py").write_text("import help_of_more\n" + EFFECTS)
    Path("help_of_more.py").write_text("from deeper.most import X\n")
    for package in ("deeper", "another"):
        Path(package).mkdir()
        Path(package, "__init__.py").write_text("")
        Path(package, "most.py").write_text("X = 1\n")
    Path("other.py").write_text("")
    words = "priors", tiny, "--model", "A", "--n-draws", 10, "-q", "--effects-from", "more.py", "-o", "out"
    run(*words)
    Path("other.py").write_text("Y = 1\n")
    Path("another/most.py").write_text("X = 2\n")
    run(*words)
    Path("deeper/most.py").write_text("X = 2\n")
    assert "is of another run: --effects-from was" in fails(*words)
    for text, name in (("inlet_file: flow.dat", "flow.dat"), ("project_name: lung", "lung_inlet.dat")):
        Path("net.yaml").write_text(text)
        Path(name).write_text("0 1")
        assert f"{name}: is read here" in fails("import", "net.yaml", "-o", name, "--fresh")


def test_the_record_itself_loses_nothing(tmp_path: Path) -> None:
    """It is added to, also after a line that was cut short; a link in its place is not followed."""
    out, record = tmp_path / "a.csv", tmp_path / RECORD
    record.write_text('{"file": "a.csv", "sha256": "\n[]\n7\n{"file": "a.csv"')
    before = record.read_text()
    for content in ("one", "two"):
        with Run({"command": "x"}):
            write_file(output_file(out, "-o"), content)
    assert record.read_text().startswith(before)
    with Run({"command": "y"}), pytest.raises(OutputFileError, match="command was 'x', here it is 'y'"):
        output_file(out, "-o")
    (tmp_path / "elsewhere").write_text("mine")
    record.unlink()
    record.symlink_to(tmp_path / "elsewhere")
    out.unlink()
    with Run({"command": "x"}), pytest.raises(OutputFileError, match="is a link, or no file"):
        output_file(out, "-o")
    assert (tmp_path / "elsewhere").read_text() == "mine"


def test_what_came_during_the_run_is_not_replaced_either(tmp_path: Path) -> None:
    with Run({"command": "x"}):
        output_folder(tmp_path, ["a.csv"], "-o")
        for name in ("a.csv", "b.csv"):
            (tmp_path / name).write_text("of someone else")
            with pytest.raises(OutputFileError, match="not as zoo wrote it"):
                write_file(tmp_path / name, "ours")
            assert (tmp_path / name).read_text() == "of someone else"
        (tmp_path / "below").mkdir()
        write_file(tmp_path / "below" / "c.csv", "is no output of the command")
    assert not (tmp_path / "below" / RECORD).exists()
    assert write_file(output_file(tmp_path / "a.csv"), "in Python").read_text() == "in Python"


def test_an_import_that_makes_no_study_writes_nothing(world: Path, monkeypatch) -> None:
    monkeypatch.undo()
    monkeypatch.chdir(world)
    before = state(world)
    table = "import", "vessels.csv", "--inflow", "inflow.csv", "--period", 0.8
    assert "inflow.csv: is read here" in fails(*table, "-o", ".", "--name", "lung/left")
    assert "leave out / and" in fails(*table, "-o", "new", "--name", "lung/left")
    found = Imported(load_study("study"), ())
    with pytest.raises(ImportedFileError, match=r"is there already; give another folder"):
        found.save("study")
    assert state(world) == before


def test_names_with_markup_print_as_they_are(tmp_path: Path, tiny: Path) -> None:
    folder = tmp_path / "study"
    shutil.copytree(tiny, folder)
    text = (folder / "study.toml").read_text().replace('name = "tiny"', 'name = "[bold]tiny[x] :lung:"')
    (folder / "study.toml").write_text(text)
    assert "[bold]tiny[x] :lung:: linear wall" in run("simulate", folder, "--stiffness", "5e4")
    shown = run("priors", folder, "--model", "A", "--n-draws", 10, "-q")
    assert "on [bold]tiny[x] :lung:, set study" in shown
    assert "[/y]" in fails("simulate", "[/y]")


def test_a_checkpoint_lies_in_no_folder_that_is_read(tiny: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(tiny, "A.checkpoint")
    before = state(tmp_path)
    for fresh in ([], ["--fresh"]):
        said = fails("sample", "A", "A.checkpoint", "-o", "A.nc", *fresh)
        assert "--output A.checkpoint: is read here; choose" in said
    assert state(tmp_path) == before


def test_every_output_has_its_own_checkpoint() -> None:
    names = ["post.1", "post.2", "post.nc", "A.netcdf", "A"]
    assert [checkpoint_of(Path(name)).name for name in names] == [
        f"{name}.checkpoint" for name in ("post.1", "post.2", "post", "A.netcdf", "A")
    ]


def test_two_outputs_are_two_files(tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("p.svg").symlink_to("w.csv")
    before = state(tmp_path)
    said = fails("simulate", tiny, "--stiffness", "5e4", "-o", "w.csv", "--plot", "p.svg")
    assert "--plot p.svg: is the path of --output w.csv too; choose another" in said
    assert state(tmp_path) == before
