"""What a user sees of a diagnosis: commands, figures, page, file and its documentation."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.patches import Rectangle
from pydantic import BaseModel
from rich.console import Console
from typer.testing import CliRunner

import zoo
from test_report import Element, read, table_of
from zoo import cli, plots, report
from zoo.blood.effects import CATALOGUE, FAMILIES, Place, get_base, get_effect, simulate
from zoo.blood.study import Blood, Series, Study, Vessel, Windkessel, load_study, save_study
from zoo.cli import app
from zoo.core.diagnosis import diagnosis, discrepancy, screening
from zoo.core.diagnosis.diagnosis import (
    Diagnosis,
    DiagnosisError,
    DiagnosisFile,
    PlaceShare,
    diagnose,
    read_diagnosis,
)
from zoo.paper.synthetic import ejection
from zoo.plots import diagnosis as figures
from zoo.plots import tree

pytestmark = pytest.mark.filterwarnings("ignore:PyTensor could not link to a BLAS:UserWarning")

DOC = Path(__file__).resolve().parents[1] / "docs" / "diagnosis.md"
TAU_S = 0.004
NOISE = {"pressure_mmHg": 0.05, "flow_ml_s": 0.003}
TRIED = ("viscoelastic-wall", "inflow-shift", "vessel-radius")
FILES = ["diagnosis.json", "report.html", "gap.png", "hypotheses.png", "where.png", "diagnosis.png"]


def made(*series: tuple[int, float, str]) -> Study:
    """A tree of five vessels whose wall is viscoelastic, with white noise."""
    flow_time, flow = ejection(256)
    ends = [Windkessel(6e4, 1.8e5, 8e-7), Windkessel(7e4, 2e5, 7e-7), Windkessel(4e4, 1.1e5, 1.2e-6)]
    vessels = (
        Vessel(1, "trunk", 0.4, 0.047, 0.047, None, None),
        Vessel(2, "left", 0.35, 0.035, 0.035, 1, None),
        Vessel(3, "right", 0.3, 0.035, 0.03, 1, ends[2]),
        Vessel(4, "upper", 0.2, 0.025, 0.025, 2, ends[0]),
        Vessel(5, "lower", 0.25, 0.022, 0.022, 2, ends[1]),
    )
    times = np.arange(64) * 0.11 / 64
    study = Study("soft", 0.11, Blood(1.055, 0.049), vessels, flow_time, flow, times, ())
    base = get_base("linear-constant")
    case = get_effect("viscoelastic-wall").apply(base.case(study, base.start), (TAU_S,), Place())
    waves, reason = simulate(case, series, times)
    assert reason is None
    rng = np.random.default_rng(3)
    noisy = [w + NOISE[s[2]] * rng.standard_normal(64) for s, w in zip(series, waves, strict=True)]
    return replace(study, series=tuple(Series(*s, w) for s, w in zip(series, noisy, strict=True)))


def run(*arguments: object, code: int = 0) -> str:
    """Output of a command that must end with `code`; all streams together, lines unwrapped."""
    result = CliRunner(env={"COLUMNS": "200"}).invoke(app, [str(a) for a in arguments])
    assert result.exit_code == code, result.output
    return result.output


def fails(*arguments: object) -> str:
    """The one line that a refused command prints."""
    output = run(*arguments, code=2).strip()
    assert output.count("\n") == 0
    assert output.startswith("error: ")
    return output


@pytest.fixture(scope="module")
def three() -> Diagnosis:
    """Two pressures and a flow."""
    study = made((1, 0.0, "pressure_mmHg"), (4, 0.5, "pressure_mmHg"), (3, 0.5, "flow_ml_s"))
    return diagnose(study, effects=TRIED)


@pytest.fixture(scope="module")
def one() -> Diagnosis:
    """One pressure."""
    return diagnose(made((1, 0.0, "pressure_mmHg")), effects=TRIED[:2], max_effects=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("studies") / "soft"
    save_study(made((1, 0.0, "pressure_mmHg")), path)
    return path


@pytest.fixture(scope="module")
def commanded(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Folder and screen of `zoo diagnose`."""
    out = tmp_path_factory.mktemp("out") / "gap"
    options = ("--effects", "viscoelastic-wall,inflow-shift", "--max-effects", 1, "--base", "a", "-q")
    return out, run("diagnose", folder, *options, "--no-confirm", "--friction", "current", "-o", out)


CONFIRMATION = {
    name: {
        "converged": name == "no-gap",
        "verdict": "not converged: R-hat of tau is 1.2",
        "log_marginal_likelihood": value,
        "log_marginal_likelihood_se": 0.1,
        "elpd_waic": value + 5,
        "elpd_waic_difference": 0.0 if value > 0 else 160.0,
        "elpd_waic_difference_se": None,
        "elpd_loo": None,
        "parameters": {"f3": {"mean": 4.3e4, "sd": 300.0}},
    }
    for name, value in (("no-gap", -100.0), ("viscoelastic-wall", 60.0))
}


def with_confirmation(d: Diagnosis) -> Diagnosis:
    """As if the leading explanations had been sampled."""
    return replace(d, file=d.file.model_copy(update={"confirmation": CONFIRMATION}))


def screen_of(file: DiagnosisFile) -> str:
    """What `zoo diagnose` says of a diagnosis."""
    console = Console(width=200)
    with console.capture() as captured:
        for line in cli.diagnose.diagnosis_screen(file):
            console.print(line)
    return captured.get()


# the file


def test_the_file_comes_back_as_it_was(three: Diagnosis, one: Diagnosis, tmp_path: Path) -> None:
    for d in (three, one, with_confirmation(one)):
        path = d.save(tmp_path / "x")
        assert path == tmp_path / "x" / "diagnosis.json"
        for again in (read_diagnosis(path), zoo.read_diagnosis(path.parent)):
            assert json.loads(again.model_dump_json()) == json.loads(path.read_text("utf-8"))
            assert again.hypotheses == d.file.hypotheses
            assert again.gap == d.file.gap


def test_a_file_that_does_not_fit_is_refused(one: Diagnosis, tmp_path: Path) -> None:
    path = one.save(tmp_path)
    content = json.loads(path.read_text("utf-8"))
    with pytest.raises(DiagnosisError, match="cannot be read"):
        read_diagnosis(tmp_path / "no.json")
    for change, field in (({"format": 2}, "format"), ({"gapp": 1}, "gapp"), ({"verdict": None}, "verdict")):
        path.write_text(json.dumps(content | change), "utf-8")
        with pytest.raises(DiagnosisError, match=f"{field}: .*make it again") as error:
            read_diagnosis(path)
        assert "\n" not in str(error.value)
    path.write_text("{", "utf-8")
    with pytest.raises(DiagnosisError, match="make it again"):
        read_diagnosis(path)


def fields(model: type[BaseModel]) -> set[str]:
    """Names of a model's fields and of those inside it."""
    found = set()
    for name, field in model.model_fields.items():
        found.add(name)
        kinds = [field.annotation]
        while kinds:
            kind = kinds.pop()
            kinds += get_args(kind)
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                found |= fields(kind)
    return found


@pytest.fixture
def sampled(one: Diagnosis, monkeypatch: pytest.MonkeyPatch) -> Diagnosis:
    """What `confirmed` makes of a diagnosis when the posteriors cost no time."""

    def confirm(*_: object, **__: object) -> SimpleNamespace:
        return SimpleNamespace(summary=lambda: CONFIRMATION)

    monkeypatch.setattr("zoo.core.diagnosis.confirm.confirm", confirm)
    return one.confirmed()


def test_readers_read_the_times_that_are_written(one: Diagnosis, sampled: Diagnosis, tmp_path: Path) -> None:
    before, after = one.file.record, sampled.file.record
    [written] = set(after) - set(before)
    screening = before["screening_seconds"]
    assert report.total_seconds(before) == screening
    assert report.total_seconds(after) == screening + after[written] > screening
    slow = after | {written: 1000.0}
    older = before | {"confirmation_seconds": 1000.0}
    for record in (slow, older):
        d = replace(sampled, file=sampled.file.model_copy(update={"record": record}))
        assert report.total_seconds(record) == screening + 1000
        assert screen_of(d.file).strip().endswith(f", {screening + 1000:.0f} s in all")
        report.write_diagnosis(d, tmp_path / "x")
        [facts] = read(tmp_path / "x" / "report.html").of_class("facts")
        shown = dict(zip(*([e.text for e in facts.all(tag)] for tag in ("dt", "dd")), strict=True))
        assert shown["screening seconds"] == f"{screening:.1f}"
        assert shown["posterior seconds"] == "1000.0"
        assert shown["total seconds"] == f"{screening + 1000:.1f}"


def test_the_document_has_every_field_and_constant(one: Diagnosis, sampled: Diagnosis) -> None:
    text = DOC.read_text("utf-8")
    words = set(re.findall(r"`([\w.]+)`", text))
    assert fields(DiagnosisFile) - {"low", "high", "mean"} <= words
    assert set(sampled.file.record) | set(CONFIRMATION["no-gap"]) <= words
    rows = dict(re.findall(r"^\| `([A-Z_]+)` \| ([\d., ]+) \|", text, flags=re.M))
    assert len(rows) > 10
    for name, value in rows.items():
        [home] = [m for m in (screening, discrepancy, diagnosis) if name in ast_names(m)]
        expected = np.atleast_1d(getattr(home, name))
        assert [float(x) for x in value.split(",")] == pytest.approx(list(expected)), name


def ast_names(module: object) -> set[str]:
    """Constants that a module defines itself."""
    text = Path(str(getattr(module, "__file__", ""))).read_text("utf-8")
    heads = re.findall(r"^([A-Z_]+(?:, [A-Z_]+)*) = ", text, flags=re.M)
    return {name for head in heads for name in head.split(", ")}


# figures


def words_of(figure: mpl.figure.Figure) -> str:
    figure.canvas.draw()
    return " ".join(t.get_text() for t in figure.findobj(mpl.text.Text))


@pytest.mark.parametrize("name", ["plot_gap", "plot_hypotheses", "plot_where", "plot_diagnosis"])
@pytest.mark.parametrize("case", ["one", "three"])
def test_every_figure_draws(name: str, case: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    figure = getattr(plots, name)(request.getfixturevalue(case))
    path = plots.save_figure(figure, tmp_path / "x.png")
    assert path.stat().st_size > 10_000
    import matplotlib.pyplot as plt

    assert plt.get_fignums() == []


def test_the_gap_figure_carries_the_numbers(three: Diagnosis) -> None:
    figure = plots.plot_gap(three)
    found = words_of(figure)
    for series, row in zip(three.study.series, three.file.gap.per_series, strict=True):
        label = series.label.rsplit(" ", 1)[0]
        assert f"{label}: gap {row.before.mean:.2g} to {row.after.mean:.2g} {row.unit}" in found
    assert {"pressure (mmHg)", "flow (ml/s)", "gap (ml/s)", *diagnosis.PHASES} <= {
        t.get_text() for t in figure.findobj(mpl.text.Text)
    }
    top, bottom = figure.axes[0], figure.axes[3]
    lines = {line.get_label(): line.get_ydata() for line in top.get_lines()}
    np.testing.assert_array_equal(lines["measured"], three.study.values[0])
    np.testing.assert_allclose(lines["base"], three.computed[0][0], atol=1e-9)
    np.testing.assert_allclose(
        lines["base + viscoelastic-wall"], three.study.values[0] - three.after.residual[0]
    )
    left = {line.get_label(): line.get_ydata() for line in bottom.get_lines()}
    np.testing.assert_array_equal(left["discrepancy of base, 95 %"], three.before.mean[0])
    [band] = [c for c in bottom.collections if np.isclose(c.get_paths()[0].vertices[:, 1].max(),
              np.max(three.before.mean[0] + 1.96 * three.before.sd[0]))]  # fmt: skip
    assert band is not None
    [strip] = [p for p in bottom.patches if isinstance(p, Rectangle) and p.get_label() == "noise (sd)"]
    assert strip.get_height() == pytest.approx(2 * three.file.gap.per_series[0].noise_floor)


def test_phases_are_shaded_where_they_are(one: Diagnosis) -> None:
    phase = diagnosis.phases(one.study.values[0], one.study.period_s)
    spans = figures._spans(phase)
    assert sum(last - first for first, last, _ in spans) == len(phase)
    for first, last, k in spans:
        assert set(phase[first:last]) == {k}
    shaded = [p for p in plots.plot_gap(one).axes[0].patches if isinstance(p, Rectangle)]
    step = 110 / 64
    expected = [(first * step, (last - first) * step) for first, last, k in spans if k % 2]
    np.testing.assert_allclose([(p.get_x(), p.get_width()) for p in shaded], expected)


def test_hypotheses_are_ordered_coloured_and_marked(three: Diagnosis) -> None:
    hypotheses = list(three.file.hypotheses)
    # as if the second could not be told from the first, and the last could not be seen
    hypotheses[1] = hypotheses[1].model_copy(update={"group": hypotheses[0].group})
    hidden = hypotheses[-1].name
    d = replace(three, file=three.file.model_copy(update={"hypotheses": hypotheses, "invisible": [hidden]}))
    figure = plots.plot_hypotheses(d)
    [axes] = figure.axes
    bars = {c.get_label(): c[0] for c in axes.containers}
    zero = next(h.log_evidence for h in hypotheses if h.name == "no-gap")
    for row, h in enumerate(hypotheses):
        bar = bars[h.name]
        assert bar.get_width() == pytest.approx(h.log_evidence - zero)
        assert bar.get_y() + bar.get_height() / 2 == pytest.approx(row)
        assert bool(bar.get_hatch()) == (h.name in ("no-gap", "unlisted", "correlated-noise"))
    first, second, last = (bars[hypotheses[i].name].get_facecolor() for i in (0, 1, -1))
    assert first == second != last
    assert last == mpl.colors.to_rgba("white")
    found = words_of(figure)
    assert "invisible here" in found
    assert "not told apart" in found
    assert f"gap {hypotheses[0].gap_after_mmHg:.2g} mmHg" in found


def test_the_tree_is_coloured_by_the_probability_of_the_place(three: Diagnosis) -> None:
    shares = [
        PlaceShare(vessel=2, subtree=True, probability=0.5),
        PlaceShare(vessel=None, subtree=False, probability=0.3),
        PlaceShare(vessel=4, subtree=False, probability=0.2),
    ]
    where = three.file.where.model_copy(update={"place": shares})
    figure = plots.plot_where(replace(three, file=three.file.model_copy(update={"where": where})))
    lines = {
        int(line.get_gid().removeprefix("vessel-")): line
        for line in figure.findobj(mpl.lines.Line2D)
        if line.get_gid()
    }
    colours = mpl.colors.LinearSegmentedColormap.from_list("places", tree.LOCATION_COLOURS)
    for vessel, p in {1: 0.0, 2: 0.5, 3: 0.0, 4: 0.7, 5: 0.5}.items():
        assert lines[vessel].get_color() == pytest.approx(colours(p))
    assert lines[1].get_linewidth() > lines[5].get_linewidth()
    for vessel in three.study.vessels:
        if vessel.parent is not None:
            start, end = lines[vessel.id].get_xydata()[0], lines[vessel.parent].get_xydata()[1]
            np.testing.assert_array_equal(start, end)
    found = words_of(figure)
    assert "everywhere alike: 30 %" in found
    assert "vessel 2 and below: 50 %" in found


def test_a_tree_listed_daughters_first_is_laid_out_too(three: Diagnosis) -> None:
    assert tree.tree_layout(three.study.vessels[::-1]).keys() == tree.tree_layout(three.study.vessels).keys()
    ends = [place[3] for v, place in tree.tree_layout(three.study.vessels).items() if v in (3, 4, 5)]
    assert sorted(ends) == [-2.0, -1.0, 0.0]


# the page


@pytest.fixture(scope="module")
def page(three: Diagnosis, tmp_path_factory: pytest.TempPathFactory) -> Element:
    out = tmp_path_factory.mktemp("page") / "gap"
    written = report.write_diagnosis(with_confirmation(three), out, command="zoo diagnose <x>")
    assert [p.name for p in written] == FILES
    assert all(p.is_file() for p in written)
    return read(out / "report.html")


def test_the_page_is_whole_and_loads_nothing(page: Element) -> None:
    assert [i.attributes["src"].startswith("data:image/png;base64,") for i in page.all("img")] == [True] * 3
    assert page.all("script") == []
    assert "url(" not in page.all("style")[0].text
    assert ".summary" in page.all("style")[0].text
    for table in page.all("table"):
        assert table.all("caption")[0].text
        width = len(table.all("thead")[0].all("th"))
        assert {len(row.all("td") + row.all("th")) for row in table.all("tbody")[0].all("tr")} == {width}
    inner = {a.attributes["href"][1:] for a in page.all("a")}
    assert inner == {h.attributes["id"] for h in page.all("h2")}


def test_the_page_has_the_numbers(page: Element, three: Diagnosis) -> None:
    file = three.file
    text = page.text
    assert file.verdict in text
    for words in ("zoo diagnose <x>", file.study_checksum, *(f"{x} " for x in file.record["versions"])):
        assert words in text
    rows = table_of(page, "Gap in each observed series")
    assert [row[:2] for row in rows] == [[s.series, s.unit] for s in file.gap.per_series]
    assert rows[0][2].startswith(f"{file.gap.per_series[0].before.mean:.2g} (")
    rows = table_of(page, "Explanations")
    assert [row[0] for row in rows] == [h.name for h in file.hypotheses]
    assert "Kelvin-Voigt" in rows[0][-1]
    tau = file.hypotheses[0].amplitude
    assert tau is not None
    assert f"tau {tau.mean:.3g} ± {tau.sd:.2g} s" in rows[0]
    rows = table_of(page, "Parameters of the base")
    assert [row[0] for row in rows] == ["f3", "psi1", "psi2", "c"]
    shift = file.base_parameters["with cause"]["c"] - file.base_parameters["base"]["c"]
    assert float(rows[3][5]) == pytest.approx(shift, rel=0.01)
    assert [row[0] for row in table_of(page, "After each")] == [step.name for step in file.steps]
    [failed] = page.of_class("failed")
    assert failed.text == "viscoelastic-wall: not converged: R-hat of tau is 1.2"
    rows = table_of(page, "The base and the leading explanations sampled")
    assert [row[0] for row in rows] == ["viscoelastic-wall", "no-gap"]
    assert rows[0][1:] == ["no", "60.0 ± 0.1", "65.0", "0.0", "–", "f3 4.3e+04 ± 3e+02"]


def test_groups_are_explained(three: Diagnosis, tmp_path: Path) -> None:
    hypotheses = [h.model_copy(update={"group": 0}) for h in three.file.hypotheses[:2]]
    hypotheses += three.file.hypotheses[2:]
    file = three.file.model_copy(update={"hypotheses": hypotheses, "invisible": ["inflow-shift"]})
    report.write_diagnosis(replace(three, file=file), tmp_path / "x")
    text = read(tmp_path / "x" / "report.html").text
    assert f"Group 0: {hypotheses[0].name} and {hypotheses[1].name} explain these data alike" in text
    assert "inflow-shift: the base's parameters absorb what these do" in text


def test_a_page_needs_a_folder(one: Diagnosis, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(report.ReportError, match="is a file; choose a folder"):
        report.write_diagnosis(one, tmp_path / "file")
    with pytest.raises(report.ReportError, match="does not exist; create it"):
        report.write_diagnosis(one, tmp_path / "no" / "gap")


# zoo diagnose


def test_diagnose_writes_everything_and_says_what_it_found(commanded: tuple[Path, str]) -> None:
    out, screen = commanded
    assert sorted(p.name for p in out.iterdir()) == sorted(FILES)
    file = read_diagnosis(out)
    assert file.base == "linear-constant"
    assert file.verdict.startswith("viscoelastic-wall")
    amplitude = file.hypotheses[0].amplitude
    assert amplitude is not None
    assert abs(amplitude.mean - TAU_S) < 4 * amplitude.sd
    assert file.verdict in screen
    for words in ("upstroke", "harmonic", "v1@0 pressure_mmHg", "everywhere", "█", "no-gap", "unlisted"):
        assert words in screen
    assert f"{amplitude.mean:.3g} ± {amplitude.sd:.2g} s" in screen
    assert f"{file.gap.removed:.0%}".replace("%", " %") in screen
    assert f"{file.record['solves']} solves" in screen
    assert f"wrote {out}: {', '.join(FILES)}" in screen
    assert "error" not in screen
    command = read(out / "report.html").all("pre")[0].text
    assert "--base linear-constant" in command
    assert "--no-confirm --max-effects 1 --effects viscoelastic-wall,inflow-shift" in command
    assert "--friction current" in command


def test_the_screen_tells_of_groups_rivals_and_posteriors(three: Diagnosis) -> None:
    measure = diagnosis.NextMeasurement(
        vessel=5,
        position=0.5,
        quantity="flow_ml_s",
        separates=("taper", "minor-losses"),
        expected_log_odds=7.25,
    )
    change = {"next_measurement": measure, "invisible": ["inflow-gain"], "failed": ["stenosis"]}
    file = with_confirmation(three).file.model_copy(update=change)
    screen = screen_of(file)
    assert "flow_ml_s in vessel 5 at 0.5, which tells taper from minor-losses" in screen
    assert "7.2" in screen
    assert "this study cannot show: inflow-gain" in screen
    assert "The solver failed wherever these were tried: stenosis." in screen
    assert "posterior of viscoelastic-wall: log marginal likelihood 60.0 ± 0.1" in screen
    assert "not converged, see report.html" in screen


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--base", "linear-constnt"), "base 'linear-constnt': unknown; did you mean 'linear-constant'?"),
        (("--base", "G"), "use linear-constant"),
        (("--effects", "taper,viscoelastic-wal"), "did you mean 'viscoelastic-wall'?"),
        (("--effects", " , "), "--effects: no names"),
        (("--base", "H", "--effects", "tangent-wall"), "cannot be added to tangent-constant, only to linear"),
        (("--max-effects", 0), "--max-effects 0: give at least 1"),
        (("--cores", 0), "--cores 0: give at least 1"),
        (("--seed", -1), "--seed -1: give at least 0"),
        (("--conventions", "printd"), "did you mean 'printed'?"),
        (("-o", "nowhere/gap"), "does not exist; create it"),
        (("-o", "file"), "--output file: is a file; give a folder"),
    ],
)
def test_diagnose_says_what_to_change_before_it_works(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[object, ...], message: str
) -> None:
    def worked(*_: object, **__: object) -> None:
        raise AssertionError("it worked")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(diagnosis, "diagnose", worked)
    Path("file").write_text("")
    assert message in fails("diagnose", folder, *options)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_study_without_observations_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    save_study(made(), "bare")
    assert "add observations.csv" in fails("diagnose", "bare")
    assert [p.name for p in tmp_path.iterdir()] == ["bare"]
    assert "did you mean 'demo'?" in fails("diagnose", "demmo")


def test_options_reach_the_diagnosis(
    one: Diagnosis, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: dict[str, object] = {}

    def caught(study: Study, base: str, **settings: object) -> Diagnosis:
        given.update(settings, study=study, base=base)
        return one

    def sampled(self: Diagnosis, **settings: object) -> Diagnosis:
        given.update(confirm=True, folder=settings["folder"])
        return self

    monkeypatch.setattr(diagnosis, "diagnose", caught)
    monkeypatch.setattr(diagnosis.Diagnosis, "confirmed", sampled)
    monkeypatch.setattr(report, "write_diagnosis", lambda *_, **__: [])
    out = tmp_path / "gap"
    run("diagnose", folder, "-o", out, "-q")
    assert (given["base"], given["confirm"], given["effects"]) == ("linear-constant", True, None)
    assert (given["max_effects"], given["cores"], given["seed"]) == (3, 2, 1)
    assert given["conventions"] is None
    first = Path(str(given["folder"]))
    assert first.is_dir()
    assert first.parent == out / "posteriors"
    assert (out / "diagnosis.json").is_file()  # before the posteriors, which take longer
    given |= {"confirm": False, "folder": None}
    options = ("--base", "I", "--wall-factor", 2, "--effects", "taper", "--seed", 5, "--no-confirm", "-q")
    run("diagnose", folder, "-o", out, *options)
    assert (given["base"], given["confirm"], given["effects"]) == ("tangent-radius", False, ["taper"])
    assert given["folder"] is None
    conventions = given["conventions"]
    assert conventions is not None
    assert conventions.wall_factor == 2  # type: ignore[attr-defined]
    run("diagnose", folder, "-o", out, "--seed", 2, "-q")
    assert Path(str(given["folder"])) != first


def test_progress_says_what_is_tried() -> None:
    for confirm, last in ((True, "posteriors"), (False, "weighing")):
        with cli.diagnose.Telling(False, confirm) as tell:
            found = []
            for text, share in (("base", 0.0), ("taper", 0.4), ("base", 0.0), ("stenosis", 0.5), ("x", 1.0)):
                tell(text, share)
                task = tell.bar.tasks[0]
                found.append((task.description, task.completed))
        assert found[1] == ("taper", 40)
        assert found[3] == ("stenosis (beside 1 added)", 50)
        assert found[4] == (last, 100)


# zoo effects


def test_effects_lists_the_catalogue_by_family() -> None:
    for columns in ("200", "80"):
        result = CliRunner(env={"COLUMNS": columns}).invoke(app, ["effects"])
        assert result.exit_code == 0
        assert max(len(line) for line in result.output.splitlines()) <= int(columns)
        for name in CATALOGUE:
            assert f"  {name} " in result.output
        lines = [line.strip() for line in result.output.splitlines()]
        assert [line for line in lines if line in FAMILIES] == list(FAMILIES)
        assert "tau (s)" in result.output
        assert "normal(0, 0.003) in [0, 0.03]" in result.output
        assert "…" not in result.output


def test_effects_tells_all_about_one() -> None:
    made = get_effect("catheter-resonance")
    found = run("effects", "catheter-resonance")
    for words in (made.statement, made.equation, made.signature, made.source, made.family):
        assert words in found
    for amplitude in made.amplitudes:
        assert (
            f"{amplitude.name} ({amplitude.unit}) ~ normal({amplitude.centre:g}, {amplitude.scale:g})"
            in found
        )
        assert amplitude.why in found
    assert "linear-constant, linear-radius" in run("effects", "tangent-wall")
    assert "did you mean 'stenosis'?" in fails("effects", "stenoses")


def test_effects_as_json() -> None:
    every = json.loads(run("effects", "--json"))
    assert [e["name"] for e in every] == list(CATALOGUE)
    alone = json.loads(run("effects", "stenosis", "--json"))
    assert alone == next(e for e in every if e["name"] == "stenosis")
    assert alone["places"] == "each vessel"
    assert alone["amplitudes"][0]["low"] == 0.0
    assert {e["places"] for e in every} <= set(cli.effects.LOCATION_WORDS.values())


# the whole, once


@pytest.mark.slow
def test_demo_by_its_name(tmp_path: Path) -> None:
    screen = run(
        "diagnose", "demo", "--effects", "sensor-offset", "--no-confirm", "-o", tmp_path / "gap", "-q"
    )
    assert read_diagnosis(tmp_path / "gap").study_checksum == load_study("demo").checksum
    assert "wrote" in screen
