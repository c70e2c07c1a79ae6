"""Studies from strangers: what they hold ends in one line, quickly, and shows no other file."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from zoo.blood.conventions import ConventionsError, get_conventions
from zoo.blood.importing.imported import ImportedFileError
from zoo.blood.importing.openbf import import_openbf
from zoo.blood.importing.table import import_table
from zoo.blood.network import Network
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import Study, StudyError, load_study

STUDY = """name = "small"
network = "network.toml"
inflow = "inflow.csv"
observations = "observations.csv"
period_s = 1.0
"""
BLOOD = "[blood]\ndensity_g_cm3 = 1.06\nviscosity_g_cm_s = 0.04\n"
LOAD = "windkessel = { R1 = 150.0, R2 = 1500.0, C = 8e-4 }\n"
TREE = f"{BLOOD}[[vessel]]\nid = 1\nlength_cm = 10.0\nradius_cm = 1.2\n{LOAD}"
SECRET = "root:x:0:0:a-secret-line"


def write(folder: Path, **changed: str) -> Path:
    """A study of one vessel, with some of its files changed."""
    times = np.arange(16) / 16
    texts = {
        "study": STUDY,
        "network": TREE,
        "inflow": "time_s,flow_ml_s\n" + "".join(f"{t},{80 + 60 * np.sin(6.28 * t)}\n" for t in times),
        "observations": "vessel,position,quantity,time_s,value\n"
        + "".join(f"1,0,pressure_mmHg,{t},{100 + 15 * np.sin(6.28 * t)}\n" for t in times),
    } | changed
    folder.mkdir(exist_ok=True)
    for name, text in texts.items():
        ending = "toml" if name in ("study", "network") else "csv"
        (folder / f"{name}.{ending}").write_text(text, encoding="utf-8")
    return folder


def refused(work: Callable[[], object], seconds: float = 10.0) -> str:
    """The error's text, of one line of at most 500 visible characters, soon."""
    began = time.process_time()
    with pytest.raises((StudyError, ImportedFileError, ConventionsError)) as error:
        work()
    assert time.process_time() - began < seconds
    text = str(error.value)
    assert len(text) <= 500
    assert text.isprintable()
    return text


def outside(folder: Path) -> None:
    (folder.parent / "secret.csv").write_text(SECRET)


def link(folder: Path) -> str:
    (folder / "link.csv").symlink_to(folder.parent / "secret.csv")
    return "link.csv"


def link_to_folder(folder: Path) -> str:
    (folder / "up").symlink_to(folder.parent)
    return "up/secret.csv"


@pytest.mark.parametrize("field", ["network", "inflow", "observations"])
@pytest.mark.parametrize(
    "name",
    [
        lambda folder: "../secret.csv",
        lambda folder: str(folder.parent / "secret.csv"),
        lambda folder: "..\\\\secret.csv",
        lambda folder: f"../{folder.name}/inflow.csv",
        link,
        link_to_folder,
    ],
    ids=["up", "absolute", "backslash", "up and back", "link", "link to a folder"],
)
def test_a_study_names_files_of_its_folder_only(tmp_path, field, name):
    folder = write(tmp_path / "study")
    outside(folder)
    text = STUDY.replace(f'{field} = "', f'{field} = "{name(folder)}" #')
    (folder / "study.toml").write_text(text)
    said = refused(lambda: load_study(folder))
    assert "leaves the study's folder" in said
    assert "secret-line" not in said


def test_a_link_inside_the_folder_is_followed_and_one_to_a_whole_study_refused(tmp_path):
    folder = write(tmp_path / "study")
    (folder / "inflow.csv").rename(folder / "first.csv")
    (folder / "inflow.csv").symlink_to("first.csv")
    assert load_study(folder).name == "small"
    (folder / "study.toml").unlink()
    (tmp_path / "other.toml").write_text(STUDY)
    (folder / "study.toml").symlink_to(tmp_path / "other.toml")
    assert "study.toml is a link that leaves" in refused(lambda: load_study(folder))


def test_an_openbf_file_names_an_inflow_beside_it_only(tmp_path):
    outside(tmp_path / "x")
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / "net.yaml").write_text(
        "project_name: a\ninlet_file: ../secret.csv\nblood:\n  rho: 1060.0\n  mu: 4.e-3\nnetwork:\n"
        "  - label: a\n    sn: 1\n    tn: 2\n    L: 0.1\n    E: 4.0e5\n    R0: 0.01\n    R1: 1.0e8\n"
        "    Cc: 1.0e-9\n"
    )
    said = refused(lambda: import_openbf(tmp_path / "x" / "net.yaml"))
    assert "leaves the study's folder" in said
    assert "secret-line" not in said


@pytest.mark.parametrize(
    "text",
    [
        "a: &a [1, 2]\nb: [*a, *a]\n",
        "a: &a\n  - b\nc:\n  - *a\n",
        "network: !!python/object/apply:os.system [true]\n",
        "? [a]\n: b\n",
        "a: " + " " * 1_000_000 + "x",
        "- " * 500_000,
        "".join(f"{' ' * i}k:\n" for i in range(1500)),
    ],
    ids=["alias", "alias of a list", "tag", "complex key", "blanks", "dashes", "deep"],
)
def test_yaml_runs_nothing_and_grows_nothing(tmp_path, text):
    (tmp_path / "net.yaml").write_text(text)
    refused(lambda: import_openbf(tmp_path / "net.yaml"))


ESC = "\x1b"
HOSTILE: dict[str, dict[str, str]] = {
    "deep arrays": {"study": f"{STUDY}numerics = {'[' * 3000}{']' * 3000}\n"},
    "deep arrays, a line each": {"study": STUDY + "numerics = " + "[\n" * 20_000 + "]\n" * 20_000},
    "deep tables": {"study": STUDY + f"[priors.{'.'.join('a' * 1900)}]\nb = 1\n"},
    "deep conventions": {"study": STUDY + f"[conventions{'.base' * 800}]\nfriction = 'rest'\n"},
    "a name of a million parts": {"study": STUDY + "a." * 1_000_000 + "b = 1\n"},
    "a million tables": {"study": STUDY + "[[priors.a]]\n" * 1_000_000},
    "200,000 fields": {"network": TREE + "".join(f"a{i}=1\n" for i in range(200_000))},
    "too large a file": {"network": TREE + "#\n" * 6_000_000},
    "5000 digits": {"study": STUDY.replace("1.0", "1" * 4000)},
    "hexadecimal digits": {"study": STUDY.replace("1.0", f"0x{'f' * 4000}")},
    "digits of a parent": {"network": TREE + f"[[vessel]]\nid = 2\nparent = 0x{'f' * 4000}\n"},
    "digits of a prior": {"study": f"{STUDY}[priors]\nf3 = {{ uniform = [1, 0x{'f' * 2000}] }}\n"},
    "digits of a convention": {"study": f"{STUDY}conventions = {{ mmhg = 0x{'f' * 2000} }}\n"},
    "digits of cells": {"study": f"{STUDY}[numerics]\nmax_beats = 0x{'f' * 2000}\n"},
    "a long file name": {"study": STUDY.replace("inflow.csv", "i" * 300)},
    "a zero byte in a name": {"study": STUDY.replace("inflow.csv", "inflow\\u0000.csv")},
    "escapes in a file name": {"study": STUDY.replace("inflow.csv", "\\u001b[31m.csv")},
    "escapes in a name": {"study": STUDY.replace("small", "\\u001b[2J")},
    "direction marks in a name": {"study": STUDY.replace("small", "\\u202egnp")},
    "a name with a path": {"study": STUDY.replace("small", "../../small")},
    "a name that is a folder": {"study": STUDY.replace("small", "..")},
    "a long name": {"study": STUDY.replace("small", "s" * 250)},
    "escapes in a column": {"inflow": f"time_s,flow_ml_s,{ESC}[31m\n1,2,3\n"},
    "a long column": {"inflow": f"time_s,flow_ml_s,{'x' * 100_000}\n1,2,3\n"},
    "a million columns": {"inflow": ",".join(["time_s", "flow_ml_s"] * 500_000) + "\n"},
    "a long cell": {"inflow": f"time_s,flow_ml_s\n0,{'9' * 100_000}x\n"},
    "a cell beyond the reader's": {"inflow": f"time_s,flow_ml_s\n0,{'9' * 1_000_000}\n"},
    "escapes in a cell": {"inflow": f"time_s,flow_ml_s\n0,{ESC}]0;x\n"},
    "huge flows": {"inflow": "time_s,flow_ml_s\n" + "".join(f"{i / 16},1e308\n" for i in range(16))},
    "times that differ by nothing": {
        "inflow": "time_s,flow_ml_s\n" + "".join(f"{i}e-320,{i}\n" for i in range(99)) + "0.5,2\n"
    },
    "a denormal length": {"network": TREE.replace("10.0", "5e-324")},
    "a huge length": {"network": TREE.replace("10.0", "1e300")},
    "a denormal radius": {"network": TREE.replace("1.2", "5e-324")},
    "a huge radius": {"network": TREE.replace("1.2", "1e300")},
    "a denormal density": {"network": TREE.replace("1.06", "5e-324")},
    "a denormal period": {"study": STUDY.replace("1.0", "5e-324")},
    "a denormal load": {"network": TREE.replace("8e-4", "5e-324")},
    "a denormal noise": {"study": f"{STUDY}[noise_sd]\npressure_mmHg = 5e-324\n"},
    "denormal cells": {"study": f"{STUDY}[numerics]\ndx_cm = 5e-324\n"},
}


@pytest.mark.parametrize("what", HOSTILE)
def test_what_a_stranger_may_write_is_one_line_soon(tmp_path, what):
    folder = write(tmp_path / "study", **HOSTILE[what])
    said = refused(lambda: load_study(folder))
    assert str(folder) in said or said.startswith("'")


def test_digits_beyond_pythons_limit_are_one_line(tmp_path):
    folder = write(tmp_path / "study", study=STUDY.replace("1.0", "1" * 4000))
    usual = sys.get_int_max_str_digits()
    sys.set_int_max_str_digits(640)
    try:
        assert "a number of thousands of digits" in refused(lambda: load_study(folder))
    finally:
        sys.set_int_max_str_digits(usual)


def test_conventions_that_refer_to_themselves_are_refused():
    table: dict[str, object] = {"friction": "rest"}
    table["base"] = table
    assert "base = {'friction': 'rest', 'base': {...}}: unknown" in refused(lambda: get_conventions(table))


def test_an_error_says_nothing_of_other_lines(tmp_path):
    folder = write(tmp_path / "study", inflow=f"{SECRET},b\n1,2\n")
    said = refused(lambda: load_study(folder))
    assert said.endswith(f"row 1: {SECRET!r}: unknown column; use one of time_s, flow_ml_s")


def test_a_table_of_vessels_has_bounds_too(tmp_path):
    folder = write(tmp_path / "study")
    (tmp_path / "v.csv").write_text("id,parent,length_cm,radius_cm,R1,R2,C\n1,,10,5e-324,1,1,1\n")
    said = refused(lambda: import_table(tmp_path / "v.csv", folder / "inflow.csv", 1.0))
    assert "radius_cm = 5e-324: must be at least 1e-08" in said
    (tmp_path / "v.csv").write_text("id,parent,length_cm,radius_cm,R1,R2,C\n1,,10,1,1,1,1\n")
    assert "period" in refused(lambda: import_table(tmp_path / "v.csv", folder / "inflow.csv", 5e-324))


def test_a_million_rows_load_in_seconds(tmp_path):
    n = 250_000
    times = (np.arange(n) / n).tolist()
    rows = [f"1,{p},pressure_mmHg,{t!r},100\n" for p in (0, 0.25, 0.5, 1) for t in times]
    folder = write(tmp_path / "study", observations="vessel,position,quantity,time_s,value\n" + "".join(rows))
    began = time.process_time()
    study = load_study(folder)
    assert time.process_time() - began < 15
    assert study.values.shape == (4, n)


def tree(n: int) -> str:
    """A tree whose vessels fork in two, n of them."""
    text = BLOOD
    for i in range(1, n + 1):
        parent = f"parent = {i // 2}\n" if i > 1 else ""
        text += f"[[vessel]]\nid = {i}\nlength_cm = 2.0\nradius_cm = 1.0\n{parent}{LOAD if 2 * i > n else ''}"
    return text


@pytest.mark.filterwarnings("ignore:.*the mean flow times the loads")
def test_the_set_up_of_a_solve_grows_with_the_vessels(tmp_path):
    """From 301 vessels to 1,201 with their third power it would grow 64 times."""
    seconds = []
    for n in (301, 1201):
        study = load_study(write(tmp_path / str(n), network=tree(n), study=STUDY))
        seconds.append(min(one_beat(study) for _ in range(3)))
    assert seconds[1] < 12 * seconds[0]


def one_beat(study: Study) -> float:
    """Seconds of processor for arrays, solver and the start of a solve on the coarsest grid."""
    n = len(study.vessels)
    began = time.process_time()
    Network.from_study(study)
    options = SolverOptions(cells=(1,) * n, least_steps=32, max_beats=1)
    solver = Solver.for_study(study, "linear", options=options)
    ones = np.ones(n)
    solver.solve(stiffness=1e6 * ones, gamma=ones, psi1=ones, psi2=ones, c=ones, check=False)
    return time.process_time() - began


def test_the_order_of_vessels_and_circles_are_found_soon(tmp_path):
    n = 20_000
    star = BLOOD + "".join(
        f"[[vessel]]\nid = {i}\nlength_cm = 2.0\nradius_cm = 1.0\n" + (f"parent = 1\n{LOAD}" if i > 1 else "")
        for i in range(1, n)
    )
    folder = write(tmp_path / "star", network=star)
    began = time.process_time()
    load_study(folder)
    assert time.process_time() - began < 20
    circle = tree(n // 2).replace("parent = 1\n", f"parent = {n // 2}\n", 1)
    folder = write(tmp_path / "circle", network=circle)
    assert "in a circle" in refused(lambda: load_study(folder), 20)


def test_a_command_shows_no_control_characters(tmp_path, capsys):
    from zoo.cli.screen import complain

    complain(f"a{ESC}[31mb\nc" + "x" * 10_000)
    said = capsys.readouterr().err
    assert ESC + "[31mb" not in said
    assert said.count("\n") == 1
    assert len(said) < 600
    assert os.linesep in said
