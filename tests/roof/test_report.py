"""The page is read back with Python's own parser and compared with what went in."""

from __future__ import annotations

import base64
import struct
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import arviz as az
import numpy as np
import pandas as pd
import pymc as pm
import pytest
from pages import Element, check_tables, read, table_of
from typer.testing import CliRunner

from gaussian import a_record
from zoo import report
from zoo.blood.fetch import FetchError
from zoo.blood.study import Study, load_study, save_study
from zoo.cli import app
from zoo.core.arviz_lines import InferenceData, of_draws
from zoo.core.inference.convergence import Diagnostics, check_convergence
from zoo.core.inference.record import RunRecord, versions
from zoo.core.outputs import OutputFileError
from zoo.core.posterior.comparison import compare
from zoo.core.posterior.storage import save_posterior, slim_posterior
from zoo.models import get_model
from zoo.report.sentences import summary

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning", "ignore::DeprecationWarning")

Models = dict[str, pm.Model]
Posteriors = dict[str, InferenceData]
CENTRE = {"f3": 5e4, "psi1": 0.3, "psi2": 0.9, "c": 1.2, "sigma2": 0.0025, "w": 5e4, "b": 100.0}


def drawn(model: pm.Model, *, apart: float = 0.0, n: int = 500) -> InferenceData:
    """Independent draws of four chains whose means are `apart` standard deviations from each other."""
    rng = np.random.default_rng(4)
    shift = apart * np.arange(4)[:, None]
    draws = {
        name: CENTRE[name] * np.exp(0.003 * (rng.standard_normal((4, n)) + shift))
        for name in model.zoo.parameters
    }
    accepted = np.linspace(0.2, 0.4, 4)[:, None].repeat(n, 1)
    idata = of_draws({"posterior": draws, "sample_stats": {"accepted": accepted}})
    record = model.zoo
    replace(
        a_record(),
        model=record.name,
        study=record.study.name,
        study_checksum=record.study.checksum,
        conventions={"name": record.study.conventions.name, "wall_factor": 1.0},
        settings={"chains": 4, "draws": n, "tune": 700, "thin": 3, "until_ess": None, "step": "nuts"},
        seed=11,
        solves=8123,
        mode_evaluations=77,
        failures={"not-periodic": 5},
        wall_seconds=90.0,
    ).attach(idata)
    return idata


@pytest.fixture(scope="module")
def models(study: Study) -> Models:
    return {name: get_model(name)(study) for name in ("A", "B")}


@pytest.fixture(scope="module")
def posteriors(models: Models) -> Posteriors:
    return {name: drawn(model) for name, model in models.items()}


@pytest.fixture(scope="module")
def table(models: Models, posteriors: Posteriors) -> pd.DataFrame:
    return compare(posteriors, models, n_draws=40)


@pytest.fixture(scope="module")
def page(
    tmp_path_factory: pytest.TempPathFactory, study: Study, models: Models, posteriors: Posteriors
) -> Element:
    path = tmp_path_factory.mktemp("report") / "r.html"
    chapter = report.Chapter(study.name, posteriors, study, models, note="A note & more.")
    assert report.write_chapters(path, [chapter], n_draws=40, command="zoo report x") == path
    return read(path)


def test_the_ranking_is_that_of_compare(page: Element, study: Study, table: pd.DataFrame) -> None:
    rows = table_of(page, f"Models of {study.name}")
    assert [row[0] for row in rows] == list(table.index)
    for row, (_, expected) in zip(rows, table.iterrows(), strict=True):
        assert row[1:] == [
            f"{expected['waic']:.1f} ± {expected['waic_se']:.1f}",
            f"{expected['difference']:.1f} ± {expected['difference_se']:.1f}",
            f"{expected['weight']:.2f}",
            f"{expected['loo']:.1f} ± {expected['loo_se']:.1f}",
            f"{expected['pareto_k_bad']}",
            f"{expected['waic_one_observation']:.1f}",
            f"{expected['p_waic']:.1f}",
            f"{expected['sse_pressure_mmHg']:.3g} mmHg2",
            expected["standing"],
            "yes",
        ]


def test_posteriors_and_convergence_are_those_of_the_draws(
    page: Element, study: Study, posteriors: Posteriors
) -> None:
    for name, idata in posteriors.items():
        rows = {row[0]: row for row in table_of(page, f"Posterior of model {name} on {study.name}")}
        assert set(rows) == set(idata.posterior.data_vars)
        stats = az.summary(idata, round_to="none")
        for parameter, row in rows.items():
            values = idata.posterior[parameter].to_numpy()
            for cell, q in zip(row[2:5], (0.5, 0.025, 0.975), strict=True):
                assert float(cell) == pytest.approx(np.quantile(values, q), rel=6e-4)
            assert row[5] == f"{stats.loc[parameter, 'r_hat']:.3f}"
            assert row[6] == f"{stats.loc[parameter, 'ess_bulk']:.0f}"
            tail = az.ess(values, method="tail", prob=(0.05, 0.95))  # the summary's quantiles differ by line
            assert row[7] == f"{float(tail):.0f}"
    [first, _] = table_of(page, "Convergence")
    assert first[:3] == ["A", "yes", "4 × 500"]
    assert first[6:] == ["20 to 40", "8200", "5 not-periodic", "1.5"]


def test_figures_are_inside_and_nothing_is_loaded(page: Element) -> None:
    pictures = page.all("img")
    assert len(pictures) == 3 + 2 * 3  # ranking, forest, vessels; fit, ranks and pairs of each model
    for picture in pictures:
        kind, _, data = picture.attributes["src"].partition(",")
        assert kind == "data:image/png;base64"
        width, height = struct.unpack(">II", base64.b64decode(data, validate=True)[16:24])
        assert int(picture.attributes["width"]) / int(picture.attributes["height"]) == pytest.approx(
            width / height, rel=0.01
        )
        assert len(picture.attributes["alt"]) > 30
    assert page.all("script") == []
    for tag, attribute in (("link", "href"), ("img", "src"), ("iframe", "src"), ("source", "src")):
        assert all(e.attributes[attribute].startswith("data:") for e in page.all(tag))
    [style] = page.all("style")
    assert "url(" not in style.text
    assert "@import" not in style.text
    outside = [a.attributes["href"] for a in page.all("a") if not a.attributes["href"].startswith("#")]
    assert outside
    assert all(address.startswith("https://doi.org/10.") for address in outside)


def test_what_is_of_one_model_is_folded_and_the_answer_is_not(page: Element, study: Study) -> None:
    folded = page.all("details")
    assert [fold.all("summary")[0].text for fold in folded] == [
        "Parameters, fit, ranks and pairs of model A",
        "Parameters, fit, ranks and pairs of model B",
        "Settings, versions, commands",
    ]
    assert (
        sum(len(fold.all("img")) for fold in folded) == len(page.all("img")) - 3
    )  # ranking, forest, vessels
    captions = [table.all("caption")[0].text for fold in folded for table in fold.all("table")]
    assert [text.split()[0] for text in captions] == ["Posterior", "Posterior", "Runs"]


def test_links_anchors_and_captions(page: Element) -> None:
    headings = [h for tag in ("h2", "h3") for h in page.all(tag)]
    ids = [h.attributes["id"] for h in headings]
    assert len(set(ids)) == len(ids)
    inner = {a.attributes["href"][1:] for a in page.all("a") if a.attributes["href"].startswith("#")}
    assert inner == set(ids)
    check_tables(page)


def test_the_head_says_what_was_done(page: Element, study: Study) -> None:
    text = page.text
    for words in (
        study.checksum,
        f"{datetime.now(UTC):%B %Y}, ",
        f"zoo {versions()['zoo']}",
        f"pymc {versions()['pymc']}",
        "dx_cm 0.025",
        "A note & more.",
        "zoo report x",
        f"zoo sample A {study.name} --chains 4 --draws 500 --tune 700 --thin 3 --until none --seed 11 -o A",
        "16246 solves of the flow equations; 10 of them failed",
        "Both posteriors converged.",
    ):
        assert words in text


def test_banner_exactly_when_a_verdict_fails(
    tmp_path: Path, page: Element, study: Study, models: Models, posteriors: Posteriors
) -> None:
    assert page.of_class("banner") == []
    assert report.chapters.BANNER not in page.text
    bad = {"A": posteriors["A"], "B": drawn(models["B"], apart=2.0)}
    path = report.write_report(tmp_path / "bad.html", study, bad, models, n_draws=40)
    again = read(path)
    [banner] = again.of_class("banner")
    assert banner.text.startswith(f"{report.chapters.BANNER} Model B:")
    assert [row[:2] for row in table_of(again, "Convergence")] == [["A", "yes"], ["B", "no"]]
    assert "Not converged: B. The largest R-hat is" in again.text
    failed = {name for row in again.of_class("failing") for name in [row.all("th")[0].text]}
    assert failed == set(models["B"].zoo.parameters)


def test_a_name_with_markup_stays_text(tmp_path: Path, posteriors: Posteriors, page: Element) -> None:
    name = "<script>alert('x')</script>&\""
    both = [report.Chapter(name, {"A": posteriors["A"]}, note=name), report.Chapter(name, {})]
    path = report.write_chapters(tmp_path / "x.html", both, title=name, command=name)
    text = path.read_text(encoding="utf-8")
    assert "<script" not in text
    again = read(path)
    assert again.all("h1")[0].text == name
    ids = [h.attributes["id"] for h in again.all("h2")]
    assert ids == ["script-alert-x-script", "script-alert-x-script-2", "reading"]
    assert all(e.attributes["alt"] for e in again.all("img"))


def rows_of(**columns: list[float]) -> pd.DataFrame:
    n = len(columns["waic"])
    given = {"pareto_k_bad": [0] * n, "waic_warning": [False] * n} | columns
    table = pd.DataFrame(given, index=list("HBA")[:n])
    table.attrs["ic"] = "waic"
    return table


def test_summary_tells_a_lead_from_a_tie() -> None:
    rng = np.random.default_rng(0)
    good = Diagnostics(check_convergence({"c": rng.normal(size=(4, 1000))}), ())
    checks = dict.fromkeys("HBA", good)
    table = rows_of(
        waic=[-10.0, -9.0, 90.0], difference=[0.0, 1.0, 100.0], difference_se=[0.0, 2.0, 5.0],
        pareto_k_bad=[0, 3, 0],
    )  # fmt: skip
    lines = summary(table, checks, {})
    assert lines[0] == "All 3 posteriors converged."
    assert lines[1] == "Model H predicts the observations best of 3 models by WAIC: -10.0 (lower is better)."
    assert lines[2].startswith("B is within the standard error of the difference (B by 1.0 ± 2.0)")
    assert lines[3] == "Behind by more than the standard error of the difference: A by 100.0 ± 5.0."
    assert lines[4].endswith("(large Pareto k): B 3.")
    alone = summary(rows_of(waic=[3.0], difference=[0.0], difference_se=[0.0]), {"H": good}, {})
    assert alone[:2] == [
        "The posterior of model H converged.",
        "Model H has WAIC 3.0, with nothing to compare it to.",
    ]
    bad = Diagnostics(check_convergence({"c": rng.normal(size=(4, 50))}), ())
    lines = summary(table, checks | {"B": bad}, {})
    assert lines[0].startswith("Not converged: B.")
    assert lines[1].startswith("Model H predicts")  # which did converge
    lines = summary(table, checks | {"H": bad}, {})
    assert lines[1].startswith("For what such draws are worth, model H predicts")


def test_faults_are_one_line(tmp_path: Path, study: Study, posteriors: Posteriors, models: Models) -> None:
    with pytest.raises(OutputFileError, match="does not exist; create it"):
        report.write_report(tmp_path / "no" / "r.html", study, posteriors, models)
    with pytest.raises(report.ReportError, match="posterior 'B' has no model"):
        report.write_report(tmp_path / "r.html", study, posteriors, {"A": models["A"]})
    with pytest.raises(report.ReportError, match="no chapters"):
        report.write_chapters(tmp_path / "r.html", [])
    with pytest.raises(report.ReportError, match=r"no posterior of demo in .*zoo sample A demo -o A.nc"):
        report.gather(["demo"], [tmp_path])


@pytest.fixture
def without_data(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Study]:
    """mouse-c6 cannot be loaded."""

    def load(name: str, **settings: Any) -> Study:
        if name == "mouse-c6":
            raise FetchError("mouse-c6/pC6_1024.dat: cannot be had; set ZOO_DATA_DIR")
        return load_study(name, **settings)

    monkeypatch.setattr("zoo.blood.study.load_study", load)
    return load


@pytest.mark.usefixtures("without_data")
def test_without_data_the_posteriors_are_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, posteriors: Posteriors, study: Study
) -> None:
    save_study(study, tmp_path / "own")
    for name, idata in posteriors.items():
        save_posterior(slim_posterior(idata, 100), tmp_path / f"{name}.nc")
    away = slim_posterior(posteriors["A"], 100)
    replace(RunRecord.of(away), study="mouse-c6", study_checksum="abc").attach(away)
    save_posterior(away, tmp_path / "mouse.nc")
    (tmp_path / "other.nc").write_text("not a posterior")
    target = tmp_path / "r.html"
    words = ["report", str(tmp_path / "own"), "mouse-c6", "--posteriors", str(tmp_path), "-o", str(target)]
    words += ["--n-draws", "20", "--quiet", "--models", "A"]
    monkeypatch.delenv("CI", raising=False)
    result = CliRunner(env={"COLUMNS": "200"}).invoke(app, words)
    assert result.exit_code == 0, result.output
    page = read(target)
    assert [h.text.removesuffix(" #") for h in page.all("h2")] == [
        study.name,
        "mouse-c6",
        "How to read this page",
    ]
    [own, mouse, _] = page.all("section")
    assert len(own.all("img")) == 5
    assert len(mouse.all("img")) == 3  # no fit, no vessels
    assert "The measured data are not here" in mouse.text
    assert "zoo fetch mouse-c6" in mouse.text
    assert [row[2] for row in table_of(mouse, "Convergence")] == ["4 × 500"]  # of the whole run
    monkeypatch.setenv("CI", "true")
    result = CliRunner(env={"COLUMNS": "200"}).invoke(app, words)
    assert result.exit_code == 2
    *passed_over, error = result.output.strip().splitlines()
    (unreadable,) = [line for line in passed_over if "other.nc" in line]
    assert "not a readable NetCDF file" in unreadable
    assert all(line.startswith("passed over: ") for line in passed_over), [x[-150:] for x in passed_over]
    assert error == "error: mouse-c6/pC6_1024.dat: cannot be had; set ZOO_DATA_DIR"


def test_commands_keep_the_target() -> None:
    record = RunRecord(
        "H", "demo", "", {}, {},
        {"until_ess": 400.0, "draws": 2000, "first check": 500, "tune": 9, "chains": 4},
        3, 1, 1, 1, {}, 1.0, 1.0, 1.0, 1, "",
    )  # fmt: skip
    expected = "zoo sample H demo --chains 4 --draws 500 --tune 9 --until ess=400 --seed 3 -o H.nc"
    assert report.chapter.sampling_command(record) == expected
