"""Simulators of one's own with something amiss: the right cause is named, or what is amiss is said."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter

import zoo
from zoo.core.data import Data, DataError
from zoo.core.diagnosis import Diagnosis, DiagnosisError, diagnose
from zoo.core.diagnosis.coordinates import SearchModel
from zoo.core.diagnosis.solve_store import SolveStore, StoredModel
from zoo.core.effects import Effect, EffectError, EffectParameter, effect
from zoo.core.errors.spectral import spectral_errors
from zoo.core.forward import FunctionModel, Outputs, SolveError, from_pints
from zoo.core.inference.memo import CheckpointError
from zoo.core.parameters import LogUniform, Normal, Parameter

MINUTES = np.arange(0.0, 30.0, 1.0 / 3.0)
NOISE = 0.1


def adds(name: str, key: str, unit: str, scale: float, low: float, high: float, *starts: float) -> Effect:
    """An effect that sets one key of a configuration."""

    @effect(name, parameters=[EffectParameter("size", unit, scale, low, high, starts)])
    def change(c, values, at):  # type: ignore[no-untyped-def]
        """Sets one number."""
        return {**c, key: values[0]}

    return change


# -- a cup that cools, and steams ------------------------------------------------------------------


def cup(c, t):  # type: ignore[no-untyped-def]
    """In K above the room, which may itself warm."""
    decay, steam = np.exp(-c["rate"] * t), c.get("steam", 0.0)
    return c["start"] * decay / (1 + steam / c["rate"] * c["start"] * (1 - decay)) + c.get("drift", 0.0) * t


STEAM = adds("steam", "steam", "1/(min K)", 1e-3, 0.0, 1e-2, 3e-4, 1e-3)
DRIFT = adds("drift", "drift", "K/min", 0.06, -0.3, 0.3, 0.03, -0.03)
PRIORS = (
    Parameter("rate", LogUniform(6e-3, 0.6), "1/min", log=True),
    Parameter("start", Normal(60.0, 5.0), "K"),
)


PRIOR_BY_NAME = {one.name: one for one in PRIORS}


def cups(function=cup, times=MINUTES, series=("tea",)) -> FunctionModel:  # type: ignore[no-untyped-def]
    return FunctionModel(function, PRIORS, Outputs(series, times), "cup")


def tea(odd: tuple[int, ...] = (), **added: float) -> Data:
    values = cup({"rate": 0.06, "start": 61.0, **added}, MINUTES)
    values = values + NOISE * np.random.default_rng(1).standard_normal(len(MINUTES))
    values[list(odd)] += 8.0
    return Data(MINUTES, values, labels=["tea"], units=["K"], time_unit="min")


def told(data: Data, model: FunctionModel | None = None, effects=(STEAM, DRIFT)) -> Diagnosis:  # type: ignore[no-untyped-def]
    return diagnose(data, model or cups(), list(effects), cores=1)


def test_steam_is_found() -> None:
    found = told(tea(steam=6e-4))
    assert found.cause == ["steam"]
    assert found.components[0].probability > 0.95
    assert found.file.warnings == []
    assert found.file.decided


def test_what_is_predicted_holds_the_truth_where_measured_and_later() -> None:
    found = told(tea(steam=6e-4))
    assert len(str(found).splitlines()) <= 20
    assert str(found) == repr(found) == str(found.file)
    assert "<p><b>Most likely missing: steam" in found._repr_html_()
    later = np.array([40.0, 60.0])
    for times, shown in (
        (MINUTES, found.predict()),
        (later, found.predict(Outputs(("tea",), later), draws=60)),
        (later, found.predict(later, draws=60)),
    ):
        truth = cup({"rate": 0.06, "start": 61.0, "steam": 6e-4}, times)
        assert list(shown["time"]) == list(times)
        assert np.mean((shown["low"] < truth) & (truth < shown["high"])) > 0.9
        assert np.all(shown["high"] - shown["low"] < 1.0)  # the baseline misses by more
        assert np.all((shown["low"] < shown["mean"]) & (shown["mean"] < shown["high"]))


def test_samples_that_stand_out_are_named_and_no_others() -> None:
    said = told(tea((20, 50, 51), steam=6e-4)).file.warnings
    at = ", ".join(f"{MINUTES[i]:.4g}" for i in (20, 50, 51))
    assert any(f"tea: what was measured at {at} min stands out from its neighbours" in x for x in said)


@pytest.mark.parametrize("odd", [(0,), (89,), (44,)])
def test_a_sample_that_stands_out_anywhere_is_named(odd: tuple[int, ...]) -> None:
    said = told(tea(odd)).file.warnings
    assert any(f"tea: what was measured at {MINUTES[odd[0]]:.4g} min stands out" in text for text in said)


def test_correlated_noise_is_said_to_be_like_a_cause_that_is_not_listed() -> None:
    """Of an AR(1) noise of 0.8 from sample to sample, and not of white noise of the same size."""
    rng, full = np.random.default_rng(3), tea()
    white = 0.3 * rng.standard_normal((2, 90))
    correlated = lfilter([0.6], [1.0, -0.8], white[1])
    for noise, there in ((white[0], False), (correlated, True)):
        data = Data(MINUTES, full.values + noise, labels=["tea"], units=["K"], time_unit="min")
        said = told(data).file.warnings
        assert any("the noise comes out as correlated" in text for text in said) == there


def test_a_parameter_that_is_not_read_is_named() -> None:
    lid = Parameter("lid", Normal(0.0, 1.0), "1")
    model = FunctionModel(cup, (*PRIORS, lid), Outputs(("tea",), MINUTES), "cup")
    found = diagnose(tea(), model, [], cores=1)
    told_of = (
        "lid changes no series where the baseline fits best: if the simulator never reads it, leave it out"
    )
    assert told_of in found.file.warnings
    assert not any("changes no series" in text for text in told(tea()).file.warnings)
    assert not any(line.startswith("Priors varied") for line in found.file.lines)  # nothing can change


def test_a_parameter_that_only_a_cause_reads_is_read() -> None:
    @zoo.effect("steam", unit="1", size=1.0, low=0.0)
    def steam(c, size):  # type: ignore[no-untyped-def]
        """Steams by what the baseline has no use for."""
        return {**c, "steam": size * c["wet"]}

    wet = Parameter("wet", Normal(6e-4, 1e-4), "1/(min K)")
    model = FunctionModel(cup, (*PRIORS, wet), Outputs(("tea",), MINUTES), "cup")
    found = diagnose(tea(steam=6e-4), model, [steam], cores=1)
    assert found.cause == ["steam"]
    assert not any("changes no series" in text for text in found.file.warnings)


def test_what_stands_out_is_told_by_its_time_on_a_late_clock() -> None:
    late = MINUTES + 20000.0
    values = tea(odd=(44,)).values
    data = Data(late, values, labels=["tea"], units=["K"], time_unit="min")
    model = FunctionModel(lambda c, t: cup(c, t - 20000.0), PRIORS, Outputs(("tea",), late), "cup")
    said = diagnose(data, model, [STEAM], cores=1).file.warnings
    assert any(f"at {late[44]:.7g} min stands out" in text for text in said)


@pytest.mark.parametrize(
    "records",
    [
        np.ones((3, 3)),
        {"n": 5},
        {"n": None},
        {"n": "abc"},
        {3: (MINUTES, MINUTES, cup)},
        {"n": (MINUTES, cup)},
    ],
)
def test_records_held_out_that_are_none_are_refused(records: Any) -> None:
    priors = {one.name: one for one in PRIORS}
    with pytest.raises(
        DiagnosisError, match=r"give a dict of records, \{'name': \(times, measured, simulate\)\}"
    ):
        zoo.diagnose(MINUTES, tea().values[0], cup, priors, [], held_out=records)


def test_what_resembles_the_cause_is_not_named_in_its_place() -> None:
    found = told(tea(steam=6e-4), effects=[DRIFT])
    assert found.cause == []
    assert found.causes[0].probability < 0.5
    assert found.file.verdict.startswith("No listed cause explains the model error of")
    assert found.file.no_gap < 0.01
    # the gap is what a best fit misses, and no more
    data = found.data.values[0]
    left = least_squares(lambda x: data - cup({"rate": x[0], "start": x[1]}, MINUTES), [0.07, 60.0])
    rms = np.sqrt(np.mean(left.fun**2))
    assert found.file.gap.residual_rms_before == pytest.approx(rms, rel=0.01)
    assert found.file.gap.before == pytest.approx(rms, rel=0.03)


def test_the_second_of_two_that_the_data_do_not_tell_apart_is_named() -> None:
    def laws(c, t):  # type: ignore[no-untyped-def]
        y = [c["start"]]
        for step in np.diff(t):  # two laws of loss, Heun's method

            def rate(x: float) -> float:
                return -c["rate"] * x - c.get("steam", 0.0) * x**2 - c.get("power", 0.0) * abs(x) ** 2.6

            first = rate(y[-1])
            y.append(y[-1] + 0.5 * step * (first + rate(y[-1] + step * first)))
        return np.array(y)

    power = adds("by-power", "power", "1", 1e-4, 0.0, 1e-3, 3e-5)
    common = {"rate": 0.06, "start": 61.0}
    both = 0.5 * laws({**common, "steam": 6e-4}, MINUTES) + 0.5 * laws({**common, "power": 5.4e-5}, MINUTES)
    values = both + 0.03 * np.random.default_rng(1).standard_normal(len(MINUTES))
    found = told(Data(MINUTES, values, labels=["tea"], units=["K"]), cups(laws), [STEAM, power])
    shared = {one.name: one.probability for one in found.causes}
    assert min(shared.values()) > 0.1, shared
    leader, second, *_ = found.file.lines
    both_held = sum(row.probability for row in found.table if len(row.causes) == 2)
    assert re.match(rf"Most likely missing: steam, .* and by power, .* \({100 * both_held:.1f} %\)", leader)
    assert re.match(r"Runner-up: (steam|by power) alone \(.* %; the first is .* times as probable\)", second)


# -- mistakes that ten solves show, and the solves themselves ---------------------------------------


class Counted:
    """A cup that counts its solves, and where they were."""

    def __init__(self) -> None:
        self.at: list[tuple[float, ...]] = []

    def __reduce__(self):  # type: ignore[no-untyped-def]
        return Counted, ()  # it is the same simulator whatever it has counted

    def __call__(self, c, t):  # type: ignore[no-untyped-def]
        self.at.append(tuple(c.get(name, 0.0) for name in ("rate", "start", "steam", "drift")))
        return cup(c, t)


def test_a_simulator_that_differs_each_time_is_refused_after_two_solves() -> None:
    rng, counted = np.random.default_rng(0), Counted()

    def restless(c, t):  # type: ignore[no-untyped-def]
        return counted(c, t) + 0.02 * rng.standard_normal(len(t))

    with pytest.raises(DiagnosisError, match=r"cup: two solves at the same parameters differ by .* fix its"):
        told(tea(steam=6e-4), cups(restless))
    assert len(counted.at) == 2


def test_an_effect_that_nothing_reads_is_named_within_ten_solves(monkeypatch: pytest.MonkeyPatch) -> None:
    counted = Counted()
    typo = adds("vapour", "stream", "1/(min K)", 1e-3, 0.0, 1e-2, 3e-4, 1e-3)
    with pytest.warns(UserWarning, match=r"effect vapour: size = 0.0003 and 0.001 changes no sample of cup"):
        found = told(
            tea(steam=6e-4), cups(counted), [typo, DRIFT, replace(STEAM, locations=lambda model: ())]
        )
    assert "effect steam: none of its starts changes any sample" in " ".join(found.file.warnings)
    assert "effect vapour: none of its starts changes any sample" in " ".join(found.file.warnings)
    assert "vapour" not in [cause.name for cause in found.file.causes]
    counted.at.clear()
    monkeypatch.setattr("zoo.core.diagnosis.diagnosis.freed", None)  # the search begins with it
    with pytest.warns(UserWarning, match="effect vapour"), pytest.raises(TypeError, match="not callable"):
        told(tea(), cups(counted), [STEAM, DRIFT, typo])
    assert len(counted.at) <= 10


def test_all_effects_that_nothing_reads_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    typos = [adds(f"vapour{i}", f"stream{i}", "1", 1.0, -2.0, 2.0, 1.0, -1.0) for i in range(9)]
    said, solves = checked_before_a_search(monkeypatch, STEAM, *typos)
    assert [text.split(":")[0] for text in said] == [f"effect {one.name}" for one in typos]
    assert solves <= 10


def test_an_effect_that_only_a_later_start_shows_is_not_called_idle(monkeypatch: pytest.MonkeyPatch) -> None:
    rim = adds("rim", "rim", "K", 10.0, 1.0, 90.0, 70.0, 50.0)  # the tea begins at 60 K
    typo = adds("vapour", "stream", "1", 1.0, -2.0, 2.0, 1.0)

    def brimming(c, t):  # type: ignore[no-untyped-def]
        return np.minimum(cup(c, t), c.get("rim") or 99.0)

    monkeypatch.setattr("zoo.core.diagnosis.diagnosis.freed", None)
    with pytest.warns(UserWarning, match="effect vapour") as said, pytest.raises(TypeError):
        told(tea(), cups(brimming), [rim, typo])
    assert not any("effect rim" in str(one.message) and "changes no" in str(one.message) for one in said)


def hotter(low: float) -> Effect:
    @effect("hotter", unit="K", size=5.0, low=low, high=20.0)
    def change(c, size):  # type: ignore[no-untyped-def]
        """Sets the start itself: 7 K above the baseline's where the size is next to 0."""
        return {**c, "start": 67.0 + size}

    return change


def checked_before_a_search(monkeypatch: pytest.MonkeyPatch, *effects: Effect) -> tuple[list[str], int]:
    """Warnings of what is looked at before a search, and solves."""
    counted = Counted()
    monkeypatch.setattr("zoo.core.diagnosis.diagnosis.freed", None)  # the search begins with it
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        with pytest.raises(TypeError, match="not callable"):
            told(tea(), cups(counted), effects)
    return [str(one.message) for one in said], len(counted.at)


def test_an_effect_that_is_not_the_baseline_at_size_0_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    [warning], solves = checked_before_a_search(monkeypatch, hotter(0.0), STEAM, DRIFT)
    rms = 7.0 * np.sqrt(np.mean(np.exp(-0.06 * MINUTES) ** 2))  # the rate's prior has its median there
    assert f"effect hotter: size = 5e-12 already changes tea of cup by {rms:.2g} K (rms)" in warning
    assert solves <= 6  # the baseline twice, one for each effect, and the sizes of the one that is amiss


def test_an_effect_whose_bounds_hold_no_0_may_replace_a_part(monkeypatch: pytest.MonkeyPatch) -> None:
    assert checked_before_a_search(monkeypatch, hotter(0.1))[0] == []


def test_one_effect_under_two_names_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    vapour = adds("vapour", "steam", "1/(min K)", 1e-3, 0.0, 1e-2, 3e-4, 1e-3)
    [warning], _ = checked_before_a_search(monkeypatch, STEAM, DRIFT, vapour)
    assert warning.startswith("effects steam and vapour do the same to cup: leave one of them out")


def test_an_effect_or_free_function_that_is_given_twice_is_refused() -> None:
    with pytest.raises(DiagnosisError, match="effects: steam is given twice; give it once, or another name"):
        told(tea(), effects=[STEAM, DRIFT, STEAM])
    friction = zoo.free_function("steam", along="velocity", size=1.0)
    for effects in ([friction, friction], [friction, STEAM]):
        with pytest.raises(DiagnosisError, match="effects: steam is given twice"):
            zoo.diagnose(tea(), cups(), effects)


def test_a_misspelt_prior_is_told_with_the_nearest_name() -> None:
    priors = {"rate": PRIORS[0], "strat": Normal(60.0, 5.0)}
    with pytest.raises(KeyError) as caught:
        zoo.diagnose(MINUTES, tea().values, cup, priors, [STEAM])
    assert (
        "no prior is named 'start': did you mean 'strat'? use one of rate, strat" in caught.value.__notes__[0]
    )
    assert "SolveError" not in caught.value.__notes__[0]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"simulate": lambda c: cup(c, MINUTES)}, r"simulate = .*is called as simulate\(parameters, times\)"),
        ({"simulate": lambda rate, start, t: t}, r"simulate\(parameters, times\), with a dict.*: missing a"),
        ({"simulate": MINUTES}, r"simulate = array.*is called as simulate\(parameters, times\)"),
        ({"simulate": lambda c, t: None}, "cannot be solved .*: returns None; let it return its series"),
        ({"priors": list(PRIORS)}, "priors = .*: give a dict by name of parameter"),
        ({"priors": {"rate": 0.06, "start": Normal(60.0, 5.0)}}, "prior rate = 0.06: give one of zoo"),
        ({"priors": {}}, r"cup has no parameters: give it at least one with a prior, such as priors=\{'off"),
        ({"times": None}, "times = None: must be real numbers"),
        ({"name": 5}, "name = 5: give a text"),
        ({"period": float("nan")}, "period = nan: must be positive, or None"),
        ({"simulate": lambda c, t: cup(c, t) + 1j}, "<lambda>: returns complex numbers; let it return real"),
        ({"noise": -0.1}, "noise of y0 = -0.1: must be a positive number"),
        ({"noise": {"tea": 0.1}}, "noise of 'tea': unknown; .*use one of y0"),
        ({"noise": 0.1, "errors": zoo.Cosines()}, "noise = 0.1: errors are given too"),
        (
            {"noise": 0.1, "measured": [MINUTES, tea().values[0]], "units": ["s", "K"]},
            r"noise = 0.1: the series are in s, K; give one for each, such as \{'y0'",
        ),
    ],
)
def test_what_does_not_fit_the_short_case_is_told(change: dict[str, Any], told: str) -> None:
    given = {"times": MINUTES, "measured": tea().values, "simulate": cup, "priors": PRIOR_BY_NAME} | change
    with pytest.raises(ValueError, match=told):
        zoo.diagnose(**given, effects=[STEAM], progress=False)


def test_an_effect_of_other_arguments_is_refused_where_it_is_made() -> None:
    with pytest.raises(
        EffectError, match=r"effect leak: is called as \(parameters, size\): .*'where'.*locations="
    ):
        effect("leak", size=1.0)(lambda c, size, where: c)
    with pytest.raises(EffectError, match=r"effect leak: is called as \(parameters, values, location\): "):
        effect("leak", parameters=STEAM.parameters)(lambda c, values: c)
    with pytest.raises(EffectError, match=r"effect leak: is called as \(parameters, size, location\): "):
        effect("leak", size=1.0, locations=lambda model: ())(lambda c, size: c)


@pytest.mark.parametrize("start", [0.0, 1.0])
def test_an_effect_that_would_start_where_it_cannot_is_refused(start: float) -> None:
    with pytest.raises(EffectError, match=rf"effect steam: parameter size: start {start:g}: give one"):
        adds("steam", "steam", "1/(min K)", 1e-3, 0.0, 1e-2, start)


def test_a_checkpoint_that_cannot_be_made_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def mkdir(*_: object, **__: object) -> None:  # as in /proc, where folders seem to be writable
        raise FileNotFoundError(2, "No such file or directory")

    monkeypatch.setattr(Path, "mkdir", mkdir)
    with pytest.raises(CheckpointError, match=r"run: cannot be used as checkpoint folder \(No such file"):
        SolveStore(tmp_path / "run")


def test_a_checkpoint_in_the_home_folder_is_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    SolveStore("~/run").close()
    assert (tmp_path / "home" / "run").is_dir()
    assert not (tmp_path / "~").exists()


def test_no_solve_is_made_twice_and_an_interrupted_diagnosis_goes_on(tmp_path: Path) -> None:
    whole = Counted()
    expected = told(tea(steam=6e-4), cups(whole))
    assert len(whole.at) - len(set(whole.at)) <= 1  # the second look at the start
    assert expected.file.record["solves"] == len(set(whole.at))

    def interrupt(text: str, share: float) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    first, second = Counted(), Counted()
    with pytest.raises(KeyboardInterrupt) as stopped:
        diagnose(
            tea(steam=6e-4), cups(first), [STEAM, DRIFT], cores=1, tick=interrupt, checkpoint=tmp_path / "run"
        )
    assert re.search(r"\d+ solves were made until then: kept in .*run", stopped.value.__notes__[0])
    found = diagnose(tea(steam=6e-4), cups(second), [STEAM, DRIFT], cores=1, checkpoint=tmp_path / "run")
    assert len(first.at) > 30
    assert len(set(first.at) & set(second.at)) <= 1
    assert set(first.at) | set(second.at) == set(whole.at)
    assert found.file.sets == expected.file.sets
    later = found.predict(
        Outputs(("tea",), np.array([40.0])), draws=5
    )  # solves on, though the file is closed
    assert later["mean"].between(later["low"], later["high"]).all()


def test_another_simulator_or_time_takes_nothing_from_a_store(tmp_path: Path) -> None:
    def warmer(c, t):  # type: ignore[no-untyped-def]
        return cup(c, t) + 0.5

    store = SolveStore(tmp_path / "run")
    one, other = (StoredModel(cups(function), store) for function in (cup, warmer))
    theta = np.array([0.06, 61.0])
    for _ in range(2):
        np.testing.assert_allclose(other.solve(other.configure(theta)) - one.solve(one.configure(theta)), 0.5)
    assert store.made == 2
    assert one.solve(one.configure(theta), Outputs(("tea",), MINUTES[:5])).shape == (1, 5)


@pytest.mark.parametrize(
    ("model", "text"),
    [
        (cups(times=60.0 * MINUTES), "cup is solved at times 0 to 1780, the data are of 0 to 29.6"),
        (cups(series=("coffee",)), "cup gives series coffee, the data are tea"),
    ],
)
def test_a_model_of_other_times_or_series_is_refused(model: FunctionModel, text: str) -> None:
    with pytest.raises(DiagnosisError, match=text):
        told(tea(), model)


def test_samples_that_were_not_measured_are_left_out() -> None:
    """One in ten, masked: what remains tells the same cause, as uneven times do."""
    rng, full = np.random.default_rng(4), tea(steam=6e-4)
    away = np.isin(np.arange(90), rng.choice(90, 9, replace=False))
    values = np.ma.array(full.values, mask=away[None])
    with pytest.warns(UserWarning, match="9 of 90 times are left out, at which nothing was measured"):
        data = Data(MINUTES, values, labels=["tea"], units=["K"], time_unit="min")
    np.testing.assert_array_equal(data.values[0], full.values[0, ~away])
    found, whole = told(data, cups(times=data.times)), told(full)
    assert found.cause == whole.cause == ["steam"]
    assert found.components[0].probability > 0.95
    one, other = (x.causes[0].estimates[0] for x in (found, whole))
    assert one.mean == pytest.approx(other.mean, abs=2.0 * other.sd)
    assert other.sd < one.sd < 1.5 * other.sd
    with pytest.raises(DataError, match="series 0 has 0 measured values: give at least two"):
        Data(MINUTES, np.full(90, np.nan))


@pytest.mark.parametrize("given", [{"later": (MINUTES, MINUTES)}, (MINUTES, MINUTES, cup)])
def test_what_is_held_out_has_a_name_and_a_simulator(given: Any) -> None:
    with pytest.raises(DiagnosisError, match=r"held_out = .*: give a dict of records, \{'name': \(times"):
        zoo.diagnose(MINUTES, tea().values, cup, PRIOR_BY_NAME, [STEAM], held_out=given)


@pytest.mark.parametrize(
    ("times", "values", "text"),
    [
        ([], [], "series 0 has 0 measured values"),
        (MINUTES, tea(), r"values = Data\(.*\): must be real numbers"),
        (MINUTES, MINUTES + 1j, "values = .*: must be real numbers"),
        (MINUTES.astype("datetime64[m]"), MINUTES, "times = .*: are dates, .*give seconds since the first"),
        (
            [datetime(2026, 1, 1, 12, i) for i in range(9)],
            MINUTES[:9],
            "times = .*: are dates, .*give seconds",
        ),
        (
            MINUTES,
            [MINUTES, MINUTES[:9]],
            r"are rows of different lengths; .*times=\[t1, t2\] and values=\[y1, y2\]",
        ),
    ],
    ids=["nothing", "data", "complex", "dates", "datetimes", "ragged"],
)
def test_what_is_no_record_is_refused(times: Any, values: Any, text: str) -> None:
    with pytest.raises(DataError, match=text):
        Data(times, values)


def test_seconds_of_dates_are_what_the_refusal_of_dates_says() -> None:
    t = [datetime(2026, 1, 1, 12, i) for i in range(9)]
    with pytest.raises(DataError) as caught:
        Data(t, MINUTES[:9])
    advice = re.search(r"\[\(.*\]", str(caught.value))
    assert advice is not None
    assert eval(advice[0], {"np": np, "t": t}) == [60.0 * i for i in range(9)]


@pytest.mark.parametrize("error", [RuntimeError, np.linalg.LinAlgError, ZeroDivisionError, SolveError])
def test_solves_that_fail_are_counted_and_told(error: type[Exception]) -> None:
    def brittle(c, t):  # type: ignore[no-untyped-def]
        if c.get("steam", 0.0) > 5.4e-4:
            raise error("did not converge")
        return cup(c, t)

    found = told(tea(steam=6e-4), cups(brittle))
    assert found.file.record["failed_solves"] > 10
    [warning] = [text for text in found.file.warnings if "did not converge" in text]
    assert re.match(r"\d+ of \d+ solves failed, all with steam and \d+ with drift \(", warning)


def test_a_mistake_in_a_simulator_is_told_with_the_values_where_it_shows() -> None:
    def mistaken(c, t):  # type: ignore[no-untyped-def]
        return cup({**c, "rate": c["rte"]} if "steam" in c else c, t)

    with pytest.raises(KeyError, match="rte") as caught:
        told(tea(), cups(mistaken))
    where, kept = caught.value.__notes__
    assert "was solved with rate = 0.0" in where
    assert "steam.size = " in where
    assert "solves were made until then: give checkpoint='FOLDER' to keep them" in kept


def test_a_key_that_a_pints_model_does_not_take_is_refused() -> None:
    class Logistic:
        def n_parameters(self) -> int:
            return 2

        def simulate(self, p, times):  # type: ignore[no-untyped-def]
            return p[1] / (1 + (p[1] / 2.0 - 1) * np.exp(-p[0] * np.asarray(times)))

    t = np.linspace(0.0, 100.0, 51)
    rates = [Parameter("r", LogUniform(0.01, 1.0), log=True), Parameter("K", LogUniform(10, 1000), log=True)]
    data = Data(t, Logistic().simulate([0.1, 50.0], t) + np.cos(t), labels=["y0"])
    offset = adds("offset", "offset", "1", 5.0, -50.0, 50.0, 2.0)
    with pytest.raises(ValueError, match="offset: no parameter of Logistic, which has r, K"):
        diagnose(data, from_pints(Logistic(), t, rates), [offset])


# -- a spring that is driven, fast beside the record -----------------------------------------------

SAMPLES = np.arange(400) / 610.0
PUSHES = np.repeat(np.random.default_rng(0).standard_normal(100), 4) * 0.06
QUIET = 5e-4
CUBIC = adds("cubic", "k3", "1", 3.0, -20.0, 20.0, 1.0, -1.0)
OFFSET = adds("offset", "off", "V", 0.01, -0.1, 0.1, 3e-3, -3e-3)


def ring(c, times):  # type: ignore[no-untyped-def]
    """A resonator with a spring that may harden, by small steps."""
    y = v = 0.0
    f, g, k3, off = (float(c.get(key, 0.0)) for key in ("f", "g", "k3", "off"))
    out, h, w = [], 1 / 610.0 / 4, 2 * np.pi * f
    for u in PUSHES.tolist():
        out.append(y)
        for _ in range(4):
            v += h * (w * w * (g * u - y - k3 * y**3) - 0.1 * w * v)
            y += h * v
    return np.array(out) + off


def ringing(low: float, high: float, **added: float) -> tuple[Data, FunctionModel]:
    f = Parameter("f", LogUniform(low, high), "Hz", log=True)
    gain = Parameter("g", LogUniform(0.01, 10.0), "1", log=True, start=1.0)
    truth = ring({"f": 68.0, "g": 1.0, **added}, SAMPLES)
    values = truth + QUIET * np.random.default_rng(1).standard_normal(len(SAMPLES))
    data = Data(SAMPLES, values, labels=["y"], units=["V"])
    return data, FunctionModel(ring, (f, gain), Outputs(("y",), SAMPLES), "ring")


def test_a_resonance_far_from_the_priors_median_is_found() -> None:
    data, model = ringing(10.0, 200.0, k3=1.0)
    found = told(data, model, [CUBIC])
    assert found.cause == ["cubic"]
    assert found.causes[0].estimates[0].mean == pytest.approx(1.0, abs=0.05)
    assert found.file.base_parameters["over all sets"]["f"].mean == pytest.approx(68.0, abs=0.5)


def test_a_best_fit_that_is_hardly_one_is_warned_of() -> None:
    _, model = ringing(30.0, 120.0)
    values = np.sin(2 * np.pi * 17.3 * SAMPLES) + QUIET * np.random.default_rng(0).standard_normal(400)
    unlike = Data(SAMPLES, values, labels=["y"], units=["V"])
    assert any("hardly more than a constant would" in text for text in told(unlike, model, []).file.warnings)


def test_a_fast_discrepancy_is_gap_and_not_noise() -> None:
    data, model = ringing(30.0, 120.0, k3=4.0, off=-0.005)
    found = told(data, model, [CUBIC, OFFSET])
    gap = found.file.gap
    assert set(found.cause) == {"cubic", "offset"}
    assert gap.before**2 + gap.noise_floor**2 == pytest.approx(gap.residual_rms_before**2, rel=0.02)
    assert gap.noise_floor == pytest.approx(QUIET, rel=0.1)
    assert gap.after < QUIET
    alone = next(row for row in found.table if not row.causes)
    assert alone.gap_after == pytest.approx(gap.before, rel=0.02)


# -- a cause that switches every sample or two -----------------------------------------------------


def test_a_second_cause_that_is_fast_is_found() -> None:
    t = np.arange(400.0)
    switch = np.sign(np.sin(2.2 * t))

    def both(c, times):  # type: ignore[no-untyped-def]
        smooth = c["a"] + c["b"] * np.sin(t / 30) + c.get("slow", 0.0) * np.sin(t / 11) ** 2
        return smooth + c.get("fast", 0.0) * switch

    effects = [adds(name, name, "V", 1.0, -10.0, 10.0, 0.5, -0.5) for name in ("slow", "fast")]
    parameters = (Parameter("a", Normal(0, 10), "V"), Parameter("b", Normal(0, 10), "V"))
    true = {"a": 1.0, "b": 2.0, "slow": 4.0, "fast": 0.3}
    y = both(true, t) + 0.1 * np.random.default_rng(0).standard_normal(400)
    model = FunctionModel(both, parameters, Outputs(("y",), t))
    found = told(Data(t, y, labels=["y"], units=["V"]), model, effects)
    assert set(found.cause) == {"slow", "fast"}
    for one in found.causes:
        assert one.probability > 0.99
        [size] = one.estimates
        assert abs(size.mean - true[one.name]) < 4 * size.sd < 0.1


# -- a cup whose steps are long: its error is not taken for a cause -----------------------------------


def steps(per_sample: int):  # type: ignore[no-untyped-def]
    """The cup by the midpoint rule, of second order."""

    def cooled(c, t):  # type: ignore[no-untyped-def]
        step = np.diff(t, prepend=0.0) / per_sample
        factors = 1.0 - c["rate"] * step + 0.5 * (c["rate"] * step) ** 2
        return c["start"] * np.cumprod(factors**per_sample) + c.get("drift", 0.0) * t

    return cooled


SPARSE = np.cumsum(np.linspace(1.0, 5.0, 24))
COARSE = cups(steps(1), SPARSE)
MENDED = replace(COARSE, finer=steps(2))


def test_long_steps_are_told_by_half_of_them() -> None:
    """At the point where they are, the error of second order is gone; nearby it is less."""
    model = SearchModel(MENDED, (), spectral_errors(sparse()).bind(sparse()))
    u = np.array([np.log(0.06), 61.0])
    mended = model.corrected(u)
    for rate, least in ((0.06, 30.0), (0.066, 3.0)):
        exact = cup({"rate": rate, "start": 61.0}, SPARSE)
        at = np.array([np.log(rate), 61.0])
        own, less = (np.abs(one.series(at)[0] - exact).max() for one in (model, mended))  # type: ignore[index]
        assert less * least < own
    assert mended.corrected(u).model.key == mended.model.key  # of the plain model, not of what is mended
    assert mended.model.key != model.model.key
    elsewhere = Outputs(("tea",), SPARSE[:5])
    np.testing.assert_array_equal(mended.series(u, elsewhere), mended.series(u)[:, :5])  # type: ignore[index]


def sparse(noise: float = 0.003) -> Data:
    values = cup({"rate": 0.06, "start": 61.0}, SPARSE)
    values = values + noise * np.random.default_rng(4).standard_normal(len(SPARSE))
    return Data(SPARSE, values, labels=["tea"], units=["K"], time_unit="min")


@pytest.mark.filterwarnings("ignore:effect steam")
def test_the_error_of_long_steps_is_no_cause() -> None:
    """It is six times the noise, and stays where there are no finer steps."""
    assert told(sparse(), MENDED).cause == []
    assert told(sparse(), MENDED).file.gap.before < 0.003
    coarse = told(sparse(), COARSE)
    assert coarse.file.gap.before > 0.01
    assert "which a simulator's numerics may make" in str(coarse)
    assert "numerics" not in str(told(sparse(), MENDED))


def test_an_effect_is_sought_together_with_the_parameters() -> None:
    """With this much steam the cup alone cools four times too fast, and beside that rate steam is nothing."""
    search = told(tea(steam=8e-3)).sets.search
    [end] = [point for (i,), point in search.ends.items() if search.causes[i].name == "steam"]
    assert np.exp(search.base.u[0]) > 3.5 * 0.06
    np.testing.assert_allclose([np.exp(end.u[0]), end.u[2]], [0.06, 8e-3], rtol=0.1)


# -- what a control engineer met ------------------------------------------------------------------------


@zoo.effect("drag", size=1.0, low=0.0)
def drag(c, size):  # type: ignore[no-untyped-def]
    """By the square of the speed."""
    return {**c, "drag": size}


def cart(c, t):  # type: ignore[no-untyped-def]
    """Speed by steps from one time to the next, pushed one way and the other."""
    v = np.zeros(len(t))
    for i in range(1, len(t)):
        push = np.sign(np.sin(2 * np.pi * 0.1 * t[i]))
        v[i] = v[i - 1] + (t[1] - t[0]) * (
            push - c["b"] * v[i - 1] - c.get("drag", 0.0) * v[i - 1] * abs(v[i - 1])
        )
    return v


T = np.linspace(0.0, 30.0, 300)
CART = {"b": zoo.Normal(0.5, 0.1)}


def speed(noise: float = 0.02, **changes: float) -> np.ndarray:
    return cart({"b": 0.5, **changes}, T) + noise * np.random.default_rng(2).standard_normal(len(T))


def noting(seen: set[int]) -> Any:
    """The cart, which notes at how many times it is called."""

    def spied(c, t):  # type: ignore[no-untyped-def]
        seen.add(len(t))
        return cart(c, t)

    return spied


def test_a_simulator_is_called_at_all_times_also_where_nothing_was_measured() -> None:
    """One that steps from time to time would be another one at times of which some are left out."""
    seen: set[int] = set()
    measured, spied = speed(drag=0.8), noting(seen)
    measured[100:120] = np.nan
    measured[[1, 50, 51]] = np.nan
    with pytest.warns(UserWarning, match="23 of 300 times are left out"):
        found = zoo.diagnose(T, measured, spied, CART, drag, progress=False)
    assert seen == {300}
    assert found.cause == ["drag"]
    [size] = found.causes[0].estimates
    assert abs(size.mean - 0.8) < 3 * size.sd < 0.2
    later = found.predict(zoo.Outputs(("y0",), np.linspace(0.0, 35.0, 351)), draws=4)
    assert len(later) == 351


@pytest.mark.parametrize("asked", ["all", "left"])
def test_data_and_a_model_are_of_all_times_too(asked: str) -> None:
    seen: set[int] = set()
    measured, spied = speed(drag=0.8), noting(seen)
    measured[100:120] = np.nan
    with pytest.warns(UserWarning, match="20 of 300 times are left out"):
        data = Data(T, measured)
    outputs = zoo.Outputs(("y0",), T if asked == "all" else data.times)
    parameters = tuple(zoo.Parameter(name, prior) for name, prior in CART.items())
    found = zoo.diagnose(data, zoo.FunctionModel(spied, parameters, outputs), drag, progress=False)
    assert seen == {300}
    assert found.cause == ["drag"]


def test_an_effect_that_always_fails_is_told_with_the_reason_and_decides_nothing() -> None:
    def stiff(c, t):  # type: ignore[no-untyped-def]
        if "drag" in c:
            raise RuntimeError("mode stiff knows no drag")
        return cart(c, t)

    found = zoo.diagnose(T, speed(0.005, drag=0.8), stiff, CART, [drag], progress=False)
    assert not found.file.decided
    told = "effect drag: the simulator failed at each of its starts (RuntimeError: mode stiff knows no drag)"
    assert any(told in warning for warning in found.file.warnings)
    assert any("drag could not be tried" in warning for warning in found.file.warnings)


def test_what_was_not_solved_is_not_called_improbable() -> None:
    """The best parameters with drag cannot be solved: the set with it is more probable, but unverified."""

    def narrow(c, t):  # type: ignore[no-untyped-def]
        if c["b"] < 0.6:
            raise SolveError("b too small")
        return cart(c, t)

    found = zoo.diagnose(T, speed(drag=0.8), narrow, {"b": zoo.Normal(0.9, 0.3)}, [drag], progress=False)
    assert not found.file.decided or found.cause == ["drag"]
    assert "odds 0" not in str(found)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ((T, speed(), cart, CART, [cart]), "is no effect; give a list of functions that are decorated with"),
        ((T, speed(), lambda c, t: cart(c, t)[:, None], CART, [drag]), "wanted .1, 300.; give its transpose"),
        ((T, np.stack([speed()] * 2, axis=1), cart, CART, [drag]), "as values.T has"),
    ],
)
def test_a_slip_is_told_with_what_to_change(arguments: tuple, told: str) -> None:  # type: ignore[type-arg]
    with pytest.raises((DiagnosisError, DataError), match=told):
        zoo.diagnose(*arguments, progress=False)
    with pytest.raises(DataError, match=r"units = 'm/s': give a list, such as \['m/s'\]"):
        zoo.diagnose(T, speed(), cart, CART, [drag], units="m/s", progress=False)


def test_what_changes_nothing_is_no_cause_of_a_misfit() -> None:
    """Nothing is sought beside its discrepancy as every other set is: else what does nothing would win."""
    faint = adds("faint", "drift", "1", 1.0, -5.0, 5.0, 1.0)

    def hardly(c, t):  # type: ignore[no-untyped-def]
        return cup({**c, "drift": 1e-6 * c.get("drift", 0.0)}, t)

    found = told(tea(steam=8e-3), cups(hardly), [faint])
    assert found.cause == []
    assert found.file.verdict.startswith("No listed cause explains the model error")


@pytest.mark.filterwarnings("ignore:effect steam")
@pytest.mark.parametrize("error", [SolveError("too fine"), ZeroDivisionError("0 steps"), None])
def test_a_finer_simulator_that_fails_leaves_the_own(error: Exception | None) -> None:
    def fails(c, t):  # type: ignore[no-untyped-def]
        if error is None:
            return np.full_like(t, np.nan)
        raise error

    model = replace(COARSE, finer=fails)
    found, plain = (told(sparse(), one) for one in (model, COARSE))
    assert found.file.gap.before == pytest.approx(plain.file.gap.before, rel=1e-6)


def test_solves_with_half_the_steps_are_kept_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[bool] = []
    solve = FunctionModel.solve

    def counting(self, configuration, outputs=None):  # type: ignore[no-untyped-def]
        calls.append(self.finer is None)
        return solve(self, configuration, outputs)

    monkeypatch.setattr(FunctionModel, "solve", counting)
    settings = {"cores": 1, "checkpoint": tmp_path / "kept", "progress": False}
    first = diagnose(sparse(), MENDED, [DRIFT], **settings)  # type: ignore[arg-type]
    assert sum(calls) > 0
    assert first.file.record["solves"] >= len(calls) - 10  # preflight asks without a store
    again = len(calls)
    diagnose(sparse(), MENDED, [DRIFT], **settings)  # type: ignore[arg-type]
    assert not any(calls[again:])


def test_an_amplitude_without_an_upper_bound_counts_from_nothing() -> None:
    steam = adds("steam", "steam", "1/(min K)", 1e-3, 0.0, np.inf, 3e-4, 1e-3)
    [size] = told(tea(steam=6e-4), effects=[steam]).causes[0].estimates
    assert abs(size.mean - 6e-4) < 3 * size.sd < 1e-4


# -- what a statistician doubted --------------------------------------------------------------------------


def wave(noise: float = 0.05, **true: float) -> Data:
    t = np.arange(64) * 0.15
    values = swing({"a": 2.0, "b": 0.0, **true}, t)
    values = values + noise * np.random.default_rng(30).standard_normal(len(t))
    return Data(t, values, labels=["x"], units=["m"])


def swing(c, t):  # type: ignore[no-untyped-def]
    return c["a"] * np.sin((3.0 + c.get("faster", 0.0)) * (t - c.get("late", 0.0))) + c["b"]


SWING = FunctionModel(
    swing,
    (Parameter("a", Normal(2.0, 0.5), "m"), Parameter("b", Normal(0.0, 0.5), "m")),
    Outputs(("x",), np.arange(64) * 0.15),
    "swing",
)


@pytest.mark.parametrize(("name", "true"), [("faster", 0.5), ("late", 1.0)])
def test_a_start_that_is_the_truth_is_not_missed(name: str, true: float) -> None:
    """The baseline alone has hardly any amplitude, and does not tell what one would do beside the effect."""
    found = told(wave(**{name: true}), SWING, [adds(name, name, "1", 1.0, -10.0, 10.0, true)])
    assert found.cause == [name]
    [size] = found.causes[0].estimates
    assert abs(size.mean - true) < 4 * size.sd < 0.02
    assert found.file.base_parameters["leading set"]["a"].mean == pytest.approx(2.0, abs=0.05)


def test_a_parameter_far_outside_its_prior_is_named() -> None:
    found = told(wave(a=4.2), SWING, [])
    assert any(
        re.search(r"as if nothing were missing, a = 4.\d* is far outside its prior", w)
        for w in found.file.warnings
    )
    assert not any("outside its prior" in w for w in told(wave(a=3.0), SWING, []).file.warnings)


def test_what_a_simulator_rounds_is_not_decided() -> None:
    """Small steps of the parameters change nothing; where the data are far coarser, that does not matter."""

    def whole(c, t):  # type: ignore[no-untyped-def]
        return np.round(cup(c, t)).astype(int)

    def finer(c, t):  # type: ignore[no-untyped-def]
        return np.round(1000.0 * cup(c, t)).astype(int)

    priors = {"rate": zoo.Uniform(0.01, 0.2), "start": zoo.Uniform(40.0, 90.0)}
    values, settings = tea(steam=6e-5).values, {"progress": False, "cores": 1}
    found = zoo.diagnose(MINUTES, values, whole, priors, [STEAM], **settings)
    assert found.file.verdict.startswith("Not decided, see the warnings.")
    assert found.file.warnings[0].startswith("the simulator gives whole numbers for y0")
    found = zoo.diagnose(MINUTES, 1000.0 * values, finer, priors, [STEAM], **settings)
    assert not any("whole numbers" in text for text in found.file.warnings)


def test_a_baseline_farther_away_than_the_data_vary_is_said_not_to_fit() -> None:
    """A noise that is free may be so large that it explains even that."""
    values = np.random.default_rng(3).standard_normal(40)
    level = {"level": zoo.Normal(14.0, 0.01)}
    found = zoo.diagnose(np.arange(40.0), values, lambda c, t: c["level"] + 0.0 * t, level, progress=False)
    text = "The baseline does not fit the data: a constant would be nearer to them. Nothing is missing"
    assert found.file.verdict.startswith(text)
    near = {"level": zoo.Normal(2.0, 0.01)}
    found = zoo.diagnose(np.arange(40.0), values, lambda c, t: c["level"] + 0.0 * t, near, progress=False)
    assert any("of their range: check" in text for text in found.file.warnings)
    assert "does not fit" not in found.file.verdict


def test_a_known_noise_is_that_of_the_errors() -> None:
    values = tea(steam=6e-4).values
    settings = {"labels": ["tea"], "progress": False, "cores": 1}
    first, *others = [
        zoo.diagnose(MINUTES, values, cup, PRIOR_BY_NAME, [STEAM], **given, **settings)
        for given in ({"errors": zoo.Cosines(known={"tea": 0.3})}, {"noise": 0.3}, {"noise": {"tea": 0.3}})
    ]
    assert first.file.gap.noise_floor == pytest.approx(0.3, rel=0.05)
    assert all(one.table == first.table for one in others)
