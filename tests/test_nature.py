"""Simulators of nature's cases beside conservation and closed forms, and their rivals beside the lists."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from benchmarks.nature import CASES, durance, falling_balls, pig_aorta
from benchmarks.nature.other_tools import Record, Series
from benchmarks.nature.other_tools import __main__ as other_tools
from benchmarks.nature.other_tools.gaussian_process import fit_jointly
from benchmarks.nature.scoring import Case, even, score

import tanks
import zoo

OURS = {
    "durance": durance.RIVALS,
    "pig-aorta": pig_aorta.RIVALS,
    "falling-balls": falling_balls.RIVALS,
    "cascaded-tanks": tanks.EFFECTS,
}


@pytest.mark.parametrize("case", OURS)
def test_rivals_are_those_that_were_written_down(case: str) -> None:
    assert {one.name for one in OURS[case]} == set(CASES[case]["rivals"])


def catchment(years: int = 12) -> durance.Catchment:
    """Made-up weather: rain all the year, frost in winter."""
    days = pd.date_range("1999-01-01", periods=365 * years)
    rng, year = np.random.default_rng(3), 2.0 * np.pi * np.arange(len(days)) / 365.25
    table = pd.DataFrame(index=days)
    table["precipitation_mm"] = rng.exponential(3.0, len(days))
    table["temperature_degC"] = 5.0 - 12.0 * np.cos(year)
    table["potential_evapotranspiration_mm"] = 1.0 - np.cos(year)
    return durance.Catchment(table, np.array([-800.0, -300.0, 0.0, 200.0, 500.0]))


BASE = {"fast": 5.0, "slow": 60.0, "share": 0.4}


@pytest.mark.parametrize("more", [{}, {"snow": 1.0}, {"third": 0.4}, {"frozen": 0.8}])
def test_no_water_is_made_or_lost(more: dict[str, float]) -> None:
    here = catchment()
    runoff, packs = here.daily(BASE | more)
    water = (here.table["precipitation_mm"] - here.table["potential_evapotranspiration_mm"]).to_numpy()
    stored = 1500.0 if more.get("third") else 100.0  # what the reservoirs may hold, in mm
    assert abs(runoff.sum() + packs[-1].mean() - water.sum()) < stored
    assert runoff.sum() == pytest.approx(water.sum(), rel=0.06)


def test_snow_lies_where_it_is_cold_and_longest_on_top() -> None:
    _, packs = catchment().daily(BASE | {"snow": 1.0})
    assert np.all(np.diff((packs > 0.0).mean(axis=0)) > 0.0)
    assert np.all(packs.min(axis=0) == 0.0)


def test_the_windkessel_is_that_of_its_differential_equation() -> None:
    """C d(P - R1 Q)/dt = Q - (P - R1 Q) / R2."""
    n, period = 400, 0.8
    t = np.arange(n) * period / n
    flow = 60.0 + 40.0 * np.sin(2 * np.pi * t / period) + 20.0 * np.cos(4 * np.pi * t / period)
    c = {"R1": 0.05, "R2": 1.0, "C": 1.3}
    beyond = pig_aorta.windkessel(period, flow)(c, t) - c["R1"] * flow
    slope = (np.roll(beyond, -1) - np.roll(beyond, 1)) / (2 * period / n)
    np.testing.assert_allclose(c["C"] * slope, flow - beyond / c["R2"], atol=0.05)


def test_a_flow_that_is_late_is_as_a_pressure_that_is_early() -> None:
    n, period = 256, 0.8
    t = np.arange(n) * period / n
    flow = 60.0 + 40.0 * np.sin(2 * np.pi * t / period)
    simulate, c = pig_aorta.windkessel(period, flow), {"R1": 0.05, "R2": 1.0, "C": 1.3}
    a, b = (simulate(c | late, t) for late in ({"flow_late": 0.026}, {"pressure_late": -0.026}))
    np.testing.assert_allclose(a, b, atol=1e-9)
    assert np.abs(a - simulate(c, t)).max() > 0.5


def case(right: tuple[str, ...]) -> Case:
    t = np.linspace(0.0, 1.0, 5)
    return Case("ball", t, t, falling_balls.fall, falling_balls.PRIORS, falling_balls.RIVALS, right)


def test_a_method_is_scored_on_the_sets_that_hold_a_right_cause() -> None:
    """0.5 + 0.2 by hand for drag, 0.1 for nothing; the constant answer has two, and one, of twelve sets."""
    stated = {("linear-drag",): 0.5, ("bounce", "quadratic-drag"): 0.2, ("bounce",): 0.2, (): 0.1}
    found = score(lambda _: stated, [case(("linear-drag", "quadratic-drag")), case(())])
    assert found["log_score"].to_numpy() == pytest.approx(np.log([0.7, 0.1]))
    assert found["log_score_of_even"].to_numpy() == pytest.approx(np.log([2 / 12, 1 / 12]))


def test_no_floor_saves_a_method_that_excludes_the_truth() -> None:
    assert score(lambda _: {(): 1.0}, [case(("bounce",))])["log_score"].item() == -np.inf


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ({("drag",): 1.0}, "drag is none of its rivals"),
        ({("bounce",): 1.2, (): -0.2}, "give a probability from 0 to 1"),
        ({("bounce",): 0.4}, "add up to 0.4: make it 1"),
    ],
)
def test_what_is_no_probability_is_refused(stated: dict[tuple[str, ...], float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        score(lambda _: stated, [case(())])
    assert sum(even(case(())).values()) == pytest.approx(1.0)


def test_the_page_has_the_tables_of_other_tools_as_they_were_stored() -> None:
    page = Path(__file__).parents[1] / "docs" / "nature.md"
    assert other_tools.tables(json.loads(other_tools.RESULTS.read_text("utf-8"))) in page.read_text("utf-8")


def test_a_tool_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pysindy", None)
    monkeypatch.delitem(sys.modules, "benchmarks.nature.other_tools.residual_sindy", raising=False)
    with pytest.raises(SystemExit, match=r"pysindy is not installed, .*pip install .*requirements.txt"):
        other_tools.main(["--tools", "residual_sindy"])


def test_the_joint_fit_of_a_gaussian_process_is_that_of_linear_algebra() -> None:
    """For a linear simulator: generalized least squares, and kriging of what is left, by Matern's formula."""
    t, later = np.linspace(0.0, 1.0, 30), np.linspace(0.02, 1.1, 17)
    priors = {name: zoo.Parameter(name, zoo.Normal(1.0, 2.0)) for name in "ab"}

    def line(c: Mapping[str, Any], at: np.ndarray) -> np.ndarray:
        return np.asarray(c["a"] + c["b"] * at)

    y = 2.0 + 3.0 * t + 0.5 * np.sin(6.0 * t) + 0.05 * np.random.default_rng(1).standard_normal(30)
    first, second = (Series(x, y, line, lambda _, x=x: x[:, None]) for x in (t, later))
    record = Record("line", "1", first, second, priors, ("time",), y, True, lambda: y)
    mode, conditional = fit_jointly(record)
    size, length, noise = (float(np.squeeze(mode[name])) for name in ("delta", "lengths", "noise"))

    def matern(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        d = np.sqrt(5.0) * np.abs(a[:, None] - b[None, :]) / (length * t.std())
        return np.asarray(size**2 * (1.0 + d + d**2 / 3.0) * np.exp(-d))

    weight = np.linalg.inv(matern(t, t) + noise**2 * np.eye(30))
    slopes = 2.0 * np.column_stack([np.ones(30), t])  # along standard normal quantiles of the priors
    left = y - (1.0 + t)
    u = np.linalg.solve(slopes.T @ weight @ slopes + np.eye(2), slopes.T @ weight @ left)
    assert [float(mode["a"]), float(mode["b"])] == pytest.approx(u, abs=2e-3)
    at_mode = left - slopes @ [mode["a"], mode["b"]]
    np.testing.assert_allclose(conditional(y), matern(later, t) @ weight @ at_mode, atol=1e-4)
