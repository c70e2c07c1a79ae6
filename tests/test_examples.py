"""The examples of docs/bring-your-own-simulator.md, and the page itself: what they solve and find."""

from __future__ import annotations

import ast
import re
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import oscillator
import tanks
import zoo
from zoo.core.data import Data
from zoo.core.diagnosis.coordinates import SearchModel
from zoo.core.diagnosis.search import Search
from zoo.core.effects import EffectParameter, Location, effect, with_effects
from zoo.core.errors.spectral import Cosines
from zoo.core.forward import FunctionModel, Outputs, from_pints
from zoo.core.parameters import Parameter, Uniform

ROOT = Path(__file__).resolve().parents[1]
U = 2.8 + 2.0 * np.sin(0.02 * np.arange(400)) + 0.8 * np.sin(0.11 * np.arange(400))
THETA = np.array([0.05, 0.06, 0.045, 4.0, 5.0])


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.name)
def test_the_examples_know_no_blood(path: Path) -> None:
    used = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] == "zoo":
            assert node.module == "zoo"
            used |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "zoo":
            used.add(node.attr)
    assert used
    homes = {name: getattr(zoo, name).__module__ for name in used - {"fetch_file"}}
    assert not [name for name, home in homes.items() if home.startswith("zoo.blood")]


# ---------------------------------------------------------------------------------------------------
# the oscillator


@pytest.mark.parametrize(("cubic", "drag", "delay"), [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.3)])
def test_the_oscillator_solves_its_equation(cubic: float, drag: float, delay: float) -> None:
    w, z, g = 2.1, 0.06, 0.9

    def slope(t: float, y: Any) -> list[float]:
        x, v = y
        f = g * oscillator.force(np.asarray(t - delay))
        return [v, float(f) - 2 * z * w * v - drag * abs(v) * v - w * w * (x + cubic * x**3)]

    exact = solve_ivp(slope, (0, 60), [0, 0], t_eval=oscillator.TIMES, rtol=1e-9, atol=1e-10).y[0]
    added = [
        e.at()
        for e, value in zip(
            (*oscillator.EFFECTS, oscillator.delayed_drive), (cubic, drag, delay), strict=True
        )
        if value
    ]
    model = with_effects(oscillator.MODEL, added)
    found = model.solve(model.configure(np.array([w, z, g] + [x for x in (cubic, drag, delay) if x])))
    np.testing.assert_allclose(found[0], exact, atol=0.1 * oscillator.NOISE_M)


def test_a_drawn_case_is_its_seed_and_shows_its_cause() -> None:
    for cause, seed in product(("cubic-stiffness", "delayed-drive"), (1, 2)):
        case, again = (oscillator.draw_case(cause, np.random.default_rng(seed)) for _ in range(2))
        np.testing.assert_array_equal(case.data.values, again.data.values)
        assert case.withheld["gap"] >= oscillator.VISIBLE * oscillator.NOISE_M
        assert case.withheld["parameter"] > 0
    assert oscillator.draw_case("no-gap", np.random.default_rng(3)).withheld["gap"] < 1e-6


# ---------------------------------------------------------------------------------------------------
# the tanks


def solve(theta: Any, *added: Any) -> Any:
    model = with_effects(tanks.tanks(U), [made.at() for made, _ in added])
    return model.solve(model.configure(np.concatenate([theta, *(values for _, values in added)])))[0]


def reference(
    theta: Any, *, p1: float = 0.5, crack: float = 0.0, height: float = 0.0, k2: float = 0.0
) -> Any:
    """The tanks by another scheme, sample by sample; k2 as the benchmark writes it, k3 if absent."""
    k1, k3, k4, *x = (float(v) for v in theta)
    k2 = k2 or k3
    found = []
    for u in U:
        found.append(x[1])

        def slope(t: float, x: Any, u: float = u) -> list[float]:
            a, b = np.maximum(x, 0)
            outlet = a**p1 * 5 ** (0.5 - p1)
            return [
                k4 * u - k1 * outlet - crack * np.sqrt(max(a - height, 0)),
                k2 * outlet - k3 * np.sqrt(b),
            ]

        x = solve_ivp(slope, (0, 4), x, rtol=1e-9, atol=1e-9).y[:, -1].tolist()
    return np.array(found)


def test_the_tanks_solve_their_equations() -> None:
    np.testing.assert_allclose(solve(THETA), reference(THETA), atol=1e-4)
    np.testing.assert_allclose(
        solve(THETA, (tanks.upper_exponent, [0.2])), reference(THETA, p1=0.7), atol=1e-4
    )
    np.testing.assert_allclose(
        solve(THETA, (tanks.upper_leak, [0.4, 5.0])), reference(THETA, crack=0.02, height=5.0), atol=1e-3
    )


def test_the_unit_of_the_upper_level_is_free() -> None:
    # the benchmark's four constants, x1 in units c times as large, are the three of the example
    c = 1.7
    k1, k3, k4, x1, x2 = THETA
    other = [k1 * np.sqrt(c), k3, k4 * c, x1 * c, x2]
    np.testing.assert_allclose(solve(THETA), reference(other, k2=k3 / np.sqrt(c)), atol=1e-4)


def test_water_is_kept() -> None:
    # what the pump brought, less what ran out of the lower tank, is in the tanks; and no rim is exceeded
    full = 6.0
    for share in (1.0, 0.0):
        y = solve(THETA, (tanks.upper_overflow, [1 / full, share]))
        out = 4.0 * np.sum(THETA[1] * np.sqrt(0.5 * (y[1:] + y[:-1])))
        brought = 4.0 * np.sum(THETA[2] * THETA[1] / THETA[0] * U[:-1])  # in the lower tank's volts
        stored = brought - out - (y[-1] - y[0])  # gain of the upper tank and what was lost
        if share == 1.0:
            assert -THETA[3] <= stored * THETA[0] / THETA[1] <= full - THETA[3] + 0.05
        else:
            assert stored > full, "the water beside the lower tank is lost"
    assert solve(THETA, (tanks.lower_overflow, [1 / 6.5])).max() == pytest.approx(6.5)
    assert solve(THETA, (tanks.sensor_saturation, [1 / 6.5])).max() == 6.5


@pytest.mark.parametrize("made", tanks.EFFECTS, ids=lambda e: e.name)
def test_every_effect_begins_at_the_baseline(made: Any) -> None:
    shapes = [p.start for p in made.parameters[1:]]
    base = solve(THETA)
    np.testing.assert_array_equal(solve(THETA, (made, [0.0, *shapes])), base)
    large = max(abs(made.parameters[0].low), made.parameters[0].high)
    assert np.abs(solve(THETA, (made, [large, *shapes])) - base).max() > 0.1
    tiny = 1e-9 * large
    np.testing.assert_allclose(solve(THETA, (made, [tiny, *shapes])), base, atol=1e-5)
    assert made.parameters[0].why
    assert made.equation


def test_a_gain_of_the_sensor_is_the_unit_of_the_levels() -> None:
    a = 0.1
    k1, k3, k4, x1, x2 = THETA
    s = 1 + a
    same = [k1 * np.sqrt(s), k3 * np.sqrt(s), k4 * s, x1 * s, x2 * s]
    np.testing.assert_allclose(solve(THETA, (tanks.sensor_gain, [a])), solve(same), atol=1e-6)


@pytest.mark.needs_data
def test_the_records_are_those_of_the_benchmark(data_dir: Path) -> None:
    table = tanks.read(data_dir / "cascaded-tanks" / "dataBenchmark.csv")
    assert {name: column.shape for name, column in table.items()} == dict.fromkeys(
        ("uEst", "uVal", "yEst", "yVal"), (1024,)
    )
    assert table["uVal"][0] == 0.97619
    assert table["yEst"].max() == table["yVal"].max() == 10.0


# ---------------------------------------------------------------------------------------------------
# what a model of one's own needs of the core


def test_effects_that_differ_in_a_constant_differ_in_their_keys() -> None:
    def made(factor: float) -> Any:
        @effect("leak", parameters=[EffectParameter("rate", "1", 0.1, 0.0, 1.0, (0.1,))])
        def leak(c: Any, values: tuple[float, ...], at: Location) -> Any:
            """Leaks."""
            return {**c, "k": c["k"] * factor * values[0]}

        return leak

    t = np.linspace(0, 1, 5)
    line = FunctionModel(lambda c, t: c["k"] * t, (Parameter("k", Uniform(0, 2)),), Outputs(("y",), t))
    keys = [with_effects(line, [made(factor).at()]).key for factor in (2.0, 2.0, 3.0)]
    assert keys[0] == keys[1] != keys[2]


class Decay:
    """A model as PINTS has them: two counts and `simulate`."""

    def __init__(self, start: float) -> None:
        self.start = start

    def n_parameters(self) -> int:
        return 1

    def n_outputs(self) -> int:
        return 2

    def simulate(self, parameters: Any, times: Any) -> Any:
        one = self.start * np.exp(-parameters[0] * np.asarray(times))
        return np.column_stack([one, self.start - one])


def test_a_pints_model_is_a_forward_model() -> None:
    t = np.linspace(0.0, 2.0, 9)
    rate = Parameter("rate", Uniform(0.1, 5.0), "1/s")
    model = from_pints(Decay(2.0), t, [rate], labels=("left", "gone"))
    found = model.solve(model.configure([0.7]))
    np.testing.assert_allclose(found, [2 * np.exp(-0.7 * t), 2 - 2 * np.exp(-0.7 * t)])
    assert model.outputs.series == ("left", "gone")
    assert model.name == "Decay"
    assert model.key != from_pints(Decay(3.0), t, [rate], labels=("left", "gone")).key
    with pytest.raises(ValueError, match="2 parameters for 1: give one for each"):
        from_pints(Decay(2.0), t, [rate, rate])


# ---------------------------------------------------------------------------------------------------
# the page


def test_the_page_runs_from_top_to_bottom(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (ROOT / "docs" / "bring-your-own-simulator.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "page"}
    for code in re.findall(r"^```python\n(.*?)^```", text, flags=re.S | re.M):
        exec(compile(code, "bring-your-own-simulator.md", "exec"), names)
    shown = re.findall(r"print\(\w+\.file\.verdict\)\n```\n\n```text\n(.*?)\n```", text, flags=re.S)
    assert len(shown) == 2
    assert capsys.readouterr().out.splitlines()[:2] == shown
    found = names["found"]
    assert found.cause == ["evaporation"]
    chance = {cause.name: cause for cause in found.causes}
    assert chance["late-thermometer"].probability < 2 * chance["late-thermometer"].prior_probability
    [rate] = found.causes[0].estimates
    assert rate.mean == pytest.approx(1e-5, abs=3 * rate.sd)
    assert (tmp_path / "diagnosis" / "diagnosis.json").is_file()
    rates = names["both"].file.base_parameters["over all sets"]
    for name, rate in (("k[large]", 1.0e-3), ("k[small]", 1.4e-3), ("room", 21.0)):
        low, high = rates[name].interval
        assert low < rate < high
    growth = names["growth"]
    assert growth.solve(growth.configure([0.1, 50.0])).shape == (1, 51)


def test_the_page_tells_how_many_effects_the_tanks_have() -> None:
    text = (ROOT / "docs" / "bring-your-own-simulator.md").read_text(encoding="utf-8")
    assert f"{len(tanks.EFFECTS)} rival effects" in text


# ---------------------------------------------------------------------------------------------------
# what is found


def test_a_search_with_fine_steps_ends_where_another_one_does() -> None:
    # an overflow of the upper tank from several starts, against scipy's trust-region reflective algorithm
    rng = np.random.default_rng(5)
    u = np.concatenate([U, 1.1 * U[::-1]])
    added = [tanks.upper_overflow.at()]
    truth = with_effects(tanks.tanks(u), added)
    theta = np.array([0.045, 0.05, 0.04, 5.0, 5.0, 1 / 9, 0.6])
    y = truth.solve(truth.configure(theta)) + 0.05 * rng.standard_normal((1, len(u)))
    forward = SearchModel(tanks.tanks(u), added, Cosines().bind(tanks.data(y[0])))
    S = np.full(len(u), 0.05**2)
    search = Search(forward, forward.errors.flat(y), S)

    def start(values: Any) -> Any:
        return np.array([p.coordinate(v) for p, v in zip(forward.parameters, values, strict=True)])

    def residual(x: Any) -> Any:
        computed = forward(x)
        assert computed is not None
        return (forward.errors.flat(y) - computed) / np.sqrt(S)

    costs = []
    for scale in (0.97, 1.04):
        point = search.refine(search.at(start(scale * theta)), 6, 15, fine=True)
        bounds = (forward.low, forward.high)
        other = least_squares(
            residual, start(scale * theta), bounds=bounds, x_scale=forward.units, diff_step=1e-4
        )
        costs += [0.5 * float(np.sum(residual(point.u) ** 2)), float(other.cost)]
    assert np.ptp(costs) < 1.0, "the log-likelihood, of which 1 is little"


def test_two_causes_of_one_record_are_one_set() -> None:
    rng = np.random.default_rng(2)
    both = with_effects(oscillator.MODEL, [one.at() for one in oscillator.EFFECTS])
    y = both.solve(both.configure(np.array([2.1, 0.05, 1.0, 0.15, 0.2])))
    y = y + 0.02 * rng.standard_normal((1, 241))
    found = oscillator.diagnosed(Data(oscillator.TIMES, y, labels=("displacement",), units=("m",)))
    assert set(found.cause) == {"cubic-stiffness", "quadratic-drag"}
    assert found.file.number[2] > 0.9
    assert found.file.gap.residual_rms_after == pytest.approx(oscillator.NOISE_M, rel=0.1)


@pytest.mark.slow
def test_causes_of_drawn_cases_are_found() -> None:
    score = oscillator.main({"cubic-stiffness": 4, "quadratic-drag": 4, "no-gap": 2, "delayed-drive": 1})
    assert score.by["kind"]["listed"]["first"].count >= 7
    assert score.by["kind"]["none"]["first"].share == 1
    assert score.by["kind"]["none"]["false_alarms"].count == 0


@pytest.mark.slow
@pytest.mark.needs_data
@pytest.mark.filterwarnings("ignore:effect .* changes no sample of tanks before")
@pytest.mark.parametrize(
    "effects",
    [
        (tanks.upper_overflow, tanks.sensor_saturation),
        pytest.param(tanks.EFFECTS, marks=pytest.mark.nightly),  # two minutes
    ],
    ids=["two", "all"],
)
def test_the_tanks_are_diagnosed_and_drawn(
    effects: tuple[Any, ...], data_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tanks, "EFFECTS", effects)
    record = tanks.read(data_dir / "cascaded-tanks" / "dataBenchmark.csv")
    found = tanks.diagnosed(record)
    errors = {
        name: tanks.rms(record["yVal"] - level)
        for name, level in tanks.predictions(found, record["uVal"]).items()
    }
    assert errors["baseline"] == pytest.approx(0.67, abs=0.02)
    assert found.file.verdict in tanks.report(found, record)
    tanks.figure(found, record, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
