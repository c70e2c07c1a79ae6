"""The study format: what is read, what is refused and how, and that writing and reading agree."""

from __future__ import annotations

import csv
import gzip
import math
import pickle
import re
import warnings
from collections.abc import Callable
from dataclasses import astuple, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import zoo
from zoo.blood.conventions import PRINTED, PUBLISHED_CODE
from zoo.blood.study import (
    MIN_SAMPLES,
    QUANTITIES,
    Blood,
    LoadWarning,
    Series,
    Study,
    StudyError,
    Vessel,
    Windkessel,
    list_studies,
    load_study,
    save_study,
    sort_vessels,
)

PERIOD = 0.11
STUDY = """\
name = "three vessels"
network = "network.toml"
inflow = "inflow.csv"
observations = "observations.csv"
period_s = 0.11
"""
NETWORK = """\
[blood]
density_g_cm3 = 1.055
viscosity_g_cm_s = 0.049

[[vessel]]
id = 1
name = "root"
length_cm = 0.41
radius_cm = 0.047

[[vessel]]
id = 2
name = "left"
length_cm = 0.445
radius_cm = 0.026
radius_out_cm = 0.024
parent = 1
windkessel = { R1 = 5e4, R2 = 2e5, C = 1.6e-7 }

[[vessel]]
id = 3
name = "right"
length_cm = 0.372
radius_cm = 0.037
parent = 1
windkessel = { R1 = 3e4, R2 = 1.2e5, C = 2.6e-7 }
"""


def inflow_rows(n: int = 64, period: float = PERIOD) -> list[str]:
    samples = ((m * period / n, 0.3 * math.sin(math.pi * m / n) ** 2) for m in range(n))
    return ["time_s,flow_ml_s", *(f"{t:.8f},{q:.6f}" for t, q in samples)]


def observation_rows(n: int = 32, period: float = PERIOD) -> list[str]:
    rows = ["vessel,position,quantity,time_s,value"]
    for vessel, position in ((1, "0.0"), (2, "0.5")):
        for m in range(n):
            rows.append(f"{vessel},{position},pressure_mmHg,{m * period / n:.8f},{10 + vessel + 0.1 * m:.4f}")
    return rows


Files = dict[str, list[str]]


def files() -> Files:
    return {
        "study.toml": STUDY.splitlines(),
        "network.toml": NETWORK.splitlines(),
        "inflow.csv": inflow_rows(),
        "observations.csv": observation_rows(),
    }


def write(folder: Path, content: Files) -> Path:
    for name, lines in content.items():
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def test_what_is_read(tmp_path: Path) -> None:
    study = load_study(write(tmp_path, files()))
    assert study.name == "three vessels"
    assert study.period_s == 0.11
    assert study.blood == Blood(1.055, 0.049)
    assert study.conventions == PRINTED
    assert study.source == tmp_path
    assert study.vessels == (
        Vessel(1, "root", 0.41, 0.047, 0.047, None, None),
        Vessel(2, "left", 0.445, 0.026, 0.024, 1, Windkessel(5e4, 2e5, 1.6e-7)),
        Vessel(3, "right", 0.372, 0.037, 0.037, 1, Windkessel(3e4, 1.2e5, 2.6e-7)),
    )
    assert [s.label for s in study.series] == ["v1@0 pressure_mmHg", "v2@0.5 pressure_mmHg"]
    printed = np.loadtxt(tmp_path / "inflow.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(study.inflow_ml_s, printed[:, 1])
    np.testing.assert_allclose(study.inflow_time_s, printed[:, 0], atol=6e-9)
    np.testing.assert_allclose(study.inflow_time_s, np.arange(64) * 0.11 / 64, rtol=1e-15)
    np.testing.assert_allclose(study.time_s, np.arange(32) * 0.11 / 32, rtol=1e-15)
    np.testing.assert_allclose(study.values[1], 12 + 0.1 * np.arange(32), rtol=1e-14)


def test_forms_that_mean_the_same(tmp_path: Path) -> None:
    plain = load_study(write(tmp_path, files()))
    variants: dict[str, Callable[[Files], None]] = {
        "shuffled rows": lambda f: f["observations.csv"].__setitem__(
            slice(1, None), f["observations.csv"][:0:-1]
        ),
        "blank rows": lambda f: f["inflow.csv"].insert(5, ""),
        "spaces": lambda f: f.__setitem__("inflow.csv", [r.replace(",", " , ") for r in f["inflow.csv"]]),
        "first sample again": lambda f: f["inflow.csv"].append("0.11,0.000000"),
        "byte-order mark": lambda f: f["inflow.csv"].__setitem__(0, "\ufeff" + f["inflow.csv"][0]),
        "carriage returns": lambda f: f.__setitem__("inflow.csv", [r + "\r" for r in f["inflow.csv"]]),
        "columns in another order": lambda f: f.__setitem__(
            "inflow.csv", [",".join(r.split(",")[::-1]) for r in f["inflow.csv"]]
        ),
    }
    for what, change in variants.items():
        changed = files()
        change(changed)
        again = load_study(write(tmp_path, changed))
        if what == "shuffled rows":
            assert [s.vessel for s in again.series] == [2, 1], what
            assert again.series[1].value.tobytes() == plain.series[0].value.tobytes(), what
        else:
            assert again.checksum == plain.checksum, what


@pytest.mark.filterwarnings("ignore::zoo.blood.study.UnitWarning")  # a ramp is no flow
def test_observations_may_begin_later_or_be_absent(tmp_path: Path) -> None:
    content = files()
    offset = [f"1,1,flow_ml_s,{(m + 0.5) * PERIOD / 20:.8f},{m}" for m in range(20)]
    content["observations.csv"] = [content["observations.csv"][0], *offset]
    study = load_study(write(tmp_path, content))
    np.testing.assert_allclose(study.time_s, (np.arange(20) + 0.5) * PERIOD / 20, atol=6e-9)
    assert study.series[0].label == "v1@1 flow_ml_s"
    content["study.toml"].remove('observations = "observations.csv"')
    study = load_study(write(tmp_path, content))
    assert study.series == ()
    assert study.time_s.shape == (0,)
    assert study.values.shape == (0, 0)


def test_conventions_of_a_study(tmp_path: Path) -> None:
    content = files()
    write(tmp_path, content)
    assert load_study(tmp_path, "published-code").conventions == PUBLISHED_CODE
    content["study.toml"].append('conventions = "published-code"')
    write(tmp_path, content)
    assert load_study(tmp_path).conventions == PUBLISHED_CODE
    assert load_study(tmp_path, PRINTED).conventions == PRINTED
    content["study.toml"][-1] = 'conventions = { base = "published-code", friction = "current" }'
    own = load_study(write(tmp_path, content))
    assert own.conventions.name == "custom (published-code with friction=current)"
    save_study(own, tmp_path / "again")
    assert load_study(tmp_path / "again") == own


# ---------------------------------------------------------------------------------------------------
# Mistakes: (file, text to replace or row to change, what to put there) -> what the error says


def swap(file: str, old: str, new: str) -> Callable[[Files], None]:
    def change(content: Files) -> None:
        text = "\n".join(content[file])
        assert text.count(old) >= 1, old
        content[file] = text.replace(old, new, 1).split("\n")

    return change


def drop(file: str, row: int) -> Callable[[Files], None]:
    return lambda content: content[file].pop(row - 1) and None


def add(file: str, row: str) -> Callable[[Files], None]:
    return lambda content: content[file].append(row)


def put(file: str, rows: list[str]) -> Callable[[Files], None]:
    return lambda content: content.__setitem__(file, rows)


def remove(file: str) -> Callable[[Files], None]:
    return lambda content: content.pop(file) and None


def samples(place: str, shift: float = 0.0, n: int = 32, value: int = 1) -> list[str]:
    return [f"{place},{(m + shift) * PERIOD / 32:.8f},{value}" for m in range(n)]


LATE = [f"{m * PERIOD / 64 + 0.0005:.8f},1.0" for m in range(64)]
STEPS = 1 + 0.018 * np.sin(2 * np.pi * (np.arange(100) + 0.5) / 100)  # neighbours agree, the whole does not
DRIFTING = (np.concatenate([[0], np.cumsum(STEPS)])[:100] * PERIOD / 100).tolist()
EXTRA = '\n[[vessel]]\nid = {}\nname = "x"\nlength_cm = 1\nradius_cm = 0.1\n'
LOAD = "windkessel = { R1 = 1, R2 = 1, C = 1 }\n"
OBS, INF, NET, TOP = "observations.csv", "inflow.csv", "network.toml", "study.toml"

# fmt: off
MISTAKES: list[tuple[str, Callable[[Files], None], str]] = [
    # study.toml
    ("toml", add(TOP, "period ="), r"study\.toml: not valid TOML: .*line 6.*; correct that line"),
    ("latin-1", add(TOP, "# \udce9"), r"study\.toml: byte \d+ is not UTF-8; save"),
    ("misspelt", swap(TOP, "period_s", "period"), r"study\.toml: period: unknown field; .*'period_s'\?"),
    ("no name", swap(TOP, 'name = "three vessels"\n', ""), r"study\.toml: name: is missing; add it"),
    ("blank name", swap(TOP, "three vessels", " "), r"study\.toml: name = ' ': must be one line"),
    ("number as text", swap(TOP, "0.11", '"0.11"'),
     r"period_s = '0\.11': must be a number; write it without"),
    ("period zero", swap(TOP, "0.11", "0.0"), r"period_s = 0\.0: must be positive; correct it"),
    ("period inf", swap(TOP, "0.11", "inf"), r"period_s = inf: must be finite"),
    ("no network", swap(TOP, "network.toml", "net.toml"),
     r"network = 'net\.toml': no such file in .*; add it"),
    ("inflow a number", swap(TOP, '"inflow.csv"', "3"), r"inflow = 3: must be a file name; write it"),
    ("switch", add(TOP, 'conventions = { friction = "none" }'),
     r"study\.toml: conventions: friction = 'none': unknown; use one of current"),
    ("noise of no series", add(TOP, "noise_sd = { pressure_mmhg = 0.3 }"),
     r"noise_sd: 'pressure_mmhg': unknown; did you mean 'pressure_mmHg'"),
    ("fetch", swap(TOP, '"inflow.csv"', '{ fetsh = "x" }'),
     r"study\.toml: inflow: fetsh: unknown field; .*'fetch'"),
    # network.toml
    ("no vessels", put(NET, NETWORK.split("\n")[:3]), r"network\.toml: vessel: is missing; add it"),
    ("empty", put(NET, ["vessel = []", *NETWORK.split("\n")[:3]]), r"the list is empty"),
    ("length 0", swap(NET, "0.445", "0"), r"row 11: vessel 2: length_cm = 0: must be positive; correct it"),
    ("id text", swap(NET, "id = 3", 'id = "3"'), r"row 20: vessel 3: id = '3': must be a whole number"),
    ("no id", swap(NET, "id = 3\n", ""), r"row 20: vessel number 3: id: is missing"),
    ("same id", swap(NET, "id = 3", "id = 2"),
     r"row 20: vessel 2: id = 2: also the id of .*row 11.*; give each"),
    ("two roots", swap(NET, "parent = 1\n", ""),
     r"row 11: vessel 2: parent: is missing, but vessel 1 is the root"),
    ("no root", swap(NET, "radius_cm = 0.047", "radius_cm = 0.047\nparent = 1"),
     r"row 5: vessel 1: parent = 1: vessels feed each other in a circle \(1 <- 1\); follow the flow"),
    ("circle", add(NET, "".join(EXTRA.format(i) + f"parent = {j}\n" for i, j in ((7, 9), (8, 7), (9, 8)))),
     r"vessel 7: parent = 9: vessels feed each other in a circle \(7 <- 9 <- 8 <- 7\); follow"),
    ("load inside", add(NET, EXTRA.format(4) + "parent = 3\n" + LOAD),
     r"row 20: vessel 3: windkessel: only a terminal may have one, but this feeds 4; remove it"),
    ("load in capitals", swap(NET, "{ R1 = 5e4, R2 = 2e5, C = 1.6e-7 }", '"Nominal"'),
     r"windkessel = 'Nominal': must be a table of R1, R2 and C; or write \"nominal\""),
    ("date", swap(OBS, "0.00343750,11.1000", "2026-03-04 10:15:00,11.1000"),
     r"row 3: time_s = '2026-03-04 10:15:00': not a number; give seconds from the start of the beat"),
    ("load zero", swap(NET, "R2 = 2e5", "R2 = 0.0"), r"vessel 2: windkessel\.R2 = 0\.0: must be positive"),
    ("load a number", swap(NET, "{ R1 = 5e4, R2 = 2e5, C = 1.6e-7 }", "3"),
     r"windkessel = 3: must be a table"),
    # inflow.csv
    ("empty file", put(INF, []), r"inflow\.csv: the file is empty; its first row is time_s,flow_ml_s"),
    ("no header", drop(INF, 1),
     r"inflow\.csv, row 1: '0\.00000000': unknown column; use one of time_s, flow_ml_s"),
    ("missing column", put(INF, ["time_s", "0", "1"]), r"row 1: flow_ml_s: column missing; add it to time_s"),
    ("twice", put(INF, ["time_s,time_s"]), r"row 1: 'time_s': the column occurs twice; keep one"),
    ("cells", swap(INF, "0.00171875,", "0.00171875,,"),
     r"row 3: 3 cells where the header has 2; give time_s,flow"),
    ("text", swap(INF, "0.00171875,", "0.00171875,x"),
     r"row 3: flow_ml_s = 'x0\.000722': not a number; correct"),
    ("nan", swap(INF, "0.00171875,0.000722", "0.00171875,nan"),
     r"row 3: flow_ml_s = 'nan': must be finite; inter"),
    ("quote", swap(INF, "0.00171875,", '"0.00171875'), r"inflow\.csv, row \d+: .*; correct that row"),
    ("few", put(INF, inflow_rows(15)),
     r"inflow\.csv: inflow: 15 samples: too few for a beat; give at least 16"),
    ("cut short", lambda content: content.__setitem__(INF, content[INF][:10] + content[INF][11:60]),
     r"inflow\.csv, row 59: time_s = 0\.0996875: inflow: 0\.0103125 s before period_s = 0\.11 ends"),
    ("backwards",
     lambda content: content.__setitem__(INF, [*content[INF][:10], "0.05,1.0", *content[INF][10:]]),
     r"inflow\.csv, row 12: time_s = 0\.01546875: inflow: before that of row 11; sort the rows by time"),
    ("same time", add(INF, "0.00171875,0.1"),
     r"row 66: time_s = 0\.00171875: inflow: a second sample .* row 3; keep"),
    ("last is not the first", add(INF, "0.11,0.2"),
     r"row 66: flow_ml_s = 0\.2: inflow: a period_s = 0\.11 after the first sample \(0\), so"),
    ("late", put(INF, ["time_s,flow_ml_s", *LATE]),
     r"row 2: time_s = 0\.0005: inflow: the inflow must begin at time 0"),
    ("drift", put(INF, ["time_s,flow_ml_s", *(f"{t:.9f},1" for t in DRIFTING)]),
     r"time_s = .*: inflow: .* s from its place on a uniform grid; resample"),
    ("backwards", put(INF, ["time_s,flow_ml_s", *(r.replace(",", ",-") for r in inflow_rows()[1:])]),
     r"study\.toml: inflow = 'inflow\.csv': mean flow_ml_s = -0\.15: must be positive; count flow"),
    # observations.csv
    ("only a header", put(OBS, observation_rows()[:1]),
     r"observations\.csv: no samples; add some, or remove"),
    ("vessel text", swap(OBS, "\n2,0.5", "\nMPA,0.5"),
     r"row 34: vessel = 'MPA': not a whole number; use a vessel's id"),
    ("position", swap(OBS, "\n2,0.5", "\n2,1.5"), r"row 34: position = 1\.5: must be in \[0, 1\]"),
    ("position nan", swap(OBS, "\n2,0.5", "\n2,nan"), r"row 34: position = 'nan': must be finite"),
    ("value", swap(OBS, "0.00343750,11.1000", "0.00343750,x"),
     r"observations\.csv, row 3: value = 'x': not a number"),
    ("nan value", swap(OBS, "0.00343750,11.1000", "0.00343750,nan"),
     r"observations\.csv, row 3: value = 'nan': must be finite; leave it empty if not measured"),
    ("underscore", swap(OBS, "11.1000", "11_1"),
     r"row 3: value = '11_1': not a number; leave it empty if not measured"),
    ("duplicate", add(OBS, "2,0.50,pressure_mmHg,0.0,3"),
     r"row 66: time_s = 0: v2@0\.5 pressure_mmHg: a second sam"),
    ("before the beat", put(OBS, observation_rows()[:1] + samples("1,0,flow_ml_s", -0.5)),
     r"row 2: time_s = -0\.00171875: v1@0 flow_ml_s: before the beat; count from its start"),
    ("after the beat", put(OBS, observation_rows()[:1] + samples("1,0,flow_ml_s", 3)),
     r"row 33: time_s = 0\.116875: v1@0 flow_ml_s: past the period, as the series begins late"),
    ("second beat", put(OBS, observation_rows()[:1] + samples("1,0,flow_ml_s", n=64)),
     r"row 65: time_s = 0\.2165625: v1@0 flow_ml_s: 64 samples .* make a beat of 0\.22 s, but"),
    ("milliseconds",
     put(OBS, observation_rows()[:1] + [f"1,0,flow_ml_s,{3.4375 * i:.4f},1" for i in range(32)]),
     r"32 samples .* make a beat of 110 s, .*; divide the times by 1000, which seem to be in ms"),
    ("negative area", put(OBS, observation_rows()[:1] + samples("1,0,area_cm2", value=-1)),
     r"row 2: value = -1\.0: an area_cm2 must be positive"),
]
# fmt: on


@pytest.mark.parametrize(("what", "change", "message"), MISTAKES, ids=[m[0] for m in MISTAKES])
def test_a_mistake_is_named_in_one_line(
    tmp_path: Path, what: str, change: Callable[[Files], None], message: str
) -> None:
    content = files()
    load_study(write(tmp_path, content))
    change(content)
    for name in files():
        (tmp_path / name).unlink()
    for name, lines in content.items():
        (tmp_path / name).write_bytes(("\n".join(lines) + "\n").encode("utf-8", "surrogateescape"))
    with pytest.raises(StudyError, match=message) as error:
        load_study(tmp_path)
    text = str(error.value)
    assert "\n" not in text
    assert text.startswith(str(tmp_path)), "the file comes first"
    assert re.search(r"; \w+", text), "a remedy ends it"


def test_a_bare_terminal_needs_an_observed_root(tmp_path: Path) -> None:
    content = files()
    swap(NET, "windkessel = { R1 = 5e4, R2 = 2e5, C = 1.6e-7 }", "")(content)
    with pytest.warns(LoadWarning, match=r"row \d+: vessel 2: windkessel: is missing at terminal 2, while"):
        assert load_study(write(tmp_path, content)).vessels[1].windkessel is None
    stated = files()
    swap(NET, "windkessel = { R1 = 5e4, R2 = 2e5, C = 1.6e-7 }", 'windkessel = "nominal"')(stated)
    with warnings.catch_warnings():
        warnings.simplefilter("error", LoadWarning)
        study = load_study(write(tmp_path, stated))
        save_study(study, tmp_path / "saved")
        assert load_study(tmp_path / "saved").checksum == study.checksum
    swap(NET, "windkessel = { R1 = 3e4, R2 = 1.2e5, C = 2.6e-7 }", "")(content)
    with warnings.catch_warnings():
        warnings.simplefilter("error", LoadWarning)
        assert load_study(write(tmp_path, content)).vessels[2].windkessel is None
    message = (
        r"network\.toml, row 11: vessel 2: windkessel: is missing at a terminal, .*root \(vessel 1\); add"
    )
    only_left = [r for r in observation_rows() if not r.startswith("1,")]
    for change in (put(OBS, only_left), swap(TOP, 'observations = "observations.csv"', "")):
        broken = {name: list(lines) for name, lines in content.items()}
        change(broken)
        with pytest.raises(StudyError, match=message):
            load_study(write(tmp_path, broken))


def test_names_and_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "mouse-c6" in list_studies()
    with pytest.raises(StudyError, match=r"mouse-c7: neither a folder .* did you mean 'mouse-c6'\?"):
        load_study("mouse-c7")
    with pytest.raises(StudyError, match=r"no study\.toml in this folder; add one"):
        load_study(tmp_path)
    write(tmp_path, files())
    assert load_study(str(tmp_path)) == load_study(tmp_path / "study.toml")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "artery").mkdir()
    write(tmp_path / "artery", files())
    with pytest.raises(StudyError, match=r"did you mean 'artery'\?"):
        load_study("artry")
    (tmp_path / "mouse-c6").mkdir()
    write(tmp_path / "mouse-c6", files())
    with pytest.raises(StudyError, match=r"mouse-c6: both a built-in study and a folder here; write"):
        load_study("mouse-c6")
    assert load_study("./mouse-c6").name == "three vessels"
    assert load_study(Path("mouse-c6")).name == "three vessels"


@pytest.mark.filterwarnings("ignore::zoo.blood.study.UnitWarning")  # a ramp is no flow
def test_a_built_in_copy_reads_the_same_checks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fetched columns: numbers of one file, averaged in groups that must fit."""
    column = tmp_path / "column.dat"
    monkeypatch.setattr(zoo.blood.study.samples, "fetch_file", lambda name: column)
    content = files()
    swap(TOP, '"inflow.csv"', '{ fetch = "set/q.dat" }')(content)
    table = '{ fetch = "set/p.dat", vessel = 1, position = 0.5, quantity = "flow_ml_s", average = 2 }'
    swap(TOP, '"observations.csv"', table)(content)
    write(tmp_path, content)
    column.write_text("\n".join(str(1 + m % 40) for m in range(41)) + "\n")
    with pytest.raises(StudyError, match=r"average = 2: does not divide the 41 samples of set/p\.dat; use a"):
        load_study(tmp_path)
    column.write_text("\n".join(str(1 + m) for m in range(40)) + "\n")
    with pytest.raises(StudyError, match=r"column\.dat, row 40: value = 40: inflow: .* must repeat that one"):
        load_study(tmp_path)
    column.write_text("1\n2\nx\n")
    with pytest.raises(StudyError, match=r"column\.dat, row 3: value = 'x': not a number"):
        load_study(tmp_path)
    column.write_text("\n".join(str(1 + m % 39) for m in range(40)) + "\n")
    study = load_study(tmp_path)
    assert study.inflow_ml_s.tolist() == list(range(1, 40))
    assert study.values[0].tolist() == [1.5 + 2 * m for m in range(19)] + [(39 + 1) / 2]
    np.testing.assert_allclose(study.time_s, (np.arange(20) + 0.25) * PERIOD / 20, rtol=1e-12)
    swap(TOP, "position = 0.5", "position = 2.0")(content)
    with pytest.raises(StudyError, match=r"study\.toml: observations: position = 2\.0: must be in \[0, 1\]"):
        load_study(write(tmp_path, content))


# ---------------------------------------------------------------------------------------------------
# The object


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return load_study(write(tmp_path, files()))


def test_arrays_are_read_only_and_survive_a_pickle(study: Study) -> None:
    for copy in (study, pickle.loads(pickle.dumps(study)), pickle.loads(pickle.dumps(study, protocol=5))):
        arrays = [copy.inflow_time_s, copy.inflow_ml_s, copy.time_s, *(s.value for s in copy.series)]
        for array in arrays:
            assert array.dtype == np.float64
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1.0
        assert copy == study
        assert hash(copy) == hash(study)
        assert copy.values.tobytes() == study.values.tobytes()
    mine = np.zeros(32)
    series = Series(1, 0.0, "flow_ml_s", mine)
    mine[:] = 7
    assert series.value.max() == 0, "a series does not share memory that its maker can write to"


def test_checksum_follows_the_content(study: Study) -> None:
    same = replace(study, name="other", conventions=PUBLISHED_CODE, source="elsewhere", checksum="?")
    assert same.checksum == study.checksum
    assert same != study
    named = replace(study, vessels=(replace(study.vessels[0], name="MPA"), *study.vessels[1:]))
    assert named.checksum == study.checksum
    assert len(study.checksum) == 64
    inflow = study.inflow_ml_s.copy()
    inflow[3] = np.nextafter(inflow[3], 1)
    first = study.series[0]
    others = [
        replace(study, inflow_ml_s=inflow),
        replace(study, period_s=0.12),
        replace(study, blood=Blood(1.06, 0.049)),
        replace(study, vessels=(replace(study.vessels[0], radius_cm=0.048), *study.vessels[1:])),
        replace(study, vessels=(*study.vessels[:2], replace(study.vessels[2], windkessel=None))),
        replace(study, series=(replace(first, vessel=3), study.series[1])),
        replace(study, series=(replace(first, position=1.0), study.series[1])),
        replace(study, series=(replace(first, quantity="flow_ml_s"), study.series[1])),
        replace(study, series=study.series[:1]),
        replace(study, series=study.series[::-1]),
        replace(study, time_s=study.time_s + 1e-9),
    ]
    assert len({study.checksum, *(other.checksum for other in others)}) == len(others) + 1


def test_arrays_must_fit_each_other(study: Study) -> None:
    with pytest.raises(StudyError, match=r"inflow_ml_s: shape \(3,\) does not fit the 64 times"):
        replace(study, inflow_ml_s=np.ones(3))
    with pytest.raises(StudyError, match=r"v1@0 pressure_mmHg: shape \(32,\) does not fit the 31 times"):
        replace(study, time_s=study.time_s[1:])


# ---------------------------------------------------------------------------------------------------
# Writing and reading back

positive = st.floats(min_value=1e-12, max_value=1e12, allow_subnormal=False)
finite = st.floats(allow_nan=False, allow_infinity=False, width=64).map(lambda x: x if abs(x) < 1e30 else 1.0)
sizes = st.floats(1e-8, 1e8)
words = st.text(st.characters(codec="utf-8", categories=["L", "N", "P", "S"]), min_size=1, max_size=8)


@st.composite
def studies(draw: st.DrawFn) -> Study:
    n = draw(st.integers(1, 12))
    ids = draw(st.lists(st.integers(1, 2**31 - 1), min_size=n, max_size=n, unique=True))
    parents = [None, *(draw(st.integers(0, i - 1)) for i in range(1, n))]
    loads = st.builds(Windkessel, positive, positive, positive)
    vessels = []
    for i in range(n):
        radius, parent = draw(sizes), None if parents[i] is None else ids[parents[i]]
        out, load = draw(st.one_of(st.just(radius), sizes)), None if i in parents else draw(loads)
        vessels.append(Vessel(ids[i], draw(words), draw(sizes), radius, out, parent, load))
    vessels = draw(st.permutations(vessels))
    period = draw(st.floats(1e-3, 10.0))
    n_inflow, n_times = draw(st.integers(MIN_SAMPLES, 24)), draw(st.integers(MIN_SAMPLES, 24))
    inflow = draw(st.lists(st.floats(-1, 10), min_size=n_inflow, max_size=n_inflow))
    inflow[0] = 1.0 + n_inflow  # a positive mean
    offset = draw(st.floats(0, 0.8)) * period / n_times
    at = st.floats(0, 1).map(lambda x: x + 0.0)
    place = st.tuples(st.sampled_from(ids), at, st.sampled_from(QUANTITIES))
    places = draw(st.lists(place, max_size=3, unique=True))
    series = []
    for vessel, position, quantity in places:
        values = draw(st.lists(finite, min_size=n_times, max_size=n_times))
        values = [abs(v) + 1e-3 for v in values] if quantity == "area_cm2" else values
        series.append(Series(vessel, position, quantity, np.array(values)))
    own = PUBLISHED_CODE.replace(friction="rest", mmhg=1333.0)
    conventions = draw(st.sampled_from([PRINTED, PUBLISHED_CODE, own]))
    return Study(
        name=draw(words.filter(lambda word: not set(word) & set("/\\") and word.strip("."))),
        period_s=period,
        blood=Blood(draw(positive), draw(positive)),
        vessels=tuple(vessels),
        inflow_time_s=np.arange(n_inflow) * (period / n_inflow),
        inflow_ml_s=np.array(inflow),
        time_s=offset + np.arange(n_times) * (period / n_times) if series else np.empty(0),
        series=tuple(series),
        conventions=conventions,
    )


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(study=studies())
def test_round_trip_is_exact(tmp_path: Path, study: Study) -> None:
    save_study(study, tmp_path / "x" / "y")
    again = load_study(tmp_path / "x" / "y")
    assert again == study
    assert again.name == study.name
    assert again.vessels == study.vessels
    assert again.blood == study.blood
    assert again.conventions == study.conventions
    assert again.checksum == study.checksum
    for name in ("inflow_time_s", "inflow_ml_s", "time_s", "values"):
        assert getattr(again, name).tobytes() == getattr(study, name).tobytes(), name


def tree_of(parents: list[int | None]) -> list[Vessel]:
    return [Vessel(i + 1, "v", 1.0, 0.1, 0.1, None if p is None else p + 1) for i, p in enumerate(parents)]


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_parents_stand_before_children_in_every_tree(data: st.DataObject) -> None:
    n = data.draw(st.integers(1, 30))
    parents = [None, *(data.draw(st.integers(0, i - 1)) for i in range(1, n))]
    tree = tree_of(parents)
    shuffled = data.draw(st.permutations(tree))
    order = sort_vessels(shuffled)
    assert sorted(order) == list(range(n))
    seen: set[int | None] = {None}
    for i in order:
        assert shuffled[i].parent in seen
        seen.add(shuffled[i].id)
    assert sort_vessels([shuffled[i] for i in order]) == list(range(n)), "a sorted tree stays as it is"


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_a_circle_is_found_in_every_tree(data: st.DataObject) -> None:
    """Giving a vessel one of its own descendants as a parent always makes one."""
    n = data.draw(st.integers(2, 20))
    parents = [None, *(data.draw(st.integers(0, i - 1)) for i in range(1, n))]
    low = data.draw(st.integers(1, n - 1))
    line = [low]
    while parents[line[-1]] is not None:
        line.append(parents[line[-1]])
    top = data.draw(st.sampled_from(line))
    parents[top] = low
    tree = tree_of(parents)
    with pytest.raises(StudyError, match="circle") as error:
        sort_vessels(data.draw(st.permutations(tree)))
    circle = [int(word) for word in re.findall(r"\((.*)\)", str(error.value))[0].split(" <- ")]
    assert circle[0] == circle[-1]
    for child, parent in pairwise(circle):
        assert parents[child - 1] == parent - 1


# ---------------------------------------------------------------------------------------------------
# Studies that exist


@pytest.mark.needs_data
def test_mouse_c6(data_dir: Path) -> None:
    study = load_study("mouse-c6")
    assert study.conventions == PUBLISHED_CODE
    assert study.period_s == 0.11
    assert study.source == "built-in study mouse-c6"
    flow = np.loadtxt(data_dir / "mouse-c6" / "qC6_8192.dat")
    np.testing.assert_array_equal(study.inflow_ml_s, flow[:8192])
    assert study.inflow_ml_s.max() == pytest.approx(0.5523)
    assert study.inflow_ml_s.mean() == pytest.approx(0.169, abs=5e-4)
    assert study.inflow_time_s[study.inflow_ml_s.argmax()] == pytest.approx(0.0215, abs=1e-4)
    pressure = np.loadtxt(data_dir / "mouse-c6" / "pC6_1024.dat")
    assert study.values.shape == (1, 512)
    assert (study.series[0].vessel, study.series[0].position) == (1, 0.0)
    # the published 512 samples are the public 1024, interpolated linearly at linspace(0, 1023, 512)
    interpolated = np.interp(np.linspace(0, 1023, 512), np.arange(1024), pressure)
    np.testing.assert_allclose(study.values[0], interpolated, atol=2e-3)
    np.testing.assert_allclose(study.time_s, np.arange(512) * 0.11 / 512, rtol=1e-12)
    assert load_study("mouse-c6", "printed").conventions == PRINTED


def assert_published_tree(study: Study, table: Path) -> None:
    with open(table, newline="") as file:
        rows = list(csv.DictReader(file))
    vessels = {v.id: v for v in study.vessels}
    assert {int(row["vessel"]) for row in rows} == set(vessels)
    for row in rows:
        vessel = vessels[int(row["vessel"])]
        assert vessel.parent == (int(row["parent"]) if row["parent"] else None)
        assert vessel.length_cm == float(row["length_cm"])
        assert vessel.radius_cm == vessel.radius_out_cm == float(row["radius_cm"])


@pytest.mark.needs_data
def test_mouse_h1(data_dir: Path) -> None:
    """The samples and the vessels that the data set has, and loads that are derived."""
    study = load_study("mouse-h1")
    assert study.conventions == PRINTED
    assert study.inflow_ml_s.shape == (8192,)
    pressure = np.loadtxt(data_dir / "mouse-h1" / "pH1_1024.dat")
    np.testing.assert_allclose(study.values[0], (pressure[::2] + pressure[1::2]) / 2, rtol=1e-14)
    assert_published_tree(study, data_dir / "mouse-h1" / "network.csv")
    assert all(v.windkessel is None for v in study.vessels)


def test_tables_of_study_toml_are_kept(tmp_path: Path) -> None:
    """[priors], [noise_sd] and [numerics] are read, written and part of what makes two studies equal."""
    study = load_study("demo")
    tables = {
        "priors": {"wave_speed_m_s": [1.0, 12.0]},
        "noise_sd": {"pressure_mmHg": 0.3},
        "numerics": {"accuracy_percent": 0.05},
    }
    changed = replace(study, **tables)
    save_study(changed, tmp_path)
    back = load_study(tmp_path)
    assert back == changed != study
    assert (back.priors, back.noise_sd, back.numerics) == tuple(tables.values())
    assert back.checksum == study.checksum


@pytest.mark.needs_data
def test_mouse_c6_has_the_published_tree_and_loads(data_dir: Path) -> None:
    assert_published_tree(load_study("mouse-c6"), data_dir / "network" / "mouse21.csv")
    vessels = {v.id: v for v in load_study("mouse-c6").vessels}
    pressure_unit, flow_unit, time_unit = 1.055 * 981 * 0.1, 0.1, 0.01
    with open(data_dir / "network" / "nominal_windkessel.csv", newline="") as file:
        published = list(csv.DictReader(file))
    assert {int(row["vessel"]) for row in published} == {v.id for v in vessels.values() if v.windkessel}
    for row in published:
        load = vessels[int(row["vessel"])].windkessel
        resistance = pressure_unit / flow_unit
        assert load.R1 == pytest.approx(float(row["R1"]) * resistance, rel=1e-9)
        assert load.R2 == pytest.approx(float(row["R2"]) * resistance, rel=1e-9)
        assert load.C == pytest.approx(float(row["C"]) * time_unit / resistance, rel=1e-9)


@pytest.mark.needs_data
def test_mouse_c6_against_the_published_solver(data_dir: Path) -> None:
    """Published solver's waves at model A's medians: row for row a sum of squares of 65.5 (printed: 66)."""
    study = load_study("mouse-c6")
    with gzip.open(data_dir / "reference" / "linear_constant_A.csv.gz", "rt") as file:
        waves = np.loadtxt(file, delimiter=",", skiprows=1, usecols=(0, 1))
    computed = np.interp(study.time_s, waves[:, 0], waves[:, 1], period=0.11)
    assert np.sum((computed - study.values[0]) ** 2) == pytest.approx(65.51, abs=0.01)


@pytest.mark.needs_data
def test_blind_cases(blind_cases: list[Path]) -> None:
    """All cases of the independent simulator load, with the same tree and loads as mouse-c6."""
    assert len(blind_cases) == 25
    mouse = load_study("mouse-c6")
    for folder in blind_cases:
        study = load_study(folder)
        assert study.name == folder.name
        assert study.conventions == PRINTED
        assert study.inflow_ml_s.shape == (1024,)
        np.testing.assert_allclose(study.time_s, np.arange(512) * 0.11 / 512, rtol=1e-12)
        with open(folder / "observations.csv", newline="") as file:
            rows = list(csv.DictReader(file))
        assert study.values.ravel().tolist() == [float(row["value"]) for row in rows]
        assert len(study.series) == len({(row["vessel"], row["position"]) for row in rows})
        for own, other in zip(study.vessels, mouse.vessels, strict=True):
            assert (own.id, own.parent) == (other.id, other.parent)
            assert (own.length_cm, own.radius_cm) == (other.length_cm, other.radius_cm)
            loads = [v.windkessel and astuple(v.windkessel) for v in (own, other)]
            assert loads[0] == (loads[1] and pytest.approx(loads[1], rel=1e-8))


def test_everything_that_simulate_writes_has_its_unit(tmp_path: Path) -> None:
    import xarray as xr
    from typer.testing import CliRunner

    from zoo.cli import app

    path = tmp_path / "waves.nc"
    done = CliRunner().invoke(app, ["simulate", "demo", "--stiffness", "6e4", "-o", str(path)])
    assert done.exit_code == 0, done.output
    waves = xr.load_dataset(path)
    units = {name: waves[name].attrs.get("units") for name in (*waves.data_vars, "position", "time")}
    assert units == {
        "pressure_mmHg": "mmHg",
        "flow_ml_s": "ml/s",
        "area_cm2": "cm2",
        "stiffness": "g cm-1 s-2",
        **dict.fromkeys(("gamma", "psi1", "psi2", "c", "position"), "1"),
        "time": "s",
    }
    assert waves["pressure_mmHg"].sel(vessel=1, position=0.5).dims == ("time",)
