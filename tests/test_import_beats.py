"""Raw records of pressure and flow over several beats, averaged into a study."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from zoo.blood.importing.beats import COVARIANCE_FILES, import_beats
from zoo.blood.importing.imported import ImportedFileError
from zoo.blood.importing.study_beats import average_beats
from zoo.blood.study import StudyError, load_study
from zoo.cli import app

PERIOD, STEP, BEATS = 0.8, 0.005, 7


def flow(t: np.ndarray) -> np.ndarray:
    """A rise at the begin of each beat, ml/s."""
    return 10 + 90 * np.exp(-((((t % PERIOD) - 0.15) / 0.05) ** 2))


def pressure(t: np.ndarray) -> np.ndarray:
    return 80 + 0.3 * flow(t) + 5 * np.cos(2 * np.pi * t / PERIOD)


def write(
    path: Path,
    t: np.ndarray,
    values: np.ndarray,
    name: str,
    clock: float = 0.0,
    seed: int = 1,
    sd: float = 0.3,
) -> Path:
    values = values + np.random.default_rng(seed).normal(0, sd, len(t))
    rows = [
        f"{s + clock:.4f},{v:.6f}" if np.isfinite(v) else f"{s + clock:.4f},"
        for s, v in zip(t, values, strict=True)
    ]
    path.write_text("\n".join([f"time_s,{name}", *rows]) + "\n")
    return path


def records(folder: Path, late: float = 0.0, clock: float = 0.0, step_q: float = STEP) -> tuple[Path, Path]:
    t, tq = np.arange(0.3, BEATS * PERIOD, STEP), np.arange(0.3, BEATS * PERIOD, step_q)
    return (
        write(folder / "p.csv", t, pressure(t), "pressure_mmHg"),
        write(folder / "q.csv", tq, flow(tq - late), "flow_ml_s", clock, 2, 0.5),
    )


def test_beats_become_a_study(tmp_path: Path) -> None:
    p, q = records(tmp_path)
    done = CliRunner().invoke(
        app, ["import-beats", str(p), str(q), "--length", "6", "--radius", "1.1", "-o", str(tmp_path / "s")]
    )
    assert done.exit_code == 0, done.output
    study = load_study(tmp_path / "s")
    assert study.period_s == pytest.approx(PERIOD, abs=2e-3)
    assert study.noise_sd["pressure_mmHg"] == pytest.approx(0.3, rel=0.25)
    begin = study.inflow_time_s[np.argmax(study.inflow_ml_s)]  # of the rise, before its top
    back = 0.15 - begin
    assert study.inflow_ml_s == pytest.approx(flow(study.inflow_time_s + back), abs=4)
    assert study.series[0].value == pytest.approx(pressure(study.time_s + back), abs=2)
    for name in COVARIANCE_FILES.values():
        matrix = np.loadtxt(tmp_path / "s" / name, delimiter=",", skiprows=1)[:, 1:]
        assert matrix.shape == (len(study.time_s),) * 2
        assert matrix == pytest.approx(matrix.T)
    assert np.sqrt(np.mean(np.diag(import_beats(p, q, 6, 1.1).covariance["pressure_mmHg"]))) == (
        pytest.approx(study.noise_sd["pressure_mmHg"])
    )


def test_the_command_says_what_a_record_without_a_quiet_diastole_lacks(tmp_path: Path) -> None:
    t = np.arange(0.3, BEATS * PERIOD, STEP)
    p = write(tmp_path / "p.csv", t, pressure(t), "pressure_mmHg")
    q = write(tmp_path / "q.csv", t, 60.0 + flow(t), "flow_ml_s", 0.0, 2, 0.5)
    given = ["import-beats", str(p), str(q), "--length", "6", "--radius", "1.1", "-o", str(tmp_path / "s")]
    done = CliRunner().invoke(app, given)
    assert done.exit_code == 0, done.output
    last = done.output.splitlines()[-1]
    assert last.startswith("next: add what lacks: ")
    assert "give every terminal a windkessel" in last


@pytest.mark.parametrize("late", [0.026, -0.04])
def test_the_offset_is_told_and_left(tmp_path: Path, late: float) -> None:
    found = import_beats(*records(tmp_path, late), 6, 1.1)
    assert found.offset_s == pytest.approx(late, abs=2e-3)
    assert f"{abs(1000 * late):.0f} ms {'late' if late > 0 else 'early'}" in " ".join(found.read)
    tops = [
        times[np.argmax(values)]
        for times, values in (
            (found.study.inflow_time_s, found.study.inflow_ml_s),
            (found.study.time_s, found.study.series[0].value),
        )
    ]
    assert tops[0] - tops[1] == pytest.approx(late, abs=2 * STEP)


def test_clocks_of_other_steps_and_of_no_time_in_common(tmp_path: Path) -> None:
    shared = import_beats(*records(tmp_path, 0.02, step_q=0.008), 6, 1.1)
    assert shared.offset_s == pytest.approx(0.02, abs=3e-3)
    apart = import_beats(*records(tmp_path, clock=5000.0), 6, 1.1)
    assert apart.offset_s is None
    assert "NOT measured" in " ".join(apart.read)
    assert apart.study.period_s == pytest.approx(PERIOD, abs=2e-3)


def test_gaps_leave_a_beat_out_and_a_beat_that_differs_is_named(tmp_path: Path) -> None:
    p, q = records(tmp_path)
    whole = import_beats(p, q, 6, 1.1)
    t = np.arange(0.3, BEATS * PERIOD, STEP)
    values = pressure(t)
    values[(t > 2.0) & (t < 2.1)] = np.nan
    values[(t > 3.4) & (t < 3.9)] += 6
    found = import_beats(write(p, t, values, "pressure_mmHg"), q, 6, 1.1)
    assert len(found.beats["pressure_mmHg"]) == len(whole.beats["pressure_mmHg"]) - 1
    assert "pressure_mmHg not measured throughout" in found.left_out[0]
    assert sum("differs" in line for line in found.read) >= 1
    assert not any("differs" in line for line in whole.read)


def test_clock_times_past_midnight_and_units_in_remarks(tmp_path: Path) -> None:
    p, q = records(tmp_path)
    plain = import_beats(p, q, 6, 1.1)
    for path, factor, unit in ((p, 1.0, "mmHg"), (q, 60 / 1000, "L/min")):
        rows = [line.split(",") for line in path.read_text().split()[1:]]
        lines = [f"# output: A; unit: {unit}; start: then", "timestamp,value"]
        for time, value in rows:
            s = (86400 - 2 + float(time)) % 86400
            hour, rest = divmod(s, 3600)
            lines.append(f"{hour:.0f}:{rest // 60:.0f}:{rest % 60:.4f},{float(value) * factor:.9f}")
        path.write_text("\n".join(lines))
    found = import_beats(p, q, 6, 1.1)
    assert found.converted == ("flow_ml_s: from L/min",)
    assert found.study.inflow_ml_s == pytest.approx(plain.study.inflow_ml_s, abs=1e-2)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("pressure_mmHg", "p", r"p\.csv: column 'p': no unit: must be one of mmhg"),
        ("0.3050", "0.3000", r"p\.csv, row 3: time_s = '0.3000': not after the row before"),
        ("0.3050", "3:05", r"p\.csv, row 3: time_s = '3:05': write seconds"),
        ("0.3050,", "0.3050,x", r"p\.csv, row 3: pressure_mmHg = 'x.*': not a number"),
    ],
)
def test_what_cannot_be_read(tmp_path: Path, old: str, new: str, told: str) -> None:
    p, q = records(tmp_path)
    p.write_text(p.read_text().replace(old, new, 1))
    with pytest.raises(ValueError, match=told):
        import_beats(p, q, 6, 1.1)


def test_too_few_beats(tmp_path: Path) -> None:
    t = np.arange(0.3, 3 * PERIOD, STEP)
    p = write(tmp_path / "p.csv", t, pressure(t), "pressure_mmHg")
    q = write(tmp_path / "q.csv", t, flow(t), "flow_ml_s")
    with pytest.raises(ImportedFileError, match=r"whole beats of pressure_mmHg: at least 3"):
        import_beats(p, q, 6, 1.1)


NETWORK = """[blood]
density_g_cm3 = 1.06
viscosity_g_cm_s = 0.04
[[vessel]]
id = 1
name = "aorta"
length_cm = 6.0
radius_cm = 1.1
windkessel = "nominal"
"""


def study_of_beats(folder: Path, values: np.ndarray, step: float = 0.02, extra: str = "") -> Path:
    """A study whose pressure goes on for as many samples as there are values; an empty one is missing."""
    folder.mkdir()
    (folder / "network.toml").write_text(NETWORK)
    t = np.arange(0, PERIOD, 0.02)
    rows = [f"{s:.2f},{q:.6f}" for s, q in zip(t, flow(t), strict=True)]
    (folder / "inflow.csv").write_text("\n".join(["time_s,flow_ml_s", *rows]) + "\n")
    rows = [f"1,0,pressure_mmHg,{i * step:.6f},{'' if np.isnan(v) else v}" for i, v in enumerate(values)]
    (folder / "observations.csv").write_text("\n".join(["vessel,position,quantity,time_s,value", *rows]))
    (folder / "study.toml").write_text(
        'name = "s"\nnetwork = "network.toml"\ninflow = "inflow.csv"\nobservations = "observations.csv"\n'
        f'period_s = {PERIOD}\nconventions = "printed"\n{extra}'
    )
    return folder


def noisy(n: int, step: float = 0.02) -> np.ndarray:
    return pressure(np.arange(n) * step) + np.random.default_rng(3).normal(0, 0.4, n)


@pytest.mark.parametrize("uneven", [False, True])
def test_the_refusal_of_several_beats_names_the_command_that_averages_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, uneven: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    values = noisy(160)
    if uneven:
        values[45] = np.nan  # of the second beat, which is averaged by what lies around
    folder = study_of_beats(tmp_path / "of beats", values)
    if uneven:
        rows = (folder / "observations.csv").read_text().splitlines()
        (folder / "observations.csv").write_text("\n".join(rows[:46] + rows[47:]))
    with pytest.raises(StudyError) as refused:
        load_study(folder)
    line = re.search(r"`zoo (import-beats .*?) -o NEW`", str(refused.value))
    assert line is not None
    done = CliRunner().invoke(app, [*shlex.split(line[1]), "-o", "new"])
    assert done.exit_code == 0, done.output
    found, beats = load_study("new"), values.reshape(4, 40)
    (label,) = found.noise_sd
    assert label == "v1@0 pressure_mmHg"
    if uneven:
        assert found.series[0].value[6:] == pytest.approx(beats.mean(axis=0)[6:])
        return
    assert found.time_s == pytest.approx(np.arange(40) * 0.02)
    assert found.series[0].value == pytest.approx(beats.mean(axis=0), rel=1e-12)
    assert found.noise_sd[label] == pytest.approx(np.sqrt(np.var(beats, axis=0, ddof=1).mean()), rel=1e-9)
    assert found.inflow_ml_s == pytest.approx(flow(found.inflow_time_s), abs=1e-6)
    (folder / "observations.csv").write_text((tmp_path / "new" / "observations.csv").read_text())
    assert found.vessels == load_study(folder).vessels


def test_beats_with_gaps_are_left_out_and_the_noise_of_the_study_stays(tmp_path: Path) -> None:
    values = noisy(200)
    values[50:60] = np.nan
    folder = study_of_beats(tmp_path / "s", values, extra="[noise_sd]\npressure_mmHg = 2.0\n")
    found = average_beats(folder)
    kept = np.delete(values.reshape(5, 40), 1, axis=0)
    assert found.study.series[0].value == pytest.approx(kept.mean(axis=0), rel=1e-9)
    assert found.beats["v1@0 pressure_mmHg"] == pytest.approx(kept, rel=1e-9)
    assert found.left_out == ("v1@0 pressure_mmHg: 1 beats of 5, not measured throughout",)
    assert found.study.noise_sd == {"pressure_mmHg": 2.0}
    assert any("noise_sd stays 2" in line for line in found.read)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        (noisy(80), "2 whole beats of period_s = 0.8: at least 3"),
        (noisy(40), "no series is longer than period_s = 0.8"),
        (np.tile(noisy(40), 3), "all beats are the same"),
    ],
)
def test_what_cannot_be_averaged(tmp_path: Path, values: np.ndarray, told: str) -> None:
    with pytest.raises(ImportedFileError, match=told):
        average_beats(study_of_beats(tmp_path / "s", values))


def test_options_that_the_study_has_itself(tmp_path: Path) -> None:
    folder = study_of_beats(tmp_path / "s", noisy(160))
    done = CliRunner().invoke(app, ["import-beats", str(folder), "--length", "3", "-o", str(tmp_path / "n")])
    assert done.exit_code == 2
    assert not (tmp_path / "n").exists()
