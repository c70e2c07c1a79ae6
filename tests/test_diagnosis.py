"""A whole diagnosis: phases, the gap and its shrinkage, several effects, the file."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from made import made
from zoo import load_study
from zoo.blood import study_diagnosis as diagnosis_module
from zoo.blood.baseline import get_baseline
from zoo.blood.blood_flow import study_data
from zoo.blood.study_diagnosis import PHASES, StudyDiagnosis, _of_size, errors_of, heard, phases
from zoo.blood.study_diagnosis import diagnose as diagnose_study
from zoo.core.diagnosis import DiagnosisError, read_diagnosis
from zoo.core.diagnosis.hooks import Hooks
from zoo.core.effects import EVERYWHERE, EffectError

FEW = ["sensor-gain", "inflow-shift", "tangent-wall", "beat-jitter", "local-stiffness"]


diagnose = partial(diagnose_study, component_sizes=0.0)
"""Without the components' free functions, which take most of the time and are tested elsewhere."""


@pytest.fixture(scope="module")
def jitter() -> StudyDiagnosis:
    return diagnose(made([("beat-jitter", (0.003,), EVERYWHERE)]), effects=FEW)


def test_the_cause_and_its_shrinkage(jitter: StudyDiagnosis) -> None:
    file = jitter.file
    assert jitter.cause == ["beat-jitter"]
    assert file.decided, file.warnings
    assert file.gap.before > 5 * file.gap.after
    assert file.gap.after < 0.03
    assert jitter.shrinkage > 0.8
    low, high = file.gap.removed_interval
    assert low <= jitter.shrinkage <= high
    assert file.gap.noise_floor == pytest.approx(0.05, rel=0.15)
    assert file.gap.residual_rms_after == pytest.approx(0.05, rel=0.15)


def test_the_gap_is_the_rms_that_was_put_in(jitter: StudyDiagnosis) -> None:
    """Residual^2 = gap^2 + noise^2, the noise being known."""
    gap = jitter.file.gap
    assert gap.before**2 + 0.05**2 == pytest.approx(gap.residual_rms_before**2, rel=0.05)
    for s in gap.per_series:
        assert s.before.low < s.before.mean < s.before.high


def test_held_out_series_are_predicted_better(jitter: StudyDiagnosis) -> None:
    gap = jitter.file.gap
    assert gap.held_out == "each series in turn"
    assert gap.held_out_after < 0.3 * gap.held_out_before


def test_shares_add_up(jitter: StudyDiagnosis) -> None:
    where = jitter.where
    for shares in (where.series, where.phase, where.harmonic):
        assert sum(shares.values()) == pytest.approx(1.0)
    left = made([("beat-jitter", (0.003,), EVERYWHERE)], noise=0.0).values - jitter.computed[0]
    names, phase = jitter.hooks.phases_of(jitter.data, [0, 1, 2])
    for i, name in enumerate(names):
        share = np.sum(left[:, phase == i] ** 2) / np.sum(left**2)
        assert where.phase[name] == pytest.approx(share, abs=0.05)
    assert where.place[0].part is None


def test_bias_of_the_baseline_is_removed(jitter: StudyDiagnosis) -> None:
    before, after = jitter.file.base_parameters["base"], jitter.file.base_parameters["over all sets"]
    assert abs(after["f3"].mean - 4.6e4) < max(abs(before["f3"].mean - 4.6e4), 4 * after["f3"].sd)
    assert abs(after["f3"].mean - 4.6e4) < 4 * after["f3"].sd
    by_hand = jitter.estimate(lambda p: p["f3"] / 1e4, "1e4 g/cm/s2")
    assert by_hand.mean == pytest.approx(after["f3"].mean / 1e4)
    assert by_hand.unit == "1e4 g/cm/s2"
    with pytest.raises(DiagnosisError, match="quantity: no parameter is named 'f4': did you mean 'f3'"):
        jitter.estimate(lambda p: p["f4"])
    assert by_hand.interval == pytest.approx([x / 1e4 for x in after["f3"].interval or ()])


def test_the_file_comes_back_and_places_are_vessels(jitter: StudyDiagnosis, tmp_path: Path) -> None:
    content = json.loads(jitter.save(tmp_path / "gap").read_text())
    json.dumps(jitter.file.model_dump(), allow_nan=False)
    assert read_diagnosis(tmp_path / "gap").model_dump() == jitter.file.model_dump()
    assert {row["name"] for row in content["causes"]} <= set(FEW)
    assert content["gap"]["before_mmHg"] == jitter.file.gap.before
    assert "gap_after_mmHg" in content["sets"]["columns"]
    assert set(content["where"]["place"][0]) == {"vessel", "subtree", "probability"}


def test_two_effects_are_found_together() -> None:
    """Of two components: each is wrong by one cause."""
    study = made([("beat-jitter", (0.004,), EVERYWHERE), ("inflow-shift", (0.006,), EVERYWHERE)])
    found = diagnose(study, effects=FEW[:4])
    assert set(found.cause) == {"beat-jitter", "inflow-shift"}
    assert found.file.number[2] > 0.5


def test_no_gap_has_no_cause() -> None:
    found = diagnose(made([], seed=7), effects=FEW)
    assert found.cause == []
    assert found.file.gap.removed == 0.0
    assert found.file.gap.before < 0.03
    assert found.file.verdict.startswith("Nothing is missing")


def test_one_series_holds_out_blocks() -> None:
    found = diagnose(made([("beat-jitter", (0.003,), EVERYWHERE)], series=(0,)), effects=FEW[:4])
    assert found.cause[0] == "beat-jitter"
    assert "blocks" in found.file.gap.held_out
    assert found.file.gap.held_out_after < found.file.gap.held_out_before  # type: ignore[operator]


def test_phases_of_a_drawn_beat() -> None:
    """A wave with a foot at 0.1, a peak at 0.3 and a notch at 0.5 of the beat, at any rotation."""
    n = 400
    t = np.arange(n) / n
    wave = np.interp(t, [0, 0.1, 0.3, 0.48, 0.5, 0.54, 1.0], [8, 7, 20, 14, 13.0, 14.2, 8])
    wanted = {0.2: "upstroke", 0.3: "peak", 0.4: "late-systole", 0.5: "incisura", 0.8: "diastole"}
    for turn in (0, 120, 333):
        found = np.roll(phases(np.roll(wave, turn), 0.1), -turn)
        assert {at: PHASES[found[int(at * n)]] for at in wanted} == wanted


def test_the_study_may_have_fewer_samples(jitter: StudyDiagnosis) -> None:
    study = jitter.study
    series = tuple(replace(s, value=s.value[::4]) for s in study.series)
    coarse = replace(study, time_s=study.time_s[::4], series=series)
    assert diagnose(coarse, effects=FEW[:4]).cause == ["beat-jitter"]


def test_units_that_cannot_be_are_warned_of() -> None:
    """Pressures in kPa instead of mmHg: the paper's priors exclude what fits, and the input is suspected."""
    study = replace(made([]), priors={"set": "paun2020"})
    study = replace(study, series=tuple(replace(s, value=s.value * 0.133322) for s in study.series))
    file = diagnose(study, effects=["sensor-offset"]).file
    assert "kPa would fit" in file.warnings[0]
    assert any("check the units in observations.csv" in text for text in file.warnings)
    assert file.excluded is not None


def test_units_that_cannot_be_in_another_state_are_warned_of(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the state's name; a study of sound units has no such warning."""
    given: list[Hooks] = []
    tried: list[list[object]] = []

    def stop(*arguments: object, hooks: Hooks, states: list[object], **settings: object) -> None:
        given.append(hooks)
        tried.append(states)
        raise DiagnosisError("far enough")

    monkeypatch.setattr(diagnosis_module, "diagnose_data", stop)
    study, kilopascal = load_study("demo"), made([])
    series = tuple(replace(s, value=s.value * 0.133322) for s in kilopascal.series)
    for state in (replace(kilopascal, name="exercise", series=series), kilopascal):
        with pytest.raises(DiagnosisError, match="far enough"):
            diagnose(study, states=[state])
    assert [len(states) for states in tried] == [0, 1]
    assert "exercise is not compared" in given[0].warnings[1]
    assert given[0].warnings[0].startswith("in exercise: ")
    assert "kPa would fit" in given[0].warnings[0]
    assert given[1].warnings == ()


def test_another_state_has_the_same_vessels_and_comes_in_a_list() -> None:
    study = load_study("demo")
    root, *others = study.vessels
    wider = replace(study, vessels=(replace(root, radius_cm=1.1 * root.radius_cm), *others))
    with pytest.raises(
        DiagnosisError, match="vessel 1 is not the same as in 'demo', whose parent, length and"
    ):
        diagnose(study, states=[wider])
    with pytest.raises(DiagnosisError, match="give a list of studies"):
        diagnose(study, states=study)  # type: ignore[arg-type]


def test_an_effect_parameter_at_its_bound_is_told() -> None:
    """A gain beyond what the catalogue allows."""
    scaled = made([("sensor-gain", (0.5,), EVERYWHERE)])
    scaled = replace(scaled, series=tuple(replace(s, value=1.2 * s.value) for s in scaled.series))
    file = diagnose(scaled, effects=["sensor-gain"]).file
    assert file.cause == ["sensor-gain"]
    assert any("stands at the upper bound of its prior, 0.5" in text for text in file.warnings)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"effects": "stenosis"}, "give a list, such as"),
        ({"effects": ["stenoss"]}, "did you mean 'stenosis'"),
        ({"cores": 0}, "cores = 0: must be at least 1"),
        ({"base": "linear-constat"}, "linear-constant"),
        ({"component_sizes": -1.0}, "component_sizes = -1"),
        ({"base": "H", "effects": ["tangent-wall"]}, "cannot be added to tangent-constant"),
    ],
)
def test_wrong_arguments_are_named(settings: dict[str, object], text: str) -> None:
    with pytest.raises((DiagnosisError, EffectError), match=text):
        diagnose(load_study("demo"), **settings)  # type: ignore[arg-type]


def test_what_is_no_study_and_a_series_that_does_not_vary_are_refused() -> None:
    with pytest.raises(DiagnosisError, match=r"study = 'demo': give a Study, such as zoo\.load_study"):
        diagnose("demo")  # type: ignore[arg-type]
    study = load_study("demo")
    first, *rest = study.series
    flat = replace(first, value=np.full_like(first.value, 10.0))
    with pytest.raises(DiagnosisError, match=r"is 10 throughout; give one that varies"):
        diagnose(replace(study, series=(flat, *rest)))


@pytest.mark.needs_data
def test_the_papers_prior_excludes_the_hypoxic_mouse() -> None:
    """Least squares has its stiffness at 1.99e5 and leaves 0.220 mmHg, with c far inside its bound of 2.5."""
    study = replace(load_study("mouse-h1"), priors={"set": "paun2020"})
    file = diagnose(study, effects=["sensor-gain"]).file
    assert file.excluded is not None
    bound, other = file.excluded.bounds
    assert (bound.parameter, bound.side, bound.bound) == ("f3", "upper", 1e5)
    assert bound.best == pytest.approx(1.99e5, rel=0.05)
    assert (other.parameter, other.bound) == ("c", 2.5)  # which it leans on where f3 is held at its bound
    assert other.best == pytest.approx(1.137, rel=0.05)
    assert file.excluded.residual_rms_within > 0.9
    assert file.excluded.residual_rms_free == pytest.approx(0.2198, rel=0.01)
    assert file.verdict.startswith("The baseline's prior excludes its best fit, f3 = 1.9")
    assert "--prior f3=..., or priors={'f3': ...}, lifts it" in file.warnings[0]


def test_a_study_whose_noise_is_given_is_diagnosed_with_it(jitter: StudyDiagnosis) -> None:
    study = jitter.study
    data = study_data(study)
    assert errors_of(study, data).known == {}
    assert errors_of(replace(study, noise_sd={"pressure_mmHg": 0.4}), data).known == {"pressure_mmHg": 0.4}
    # twice the true noise leaves half the precision, and is what the answer calls noise
    file = diagnose(replace(study, noise_sd={"pressure_mmHg": 0.1}), effects=["beat-jitter"]).file
    assert file.record["noise"]["pressure_mmHg"] == pytest.approx(0.1)
    with pytest.raises(DiagnosisError, match="noise_sd: differs between the series"):
        errors_of(replace(study, noise_sd={study.series[0].label: 0.4}), data)


def test_prior_sizes_of_components_have_a_factor(jitter: StudyDiagnosis) -> None:
    fitting, base = jitter.sets.search.fitting, jitter.sets.search.base
    theta = fitting.forward.theta(base.u)
    plain, twice = (_of_size(k)(fitting.baseline, theta, jitter.data) for k in (1.0, 2.0))
    assert [one.size for one in twice] == [2.0 * one.size for one in plain]
    assert _of_size(0.0) is None
    assert jitter.file.record["component_sizes"] == 0.0


def test_a_diagnosis_is_its_answer_in_print(jitter: StudyDiagnosis) -> None:
    lines = repr(jitter).splitlines()
    assert lines == ["demo, baseline linear-constant", *jitter.file.lines]
    assert len(lines) <= 20


@pytest.mark.parametrize("noise", [0.05, 0.002])
def test_the_grid_is_as_fine_as_for_the_noise_if_it_were_given(noise: float) -> None:
    """The solver's error is at most a third of what the finest harmonics show, as of a known noise."""
    study = replace(made([], noise=noise), numerics={})
    data = study_data(study)
    seen = heard(study, data)
    assert seen.noise_sd["pressure_mmHg"] == pytest.approx(noise, rel=0.15)
    base = get_baseline("linear-constant")
    grid = base.forward(seen).resolution
    assert grid.limit_percent == pytest.approx(
        base.forward(replace(study, noise_sd={"pressure_mmHg": noise})).resolution.limit_percent, rel=0.15
    )
    assert (grid.limit_percent < 0.02) is (noise < 0.01)
    asked = replace(study, numerics={"accuracy_percent": 0.5})
    assert heard(asked, data) is asked
    given = replace(study, noise_sd={"pressure_mmHg": 1.0})
    assert heard(given, data).noise_sd == given.noise_sd
