"""What `zoo.diagnose` gives can draw itself, and nothing below the figures knows them."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy import stats

import zoo
from zoo import front
from zoo.core.components import ComponentError
from zoo.core.data import Data
from zoo.core.diagnosis import Diagnosis


def test_a_diagnosis_draws_itself(one: Diagnosis, sampled: Diagnosis) -> None:
    assert zoo.diagnose is front.diagnose
    for d in (one, sampled):
        figure = d.plot()
        assert isinstance(figure, Figure)
        figure.canvas.draw()
        assert any(
            d.file.verdict[:30] in t.get_text() for t in figure.findobj(lambda a: hasattr(a, "get_text"))
        )


def test_the_front_takes_studies_names_and_other_data(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zoo.blood.study_diagnosis.diagnose", lambda *given, base: ("study", given, base))
    study = zoo.load_study("demo")
    assert front.diagnose(study, base="B") == ("study", (study,), "B")
    what, [loaded], base = front.diagnose("demo", base="B")
    assert (what, loaded.checksum, base) == ("study", study.checksum, "B")
    monkeypatch.setattr(front.diagnosis, "diagnose", lambda *given, states, hooks, seed: (given, seed))
    data = Data(study.time_s, study.values)
    assert front.diagnose(data, "model", [], seed=3) == ((data, "model", []), 3)
    with pytest.raises(TypeError, match=r"diagnose: setting 'sed': unknown; did you mean 'seed'\?"):
        front.diagnose(data, "model", [], sed=3)
    with pytest.raises(TypeError, match="setting 'bse': unknown; did you mean 'base'"):
        front.diagnose(study, bse="B")


# -- a cart that is pushed, in the short way ---------------------------------------------------------

TIMES = np.arange(0.0, 20.0, 0.05)
PRIORS = {"b": zoo.Normal(2.0, 0.1), "m": zoo.Parameter("m", zoo.Normal(5.0, 0.1), "kg")}


def cart(parameters: dict[str, Any], times: Any, push: float = 20.0) -> Any:
    """Velocity (n,) in m/s: linear friction b, and whatever is in `friction`."""
    v, found, step = 0.0, [], times[1] - times[0]
    for now in times:
        found.append(v)
        force = push * np.sin(1.1 * now) * (1.0 + 0.3 * np.sin(0.2 * now)) - parameters.get("slope", 0.0)
        v += step * (force - parameters["b"] * v - float(parameters["friction"](v))) / parameters["m"]
    return np.array(found)


def hard(parameters: dict[str, Any], times: Any) -> Any:
    """The cart, pushed harder."""
    return cart(parameters, times, 26.0)


def true_friction(v: Any) -> Any:
    """Friction that no parameter of the baseline has, N."""
    return 0.8 * v * np.abs(v)


def recorded(simulate: Any, seed: int) -> Any:
    truth = simulate({"b": 2.0, "m": 5.0, "friction": true_friction}, TIMES)
    return truth + 0.01 * np.random.default_rng(seed).standard_normal(len(TIMES))


@zoo.effect("slope", unit="N", size=1.0)
def slope(parameters: dict[str, Any], size: float) -> dict[str, Any]:
    """The cart stands on a slope."""
    return {**parameters, "slope": size}


def test_any_function_is_diagnosed_and_a_free_function_of_it_is_learned() -> None:
    friction = zoo.free_function("friction", along="velocity", size=5.0, unit="N", along_unit="m/s")
    found = zoo.diagnose(
        TIMES, recorded(cart, 1), cart, PRIORS, [slope, friction], labels=["v"], units=["m/s"],
        held_out={"pushed harder": (TIMES, recorded(hard, 2), hard)}, cores=1,
    )  # fmt: skip
    assert found.cause[0].startswith("friction")
    headline = r"Most likely missing: friction as a learned function of velocity, .* N at .* m/s \(>99"
    assert re.match(headline, found.file.verdict)
    probability = {c.name: c.probability for c in found.components}
    assert probability["friction"] > 0.99
    assert probability["slope"] < 0.5
    learned = found.components[0].functions[0]
    assert (learned.argument, learned.argument_unit, learned.unit) == ("velocity", "m/s", "N")
    low, high = (np.array(x) for x in (learned.low, learned.high))
    v = np.array(learned.values)
    fastest = float(np.abs(recorded(cart, 1)).max())
    assert fastest < v[-1] < 1.5 * fastest  # the points span the velocities of the baseline
    reached = np.abs(v) < fastest
    assert np.all((low <= true_friction(v))[reached] & (true_friction(v) <= high)[reached])
    [state] = found.file.states
    assert state.state == "pushed harder"
    assert state.carried[0].error.mean < 0.5 * state.baseline.mean
    drawn = [axes for axes in found.plot().axes if axes.get_xlabel() == "velocity (m/s)"]
    assert [axes.get_ylabel() for axes in drawn] == ["friction (N)"]


def test_a_free_function_that_the_simulator_never_asks_for_is_told() -> None:
    unused = zoo.free_function("wind", along="velocity", size=5.0)
    still = zoo.free_function("friction", along="velocity", size=5.0)
    values = recorded(cart, 1)
    with pytest.raises(ComponentError, match=r"friction: .* let it add parameters\['friction'\]\(x\)"):
        zoo.diagnose(TIMES, values, lambda c, t: c["b"] * t + c["friction"](0.0), PRIORS, [still])
    with pytest.raises(ComponentError, match="wind: the simulator asks for it at no more than one value"):
        zoo.diagnose(TIMES, values, lambda c, t: c["b"] * t + c["m"], PRIORS, [unused])


def test_a_frozen_distribution_of_scipy_is_a_prior() -> None:
    """As the same prior of zoo: what is found is the same to the precision of its differences."""
    truth = cart({"b": 2.0, "m": 5.0, "friction": np.zeros_like, "slope": 0.5}, TIMES)
    values = truth + 0.01 * np.random.default_rng(3).standard_normal(len(TIMES))

    def plain(c: dict[str, Any], times: Any) -> Any:
        return cart({**c, "friction": np.zeros_like}, times)

    ours = {"b": zoo.Normal(2.0, 0.1), "m": zoo.Normal(5.0, 0.1)}
    theirs = {"b": stats.norm(2.0, 0.1), "m": stats.norm(loc=5.0, scale=0.1)}
    one, other = (zoo.diagnose(TIMES, values, plain, priors, [slope], cores=1) for priors in (ours, theirs))
    assert one.cause == other.cause == ["slope"]
    assert other.causes[0].estimates[0].mean == pytest.approx(one.causes[0].estimates[0].mean, rel=1e-4)
    assert other.table[0].log_evidence == pytest.approx(one.table[0].log_evidence, abs=0.01)
    with pytest.raises(zoo.ParameterError, match="or a frozen continuous distribution of SciPy"):
        zoo.diagnose(TIMES, values, plain, {"b": 2.0, "m": 5.0}, [slope])
    alone = zoo.diagnose(TIMES, values, plain, ours, slope, cores=1)  # one effect needs no list
    assert alone.table[0].log_evidence == one.table[0].log_evidence
    with pytest.raises(zoo.DiagnosisError, match="is no effect; give a list of functions"):
        zoo.diagnose(TIMES, values, plain, ours, [plain])  # type: ignore[list-item]
    with pytest.raises(TypeError, match="missing a required argument: 'priors'"):
        zoo.diagnose(TIMES, values, plain)  # type: ignore[call-overload]
    with pytest.raises(zoo.ParameterError, match="prior 'b' is of a parameter named 'm'"):
        zoo.diagnose(TIMES, values, plain, {"b": PRIORS["m"]}, [slope])


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
