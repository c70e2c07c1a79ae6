"""What commands say of a study whose quantities are in other units than the format's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from commands import run

from zoo.blood.study import Study, load_study, save_study
from zoo.report.chapters import write_report

SOLVE = "--stiffness", "5e4", "--times", "16"


@pytest.fixture(scope="module")
def kpa(tmp_path_factory: pytest.TempPathFactory) -> Study:
    study = load_study("demo")
    folder = tmp_path_factory.mktemp("units") / "kpa"
    series = tuple(replace(s, value=s.value * 0.1333224) for s in study.series)
    save_study(replace(study, name="kpa", series=series), folder)
    return replace(study, series=series, source=folder)


@pytest.mark.filterwarnings("always:.*kPa would fit")  # an error would end the command
def test_a_command_says_it_once(kpa: Study) -> None:
    lines = run("simulate", kpa.source, *SOLVE, "--set", "conventions.friction=rest").splitlines()
    (warning,) = [line for line in lines if line.startswith("warning: ")]
    assert "kPa would fit" in warning
    assert "multiply by 7.50062" in warning
    assert "warning" not in run("simulate", "demo", *SOLVE)


def test_the_page_says_it(kpa: Study, tmp_path: Path) -> None:
    for study, said in ((kpa, 1), (load_study("demo"), 0)):
        page = write_report(tmp_path / "page.html", study, {}, {}).read_text()
        assert page.count("kPa would fit") == said
