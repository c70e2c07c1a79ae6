"""The sentences of a diagnosis say what its numbers are, whichever way they fall."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from zoo.core.diagnosis import DiagnosisFile, read_diagnosis
from zoo.core.diagnosis.cautions import undecided
from zoo.core.diagnosis.file import LearnedFunction, NextMeasurement, SeriesGap, SetResult, StateFile
from zoo.core.diagnosis.wording import worded
from zoo.core.words import percent

FILE = read_diagnosis(Path(__file__).parent / "data" / "diagnosis.json")
"""A bulge of the wall, of size 0.298 ± 0.0028, and a kick of the inflow; the law is a free function."""
COMPONENT = {"bulge": "wall", "law": "wall", "kick": "inflow"}


def with_sets(**probabilities: float) -> DiagnosisFile:
    """The file with other sets, their causes joined by `_and_`; `nothing` is the empty set."""
    sets = []
    for name, p in sorted(probabilities.items(), key=lambda item: -item[1]):
        names = [] if name == "nothing" else name.split("_and_")
        own: dict[str, Any] = {"unit": "K", "log_prior": 0.0, "log_evidence": 0.0, "log_evidence_error": 0.0}
        of = {"causes": names, "names": names, "components": [COMPONENT[one] for one in names]}
        sets.append(SetResult.model_validate(own | of | {"probability": p, "solved": True}))

    def holding(names: set[str]) -> float:
        return sum(one.probability for one in sets if names & set(one.names))

    causes = [one.model_copy(update={"probability": holding({one.name})}) for one in FILE.causes]
    components = [
        one.model_copy(update={"probability": holding({n for n, c in COMPONENT.items() if c == one.name})})
        for one in FILE.components
    ]
    changes = {"sets": sets, "causes": causes, "components": components, "cause": sets[0].causes}
    return worded(FILE.model_copy(update=changes | {"decided": True, "no_gap": 0.0, "warnings": []}))


def test_the_headline_has_size_and_probability_and_the_next_line_the_odds() -> None:
    lines = with_sets(bulge=0.9, bulge_and_kick=0.06, law=0.03, nothing=0.01).lines
    assert lines[0] == "Most likely missing: bulge, size = 0.298 ± 0.0028 (96.0 %)."
    runner_up = "law of the wall as a learned function (3.0 %; the first is 32 times as probable)"
    assert lines[1] == f"Runner-up: {runner_up}."
    assert lines[2] == "Possibly in addition: kick (6 %)."  # 0.06 / 0.96
    assert "Parameters of the baseline, before → with it: level 1.34 → 1.1 ± 0.0028." in lines
    assert any(line.startswith("Model error (rms beyond the noise of ") for line in lines)


def test_the_error_of_series_in_other_units_is_told_too() -> None:
    first, second = FILE.gap.per_series
    between = {"mean": 2.5, "low": 2.0, "high": 3.0}, {"mean": 0.25, "low": 0.2, "high": 0.3}
    other = {"series": "heat", "unit": "W", "before": between[0], "after": between[1]}
    both = [first, SeriesGap.model_validate(second.model_dump() | other)]
    file = FILE.model_copy(update={"gap": FILE.gap.model_copy(update={"per_series": both})})
    told = "Model error of series in other units, before → with it: heat 2.5 → 0.25 W."
    assert told in worded(file).lines
    assert not any("other units" in line for line in worded(FILE).lines)


def test_a_state_without_a_model_error_needs_no_cause() -> None:
    none, holds = (
        {"mean": 0.0, "low": 0.0, "high": 0.1},
        {"names": list(FILE.leading.components), "functions": []},
    )
    carried = holds | {"error": none, "better": 0.5, "holds": False}
    carried |= {"beyond": None, "unit": "K"}
    state = {"state": "night", "checksum": "", "unit": "K", "noise": 0.1, "baseline": none}
    state |= {"sensor": None, "carried": [carried], "failed": []}
    file = FILE.model_copy(update={"states": [StateFile.model_validate(state)]})
    assert any(
        line.startswith(
            "In night, refitted: the baseline misses by 0, with what was learned of wall by 0 K; "
        )
        and line.endswith("the baseline needs no cause there.")
        for line in worded(file).lines
    )


def test_a_learned_logarithm_is_told_as_a_factor() -> None:
    learned = LearnedFunction(
        name="filter", argument="log frequency", argument_unit="log Hz", unit="log gain",
        values=[0.0, math.log(10.0)], mean=[0.0, math.log(0.5)], low=[0.0, math.log(0.4)],
        high=[0.0, math.log(0.625)], prior_sd=[0.1, 0.1], prior_size=0.1, length=None, probability=1.0,
    )  # fmt: skip
    assert learned.largest == ("10 Hz", "gain × 0.5 (0.4 to 0.62)")


def test_what_is_certain_to_all_digits_is_not_called_certain() -> None:
    assert "(>99.9 %)" in with_sets(bulge=1.0 - 1e-12, nothing=1e-12).verdict
    assert percent(0.99999) == ">99 %"
    assert percent(1.0) == "100 %"


@pytest.mark.parametrize(
    ("probabilities", "headline"),
    [
        ({"nothing": 0.8, "bulge": 0.2}, "No listed cause explains the model error of 0.25 K (80.0 %)"),
        (
            {"bulge": 0.4, "law": 0.35, "nothing": 0.25},
            "Most likely wrong: wall (75.0 %); best explanation of those simulated: bulge, size = 0.298 ± "
            "0.0028 (40 %)",
        ),
        (
            {"kick": 0.4, "nothing": 0.35, "law": 0.25},
            "These data do not decide; best explanation: kick (40 %)",
        ),
        (
            {"nothing": 0.4, "kick": 0.35, "law": 0.25},
            "These data do not decide; best explanation: no listed cause (40 %)",
        ),
    ],
)
def test_the_headline_of_other_answers(probabilities: dict[str, float], headline: str) -> None:
    assert with_sets(**probabilities).verdict == headline


def test_noise_alone_doubt_and_a_next_measurement_are_told() -> None:
    file = with_sets(nothing=0.9, bulge=0.1)
    small = file.gap.model_copy(update={"before": 0.5 * file.gap.noise_floor})
    quiet = worded(file.model_copy(update={"no_gap": 0.7, "gap": small}))
    assert quiet.verdict.startswith("Nothing is missing (70.0 %): noise of ")
    left = worded(file.model_copy(update={"no_gap": 0.7}))
    assert left.verdict.startswith("Nothing is missing (70.0 %) beyond errors of 0.25 K")
    measure = NextMeasurement(separates=("a", "b"), expected_log_odds=2.0, text="the level at night")
    told = worded(file.model_copy(update={"decided": False, "next_measurement": measure, "warnings": ["w"]}))
    assert told.verdict.startswith("Not decided, see the warnings. ")
    decide = "What would decide: the level at night, which tells a from b (expected odds up to 7.4 to 1)."
    assert decide in told.lines
    assert told.lines[-1] == "Warning: w."


@pytest.mark.parametrize(("other", "changes"), [(0.6, True), (0.2, False)])
def test_what_changes_with_which_prior_is_told(other: float, changes: bool) -> None:
    stated = FILE.sensitivity[0].model_copy(update={"components": {"wall": 0.9, "inflow": 0.1}})
    doubled = stated.model_copy(
        update={"prior": "odds doubled", "components": {"wall": 0.95, "inflow": other}}
    )
    file = FILE.model_copy(update={"sensitivity": [stated, stated, doubled], "decided": True})
    same = "Priors varied in 2 ways: the same answer each time (wall 90 % to 95 %)."
    moved = "Priors varied in 2 ways: the answer changes with odds doubled (inflow 10 % → 60 %)."
    assert (moved if changes else same) in worded(file).lines
    doubtful = worded(file.model_copy(update={"decided": False}))
    assert changes or f"{same[:-1]}, which does not take the warnings away." in doubtful.lines
    told = "the answer depends on the prior: it changes with odds doubled (inflow 10 % → 60 %)"
    assert (told in undecided(file, 4)) == changes


def test_priors_without_a_probable_component_tell_none() -> None:
    stated = FILE.sensitivity[0].model_copy(update={"components": {"wall": 0.3, "inflow": 0.3}})
    lines = worded(FILE.model_copy(update={"sensitivity": [stated, stated], "decided": True})).lines
    assert "Priors varied in 1 ways: the same answer each time (no component above 50 %)." in lines


def test_what_was_only_estimated_is_told() -> None:
    estimated = "combinations of causes that were only estimated by a linear model, not simulated"
    near = FILE.model_copy(update={"missed": 0.4, "linear_error": 1.0})
    assert f"Up to 40 % of the probability may belong to {estimated}." in worded(near).lines
    far = FILE.model_copy(update={"missed": 0.4, "linear_error": 7.0})
    assert not any(estimated in line for line in worded(far).lines)
    told = f"up to 40 % of the probability may belong to {estimated}: their log evidence may be off by 7"
    assert any(reason.startswith(told) for reason in undecided(far, 4))
    less = FILE.leading.model_copy(update={"probability": 0.2})
    most = FILE.model_copy(update={"missed": 0.8, "linear_error": 1.0, "sets": [less]})
    assert not any(estimated in line for line in worded(most).lines)
    assert sum(estimated in reason for reason in undecided(most, 4)) == 1


def test_a_long_answer_is_cut_where_it_is_printed() -> None:
    file = worded(FILE.model_copy(update={"warnings": [f"warning {i}" for i in range(40)]}))
    shown = str(file).splitlines()
    assert len(shown) == 20
    assert shown[-1] == f"and {len(file.lines) + 1 - 19} more lines in `lines`"


def test_no_probability_is_above_one() -> None:
    content = FILE.model_dump()
    content["components"][0]["probability"] = 1.0000000000000016  # a sum that was rounded
    assert DiagnosisFile.model_validate(content).components[0].probability == 1.0
    content["components"][0]["probability"] = 1.01
    with pytest.raises(ValidationError, match=r"1\.01 is no probability"):
        DiagnosisFile.model_validate(content)
