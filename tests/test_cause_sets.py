"""The posterior over sets of causes of a simulator that is solved."""

from __future__ import annotations

import numpy as np
import pytest

from toys import EFFECTS, FUNCTIONS, MODEL, NOISE, TIMES, data_of, hooks
from zoo.core.diagnosis import diagnose
from zoo.core.diagnosis.sets import CauseSets
from zoo.report.sets import sets_summary, write_sets


def sets_for(configuration: dict) -> CauseSets:
    found = diagnose(data_of(configuration), MODEL, EFFECTS, hooks=hooks(FUNCTIONS), max_effects=1)
    return found.sets()


@pytest.fixture(scope="module")
def bulged() -> CauseSets:
    return sets_for({"law": 0.3 * np.linspace(-2.0, 2.0, 9) ** 2})


def test_a_listed_effect_is_found_and_solved(bulged):
    first = next(iter(bulged.posterior.probability))
    assert bulged.name(first) == "bulge"
    assert first in bulged.solved
    assert bulged.posterior.components["wall"] > 0.9
    assert max(p for name, p in bulged.posterior.components.items() if name != "wall") < 0.3


def test_what_a_set_leaves_is_that_of_a_solve(bulged):
    first = next(iter(bulged.posterior.probability))
    fit = bulged.solved[first].fit
    model = fit.forward.model
    left = bulged.search.screening.data.values - model.solve(model.configure(fit.values))
    row = bulged.table().iloc[0]
    assert np.sqrt(np.mean(left**2)) == pytest.approx(NOISE, rel=0.2)
    assert row["gap_after_K"] <= 0.3 * NOISE
    assert fit.values[-1] == pytest.approx(0.3, abs=0.05)


def test_a_free_function_is_found_where_no_effect_is_the_cause():
    found = sets_for({"push": 0.15 * np.sin(4 * np.pi * TIMES) ** 3})
    assert found.posterior.components["inflow"] > 0.8
    first = next(iter(found.posterior.probability))
    assert found.name(first).startswith("push")
    assert found.solved[first].gained == pytest.approx(0.0, abs=0.5)  # this simulator is linear in it


def test_two_causes_are_two():
    found = sets_for({"law": 0.3 * np.linspace(-2.0, 2.0, 9) ** 2, "kick": 0.2})
    assert found.posterior.components["wall"] > 0.9
    assert found.posterior.components["inflow"] > 0.9
    assert found.posterior.number[2:].sum() > 0.9


def test_without_a_cause_none_is_probable():
    found = sets_for({})
    assert max(found.posterior.components.values()) < 0.3
    assert found.posterior.probability[()] > 0.5
    assert found.missed < 0.5


def test_tables_have_every_prior_and_sum_to_one(bulged):
    table = bulged.table(least=0.0)
    assert table["probability"].sum() == pytest.approx(1.0)
    assert np.all(np.diff(table["probability"]) <= 0.0)
    joint = (table["log_prior"] + table["log_evidence"]).to_numpy()
    stated = table["probability"].to_numpy()
    assert np.exp(joint - np.logaddexp.reduce(joint)) == pytest.approx(stated, rel=1e-9)
    under = bulged.sensitivity()
    assert under.loc["as stated", "wall"] == pytest.approx(bulged.posterior.components["wall"])
    assert under.loc["odds of causes halved", "inflow"] < under.loc["odds of causes doubled", "inflow"]


def test_files_and_sentences(bulged, tmp_path):
    written = write_sets(bulged, tmp_path)
    assert [path.name for path in written] == ["sets.csv", "sensitivity.csv"]
    assert written[0].read_text().splitlines()[1].startswith("bulge,wall,")
    text = "\n".join(sets_summary(bulged))
    assert "bulge" in text
    assert "components that are wrong (before the data): wall" in text


def test_without_anything_to_blame_there_is_nothing():
    found = diagnose(data_of({"push": 0.3}), MODEL, [], hooks=hooks([]), max_effects=1).sets()
    assert found.posterior.probability == {(): 1.0}
    assert found.name(()) == "nothing"
    assert list(found.table()["causes"]) == ["nothing"]
