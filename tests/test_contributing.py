"""The recipes of docs/extending.md, followed as they stand in a copy of the package."""

from __future__ import annotations

import pytest

from recipes import Copy, snippets

MODEL = """
import numpy as np
import zoo
from zoo.blood.baseline import get_baseline
from zoo.models import MODELS, PAPER

assert zoo.__file__.startswith({folder!r})
assert MODELS == (*PAPER, "J")
study = zoo.load_study("demo")
model = zoo.model_J(study)
assert "J" == model.zoo.name
assert get_baseline("tangent-wide") is get_baseline("j")
assert get_baseline("tangent-constant") is get_baseline("H")
assert np.isfinite(model.compile_logp()(model.initial_point()))
"""
EFFECT = """
import numpy as np
import zoo
from zoo.blood.baseline import get_baseline
from zoo.blood.plugins import known_name
from zoo.core.effects import with_effects
from zoo.blood.effects import CATALOGUE
from zoo.core.parameters import pack, start_of

flow = get_baseline("B").forward(zoo.load_study("demo"))
made = with_effects(flow, [CATALOGUE["resistance-split"].at()])
theta = np.append(pack(flow.parameters, start_of(flow.parameters)), 0.25)
case = made.configure(theta)
plain = flow.configure(theta[:-1])
total = case.psi1 * case.network.R1 + case.psi2 * case.network.R2
np.testing.assert_allclose(total, plain.psi1 * plain.network.R1 + plain.psi2 * plain.network.R2)
np.testing.assert_allclose(case.psi1, 1.25 * plain.psi1)
model = zoo.model_J(zoo.load_study("demo"), effects=["resistance-split"])
assert model.zoo.name == known_name("j+resistance-split")
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Copy:
    """The package with the model and the effect of the recipes, and nothing else."""
    made = Copy(tmp_path_factory.mktemp("copy"))
    [model], [effect] = (snippets(heading, "diff") for heading in ("A model", "An effect"))
    assert made.apply(model) == ["models/model_j.py", "src/zoo/__init__.pyi"]
    assert made.apply(effect) == ["src/zoo/blood/effects/outflow.py"]
    return made


def test_a_model_is_one_file(copy: Copy) -> None:
    copy.run("-c", MODEL.format(folder=str(copy.folder)))


def test_an_effect_is_one_function(copy: Copy) -> None:
    copy.run("-c", EFFECT)
    assert "a fifth is a guess" in copy.run("-m", "zoo", "effects", "resistance-split")


def test_a_second_baseline_of_the_same_name_is_refused(copy: Copy) -> None:
    file = copy.place("models/model_j.py")
    text = file.read_text(encoding="utf-8")
    twin = copy.place("models/model_k.py")
    twin.write_text(text.replace("model_J", "model_K").replace('"J"', '"K"'), encoding="utf-8")
    try:
        said = copy.run(
            "-c",
            "from zoo.blood.baseline import get_baseline as g\ntry: g('K')\nexcept Exception as e: print(e)",
        )
    finally:
        twin.unlink()
    assert said.strip() == (
        "model J: another model has a baseline named 'tangent-wide'; give this one a new name"
    )
