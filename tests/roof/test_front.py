"""What `zoo.diagnose` gives can draw itself, and nothing below the figures knows them."""

from __future__ import annotations

import subprocess
import sys

import pytest
from matplotlib.figure import Figure

import zoo
from zoo import front
from zoo.core.data import Data
from zoo.core.diagnosis import Diagnosis, DiagnosisError


def test_a_diagnosis_draws_itself(one: Diagnosis, sampled: Diagnosis) -> None:
    assert zoo.diagnose is front.diagnose
    for d in (one, sampled):
        figure = d.plot()
        assert isinstance(figure, Figure)
        figure.canvas.draw()
        assert any(
            d.file.verdict[:30] in t.get_text() for t in figure.findobj(lambda a: hasattr(a, "get_text"))
        )


def test_the_front_takes_studies_and_other_data(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zoo.blood.diagnosis.diagnose", lambda *given, base: ("study", given, base))
    monkeypatch.setattr(front.diagnosis, "diagnose", lambda *given, seed: ("data", given, seed))
    study = zoo.load_study("demo")
    assert front.diagnose(study, base="B") == ("study", (study,), "B")
    data = Data(study.time_s, study.values)
    assert front.diagnose(data, "model", [], seed=3) == ("data", (data, "model", []), 3)
    for other in (study.values, "demo"):
        with pytest.raises(DiagnosisError, match=r"give a study, such as .*, or a zoo\.core\.data\.Data"):
            front.diagnose(other, "model", [])  # type: ignore[arg-type]


def test_figures_are_loaded_when_something_is_drawn() -> None:
    code = (
        "import sys, zoo; zoo.diagnose; print([m for m in ('matplotlib', 'zoo.plots') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_core_alone_says_what_draws() -> None:
    code = (
        "from zoo.core.diagnosis.diagnosis import Diagnosis\n"
        "try:\n    Diagnosis(*[None] * 6).plot()\nexcept ValueError as error:\n    print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "zoo.plots.plot_diagnosis(d)" in done.stdout
