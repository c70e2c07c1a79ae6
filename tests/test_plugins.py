"""Effects and models of a user's own: from a file, from a script, in other processes, at the command line."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from test_op import small_study
from zoo.blood.plugins import add_effects, get_model, known_name, load_models, split_name
from zoo.blood.study import save_study
from zoo.cli import app
from zoo.core.effects import EffectError
from zoo.core.inference.record import RunRecord
from zoo.core.inference.sampling import sample

EFFECT = """
from dataclasses import replace
import numpy as np
import zoo

GAIN = 0.5

@zoo.effect("damped", "inflow", parameters=[zoo.EffectParameter("share", "1", 0.1, 0.0, 0.9, (0.1,))])
def damped(case, values, location):
    "The inflow is drawn to its mean."
    flow = case.inflow_ml_s
    return replace(case, inflow_ml_s=flow + GAIN * values[0] * (np.mean(flow) - flow))
"""
MODEL = """
from zoo.blood.baseline import Baseline, study_model
from zoo.core.errors.independent import Independent
from zoo.core.parameters import InverseGamma, LogUniform, Parameter, Uniform

def by_area(values, network, conventions):
    return values["k"] / network.radius_in_cm**2

BASELINE = Baseline(
    "by-area", "linear", by_area,
    (Parameter("k", LogUniform(10, 1000), "g s-2 cm", start=100.0), Parameter("c", Uniform(0.5, 2.5))),
    fixed={"psi1": 0.3, "psi2": 0.9},
)

model_area = study_model("area", BASELINE, Independent(InverseGamma(2, 0.1)))
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(EFFECT + MODEL)
    return path


def test_names_of_models_hold_their_effects(file: Path) -> None:
    assert split_name("g+local-stiffness@8++taper") == ["G", "local-stiffness@8+", "taper"]
    assert split_name("Area") == ["Area"]
    study = small_study()
    for name in ("B", "G+viscoelastic-wall", "C+local-stiffness@2+taper"):
        assert get_model(name)(study).zoo.name == name
        assert known_name(name.lower()) == name
    load_models(file)
    assert get_model("area+damped+taper")(study).zoo.name == "area+damped+taper"
    with pytest.raises(EffectError, match="model 'arae': unknown; did you mean 'area'"):
        get_model("arae")
    with pytest.raises(EffectError, match="effect 'tapr': unknown; did you mean 'taper'"):
        known_name("B+tapr")


def test_what_a_file_may_not_hold(tmp_path: Path) -> None:
    path = tmp_path / "none.py"
    path.write_text("x = 1\n")
    with pytest.raises(EffectError, match="defines no model; write a function model_NAME"):
        load_models(path)
    with pytest.raises(EffectError, match="defines no effect; decorate a function"):
        add_effects(path)
    path.write_text("def model_b(study, **settings): ...\n")
    with pytest.raises(EffectError, match="model_b: B is a model of the package; rename it"):
        load_models(path)
    path.write_text("1/0\n")
    with pytest.raises(EffectError, match="ZeroDivisionError: division by zero; correct the file"):
        load_models(path)


def test_a_model_and_an_effect_of_a_file_are_sampled_in_another_process(file: Path) -> None:
    """Which knows neither the file nor what it added to the catalogue here."""
    load_models(file)
    model = get_model("area+damped")(small_study())
    idata = sample(model, draws=20, tune=20, chains=2, cores=1, until_ess=None, seed=1, progress=False)
    assert set(idata.posterior) == {"k", "c", "damped.share", "sigma2"}
    assert RunRecord.of(idata).model == "area+damped"
    assert np.all(np.isfinite(idata.posterior["damped.share"]))
    assert float(idata.posterior["damped.share"].std()) > 0


SCRIPT = (
    EFFECT
    + """
if __name__ == "__main__":
    import sys
    study = zoo.load_study(sys.argv[1])
    model = zoo.model_A(study, effects=[damped])
    idata = zoo.sample(model, draws=10, tune=10, chains=2, cores=1, until_ess=None, seed=1, progress=False)
    print("sampled", model.zoo.name, float(idata.posterior["damped.share"].std()) > 0)
"""
)


def test_an_effect_of_a_script_is_sampled_in_another_process(tmp_path: Path) -> None:
    """Its function is of __main__, which that process never imports."""
    save_study(small_study(), tmp_path / "small")
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, str(script), str(tmp_path / "small")], capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}, timeout=300,
    )  # fmt: skip
    assert done.stdout.strip().splitlines()[-1] == "sampled A+damped True", done.stderr[-2000:]


def test_command_line(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    save_study(small_study(), tmp_path / "small")
    run = CliRunner().invoke
    few = ["--draws", "10", "--tune", "10", "--chains", "2", "--cores", "1", "--until", "none", "--quiet"]
    found = run(app, ["effects", "damped", "--effects-from", str(file)])
    assert found.exit_code == 0, found.output
    assert "The inflow is drawn to its mean." in found.output
    words = ["sample", "area", "small", "--models-from", str(file), "--effects", "damped,local-stiffness@2"]
    found = run(app, [*words, "-o", "x.nc", *few])
    assert found.exit_code != 0  # its baseline is none that this effect knows
    found = run(app, ["sample", "A", "small", "--effects-from", str(file), "--effects", "damped", *few])
    assert found.exit_code == 0, found.output
    assert (tmp_path / "A+damped-small.nc").is_file()
    found = run(app, ["sample", "A", "small", "--effects", "dampd", *few])
    assert found.exit_code == 2
    assert "unknown" in found.output


def test_effects_of_an_installed_package_are_in_the_catalogue(tmp_path: Path) -> None:
    """By the entry point group `zoo.effects`, as an installer writes it."""
    (tmp_path / "lab_effects.py").write_text(
        "from zoo.core.effects import EffectParameter, effect\n"
        "size = EffectParameter('size', 'mmHg', 1.0, -5.0, 5.0, (1.0,))\n"
        "@effect('lab-offset', 'sensor', parameters=[size])\n"
        "def lab_offset(case, values, location):\n"
        "    'The laboratory reads too much.'\n"
        "    return case\n"
    )
    info = tmp_path / "lab_effects-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-effects\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[zoo.effects]\nlab = lab_effects:lab_offset\n")
    code = (
        "from zoo.blood.effects import CATALOGUE; made = CATALOGUE['lab-offset']; "
        "print(made.statement, list(CATALOGUE)[-1], len(CATALOGUE))"
    )
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=os.environ | {"PYTHONPATH": path}
    )
    assert done.stdout.strip() == "The laboratory reads too much. lab-offset 31", done.stderr


def test_a_model_that_takes_no_effects_or_gives_no_model_is_named(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("def model_bare(study):\n    return None\n")
    load_models(file)
    with pytest.raises(
        EffectError,
        match=r"takes no effects; make it by model_bare = zoo.study_model\(",
    ):
        get_model("bare+taper")
    folder = tmp_path / "study"
    save_study(small_study(), folder)
    found = CliRunner().invoke(app, ["sample", "bare", str(folder), "--models-from", str(file)])
    assert found.exit_code == 2
    assert "model bare: this PyMC model has no record" in found.stderr
