"""Scores by component: of answers made by hand, and true functions against their formulas."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zoo.blood.baseline import get_baseline
from zoo.blood.blind.causes import CAUSES
from zoo.blood.blind.keys import other_key, own_key, read_key
from zoo.blood.blind.learned import Truth
from zoo.blood.blind.truths import Visited, true_functions
from zoo.blood.case import WAVE_SAMPLES, Case, simulate
from zoo.blood.study import load_study
from zoo.core.blindcheck import Answer, CaseKey, Explanation, score_answers, score_table
from zoo.core.blindcheck.answers import StatedComponent, StatedFunction, as_answer
from zoo.core.blindcheck.case_score import score_case
from zoo.core.blindcheck.component_rates import component_summary
from zoo.core.blindcheck.component_score import ComponentScore, score_components
from zoo.core.blindcheck.keys import TrueEffect
from zoo.core.diagnosis import read_diagnosis
from zoo.core.diagnosis.file import ComponentResult
from zoo.core.effects import EVERYWHERE
from zoo.core.parameters import pack, start_of

Array = Any
NAMES = ("inflow", "wall", "outlets", "sensor")


def answer(
    own: dict[str, float],
    groups: dict[str, int] | None = None,
    shares: dict[str, float] | None = None,
    functions: dict[str, tuple[StatedFunction, ...]] | None = None,
    **others: float,
) -> Answer:
    """An answer of components' probabilities, and of explanations that are none of them."""
    components = tuple(
        StatedComponent(
            name, p, (groups or {}).get(name, i), (shares or {}).get(name), (functions or {}).get(name, ())
        )
        for i, (name, p) in enumerate(sorted(own.items(), key=lambda x: -x[1]))
    )
    ranked = Answer.ranked({**own, **{name.replace("_", "-"): p for name, p in others.items()}})
    return replace(ranked, components=components, belongs={"tangent-wall": "wall", "taper": "geometry"})


def key(kind: str, *components: str, **more: Any) -> CaseKey:
    """A case with a cause in these components."""
    label = "+".join(components) or "no-gap"
    return CaseKey("a", kind, label, noise=0.05, before=0.2, components=components, **more)


def scored(k: CaseKey, a: Answer | None) -> ComponentScore:
    found = score_components(k, a, score_case(k, a))
    assert found is not None
    return found


def test_a_group_of_two_that_holds_the_truth_counts_and_one_of_three_does_not() -> None:
    p = {"inflow": 0.5, "wall": 0.3, "outlets": 0.1, "sensor": 0.05}
    two, three = {"inflow": 0, "wall": 0}, {"inflow": 0, "wall": 0, "outlets": 0}
    assert scored(key("component", "inflow"), answer(p, three)).found  # the leader itself is right
    assert scored(key("component", "wall"), answer(p, two)).found
    assert not scored(key("component", "wall"), answer(p, three)).found
    assert not scored(key("component", "outlets"), answer(p, two)).found
    one = scored(key("component", "wall"), answer(p, two, no_gap=0.05))
    assert one.log_score == pytest.approx(math.log(0.3))
    assert one.brier == pytest.approx(0.7**2 + 0.5**2 + 0.1**2 + 2 * 0.05**2)
    assert (one.leader, one.group, one.leader_right) == ("inflow", ("inflow", "wall"), False)


def test_a_wrong_cause_called_with_more_than_nine_tenths_is_counted() -> None:
    def wrong(k: CaseKey, a: Answer) -> bool:
        return scored(k, a).wrong_and_sure

    sure = {"inflow": 0.93, "wall": 0.05}
    assert wrong(key("component", "wall"), answer(sure))
    assert not wrong(key("component", "wall"), answer(sure, {"inflow": 0, "wall": 0}))
    assert not wrong(key("component", "inflow"), answer(sure))
    assert not wrong(key("component", "wall"), answer({"inflow": 0.89, "wall": 0.05}))
    assert wrong(key("none"), answer(sure))
    # a listed effect of another component, and one of the right component that leaves much
    listed = replace(
        answer({"geometry": 0.95, "wall": 0.02}, {"geometry": 0, "wall": 0}),
        explanations=(Explanation("taper", 0.94), Explanation("wall", 0.02)),
    )
    assert wrong(key("component", "wall"), listed)
    right = replace(
        answer({"wall": 0.98, "inflow": 0.02}),
        explanations=(Explanation("tangent-wall", 0.94), Explanation("wall", 0.04)),
    )
    k = key("component", "wall")
    case = score_case(k, right)
    for left, wanted in ((0.01, False), (0.03, True)):
        found = score_components(k, right, replace(case, left_true=left))
        assert found is not None
        assert found.wrong_and_sure is wanted


def test_pairs_are_found_by_share_where_there_is_one() -> None:
    p = {"inflow": 0.6, "wall": 0.2, "outlets": 0.1, "sensor": 0.1}
    pair = key("pair", "outlets", "sensor")
    assert (scored(pair, answer(p)).both, scored(pair, answer(p)).one) == (False, False)
    shares = {"inflow": 0.1, "wall": 0.05, "outlets": 0.4, "sensor": 0.45}
    assert scored(pair, answer(p, shares=shares)).both
    half = scored(pair, answer(p, shares={**shares, "sensor": 0.0}))
    assert (half.both, half.one) == (False, True)
    assert scored(pair, answer(p, {"inflow": 0, "outlets": 0, "wall": 1, "sensor": 1})).both
    assert (scored(pair, None).both, scored(pair, None).found) == (False, False)


def test_noise_is_recognised_as_none_or_in_the_leading_group() -> None:
    none = key("none")
    p = {"inflow": 0.01}
    assert scored(none, answer(p, no_gap=0.8, correlated_noise=0.1)).noise_recognised
    leading = answer({"sensor": 0.7, **p}, unlisted=0.7, correlated_noise=0.2)
    assert not scored(none, leading).noise_recognised
    assert scored(none, replace(leading, cause=("unlisted", "correlated-noise"))).noise_recognised
    found = scored(none, leading)
    assert found.log_score == pytest.approx(math.log(0.2))
    assert found.found is False


def test_a_band_is_compared_where_the_truth_is_known() -> None:
    at = np.arange(6.0)
    stated = StatedFunction(
        "law", at, 0 * at, 0 * at - 1, 0 * at + np.array([1, 1, 1, 1, 20, 20]), prior_sd=2.0, narrowed=2
    )
    a = answer({"wall": 0.9, "inflow": 0.1}, functions={"wall": (stated,)})
    true = np.array([0.5, 1.5, -0.9, math.nan, 3.0, -2.0])
    k = key("component", "wall", functions=lambda name, f: true if name == "wall" else None)
    learned = scored(k, a).learned
    assert learned is not None
    assert (learned.points, learned.held, learned.narrow, learned.narrow_held) == (5, 3, 3, 2)
    assert learned.width_over_prior == pytest.approx(2 / (4 * 1.96))
    assert learned.narrowed == 2
    assert scored(replace(k, functions=lambda name, f: None), a).learned is None
    summary = component_summary([scored(k, a)])
    assert summary["points_held"] == {"count": 3, "n": 5, "share": 0.6}
    assert summary["narrow_points_held"]["count"] == 2


def test_constant_answers_stand_beside_the_scores() -> None:
    """Equal frequencies of four components: the best constant's log score is that of a quarter."""
    keys = [replace(key("component", name, tags={"series": "one"}), case=name) for name in NAMES]
    good = {name: answer({n: 0.7 if n == name else 0.1 for n in NAMES}) for name in NAMES}
    score = score_answers(keys, good)
    found = score.components
    assert found["component_or_pair_of_them_first"]["share"] == 1.0
    assert found["log_score"] == pytest.approx(math.log(0.7))
    assert found["constants"]["log_score"]["value"] == pytest.approx(math.log(0.25))
    assert found["constants"]["component_first"]["share"] == 0.25
    assert found["by"].keys() == {"component, one series"}
    assert [(b["n"], b["right"]) for b in found["reliability"]] == [(4, 4)]
    text = score_table(score)
    assert "| true component itself first | 100 % (4 of 4" in text
    json.dumps(score.record())
    assert score.summary["right"]["count"] == 4


def test_answers_without_components_are_scored_as_before() -> None:
    """A cause of a component is one outside the catalogue for them, and nothing is said by component."""
    old = {"a": Answer.ranked({"unlisted": 0.8, "taper": 0.2})}
    for k in (key("component", "wall"), key("pair", "wall", "inflow")):
        score = score_answers([k], old)
        assert score.components == {}
        assert score.summary["right"]["count"] == 1
        assert score.summary["outside_called_unlisted"]["count"] == 1
    outside = replace(key("outside", "wall"), label="active-tone")
    assert score_answers([outside], old).summary["right"]["count"] == 1
    named = {"a": answer({"wall": 0.9, "inflow": 0.1})}
    assert score_answers([outside], named).summary["right"]["count"] == 1


def test_components_of_a_diagnosis_are_read(answered: Path) -> None:
    file = read_diagnosis(answered / "case-001")
    function = {
        "name": "wall-law", "argument": "stretch", "argument_unit": "1", "unit": "log stiffness",
        "values": [1.1, 1.2], "mean": [0.1, 0.2], "low": [0.0, 0.1], "high": [0.2, 0.3], "prior_size": 0.4,
        "narrowed": [[0.7, 0.7]],
        "beside": {"f3": 4e4},
    }  # fmt: skip
    given = {"name": "wall", "probability": 0.7, "log_evidence": 3.0, "group": 0, "functions": [function]}
    file = file.model_copy(update={"components": [ComponentResult.model_validate(given)]})
    [component] = as_answer(file).components
    [learned] = component.functions
    assert (component.name, component.probability, component.share) == ("wall", 0.7, None)
    assert (learned.prior_sd, learned.narrowed, learned.at.tolist()) == (0.4, 1, [1.1, 1.2])
    assert learned.beside == {"f3": 4e4}
    assert learned.high.tolist() == [0.2, 0.3]
    # its own function is an explanation, the first one where the verdict says so
    given |= {"own_probability": 0.6}
    other = {"name": "outlets", "probability": 0.1, "log_evidence": 1.0, "group": 1}
    parts = [ComponentResult.model_validate(x) for x in (given, other)]
    listed = file.hypotheses[1].name
    told = as_answer(file.model_copy(update={"components": parts, "cause": ["wall", listed]}))
    first = told.explanations[0]
    assert (first.name, first.probability) == ("wall", 0.6)
    group = {e.name: g for e, g in zip(told.explanations, told.groups, strict=True)}
    assert group["wall"] == group[listed] == file.hypotheses[1].group
    assert group["outlets"] not in {h.group for h in file.hypotheses}


# -- true functions ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def before() -> Case:
    flow = get_baseline("linear-constant").forward(load_study("demo"))
    return flow.configure(pack(flow.parameters, start_of(flow.parameters)))


def truth(before: Case, name: str, size: float, shape: dict[str, float]) -> Truth:
    """The tables of a cause, whose ranges and pressures are made up."""
    apply = CAUSES[name].effect(shape).apply
    assert apply is not None
    after = apply(before, (size,), EVERYWHERE)
    visited = object.__new__(Visited)
    visited.stretch, visited.velocity, visited.junction = (1.05, 1.4), (0.0, 60.0), (-5.0, 60.0)
    study = load_study("demo")
    times = np.arange(WAVE_SAMPLES) * (study.period_s / WAVE_SAMPLES)
    series = [(1, 0.0, "pressure_mmHg")]
    plain = simulate(replace(after, waves=()), series, times)
    return Truth(true_functions(before, after, visited, plain, ["pressure_mmHg"], ["p"]), (name,))


def learned(name: str, at: Array, labels: tuple[str, ...] = (), mean: Array = 0.0) -> StatedFunction:
    at = np.asarray(at, dtype=float)
    return StatedFunction(name, at, mean + 0 * at, 0 * at, 0 * at, labels=labels)


def test_laws_are_those_of_their_formulas(before: Case) -> None:
    """Slope of Fung's law, friction by speed, loss over dynamic pressure, against formulas by hand."""
    fung, e = truth(before, "fung-wall", 6.0, {}), np.array([0.1, 0.3])
    expected = np.log(np.exp(6 * e**2) * (1 + 12 * e**2))
    for more in (0.0, 0.4):  # which the stiffness of all vessels stands in for
        stated = learned("wall-law", [1.0, 1.1, 1.3], mean=np.append(9.0, expected + more))
        found = fung("wall", stated)
        assert found is not None
        assert math.isnan(found[0])  # was not visited
        assert found[1:] == pytest.approx(expected + more, abs=2e-3)
    shape = {"least": 2.0, "reference": 10.0}
    u = np.array([0.0, 5.0, 40.0])
    found = truth(before, "power-law-blood", 0.5, shape)("fluid", learned("friction-law", u))
    assert found == pytest.approx(-0.25 * np.log((u**2 + 4) / 100), abs=3e-3)
    found = truth(before, "flat-loss", 0.3, {"power": 1.2})("junctions", learned("junction-loss", u))
    assert found is not None
    assert math.isnan(found[0])
    # D = a rho/2 40^2 (u/40)^m = k (u/U) rho U^2/2 with U = 40
    assert found[1:] == pytest.approx(0.3 * (u[1:] / 40) ** 0.2, rel=2e-2)


def test_vessels_and_curves_over_the_radius(before: Case) -> None:
    net = before.network
    labels = tuple(f"vessel {i}" for i in net.ids)
    radius = 0.5 * (net.radius_in_cm + net.radius_out_cm)
    viscous = truth(before, "viscous-small-vessels", 1.5, {})
    at = np.log(np.sort(radius)[[0, 5, -1]])
    found = viscous("fluid", learned("viscosity-by-radius", at))
    assert found == pytest.approx(1.5 * (np.log(radius.max()) - at), abs=1e-4)
    assert viscous("wall", learned("wall-law", [1.1])) is None
    shape = {"vessels": 3.5, "pattern": 17.0}
    misread = truth(before, "misread-radii", 0.2, shape)
    found = misread("geometry", learned("radius-scatter", np.arange(len(labels)), labels))
    assert found is not None
    assert np.count_nonzero(found) == 3
    assert 0.1 <= np.abs(found[found != 0]).min() <= np.abs(found).max() <= 0.2
    assert misread("geometry", learned("radius-by-size", at)) is None
    outlets = tuple(f"vessel {i}" for i in net.ids[net.terminals])
    blocked = truth(before, "blocked-outlets", 0.8, {"outlets": 2.0, "pattern": 3.0})
    mean = -0.4 * 2 / len(outlets)  # of the two that are blocked; c stands in for another one
    found = blocked("outlets", learned("outlet-compliance", np.arange(len(outlets)), outlets, mean=mean))
    assert found is not None
    assert sorted(set(found.round(6))) == [-0.4, 0.0]
    found = blocked("outlets", learned("outlet-compliance", np.arange(len(outlets)), outlets))
    assert found is not None
    assert found.mean() == pytest.approx(0.0, abs=1e-9)


def test_an_impedance_is_compared_together_with_the_loads_beside_it(before: Case) -> None:
    """Z = R1 + R2/(1 + (i w R2 C)^(1 - a)), over Windkessels of other stated factors."""
    net, size = before.network, 0.3
    found = truth(before, "constant-phase", size, {})
    hz = np.array([1.1, 2.5, 6.0]) / net.period_s
    stated = learned("outlet-impedance", np.log(hz))
    assert found("outlets", stated) is None  # nothing is stated of the loads
    i, w = net.terminals[0], 2j * np.pi * hz

    def modulus(psi1: float, psi2: float, c: float, order: float) -> Array:
        R2 = psi2 * net.R2[i]
        return np.log(np.abs(psi1 * net.R1[i] + R2 / (1 + (w * R2 * c * net.C[i]) ** order)))

    for beside in ({"psi1": 1.0, "psi2": 1.0, "c": 1.0}, {"psi1": 3.0, "psi2": 0.7, "c": 1.8}):
        values = found("outlets", replace(stated, beside=beside))
        expected = modulus(before.psi1[i], before.psi2[i], before.c[i], 1 - size) - modulus(**beside, order=1)
        assert values == pytest.approx(expected, abs=0.02)


def test_records_and_sensors(before: Case) -> None:
    period = before.network.period_s
    shape = {"after": 0.3, "width": 0.03}
    backflow = truth(before, "closing-backflow", 0.2, shape)
    flow = backflow("inflow", learned("flow-record", [0.0, 0.5 * period]))
    apply = CAUSES["closing-backflow"].effect(shape).apply
    assert apply is not None
    changed = apply(before, (0.2,), EVERYWHERE).inflow_ml_s - before.inflow_ml_s
    times = before.inflow_time_s
    assert flow == pytest.approx(np.interp([0.0, 0.5 * period], times, changed), abs=1e-6)
    hz = np.array([1, 3, 6]) / period
    echo = truth(before, "catheter-echo", 0.2, {"delay": 0.01})
    gain = echo("sensor", learned("sensor-filter", np.log(hz)))
    expected = np.log(np.abs(1 + 0.2 * np.exp(-2j * np.pi * hz * 0.01)) / 1.2)
    assert gain == pytest.approx(expected, abs=1e-4)
    sticking = truth(before, "sticking-transducer", 0.2, {"travel": 1.0})
    assert sticking("sensor", learned("sensor-filter", np.log(hz))) is None
    assert sticking("sensor", learned("sensor-curve", [12.0])) is None


def test_keys_made_elsewhere_tell_components(tmp_path: Path) -> None:
    """Such a key's law, as pressure by area, is the law that was put in; others are read alike."""
    area = np.linspace(1.0, 2.0, 41)
    strain = np.sqrt(area) - 1
    pressure = 4 / 3 * 4e4 * (np.exp(6 * strain) - 1) / 6 / 1333.22
    tables = {
        "A_over_A0": area.tolist(),
        "p_true_mmHg": pressure.tolist(),
        "chi_true": 4e4,
        "pressure_range_mmHg": [float(pressure[8]), float(pressure[32])],
    }
    entry = {
        "case": "case-9",
        "effects": [{"effect": "wall_exponential", "component": "wall", "tables": tables}],
        "components": ["wall"],
        "layout": "MPA+flow",
        "tree": {"kind": "random"},
        "observed": [[1, 0.0, "pressure_mmHg"], [2, 0.5, "flow_ml_s"], [3, 0.5, "flow_ml_s"]],
        "noise": {"white_sd": [0.03, 1e-3, 1e-3], "ar1_sd": [0.04, 0.0, 0.0]},
        "base_fit": {"rms_noisefree": [0.3, 0.001, 0.002]},
        "noise_free": [{"values": [10.0, 11.0]}, {"values": [0.1, 0.2]}, {"values": [0.1, 0.1]}],
        "period_s": 0.1,
    }
    found = other_key(entry)
    assert (found.kind, found.components, found.label) == ("component", ("wall",), "wall-exponential")
    assert (found.noise, found.before) == (pytest.approx(0.05), pytest.approx(0.3))
    assert found.tags["series"] == "three or more"
    assert found.functions is not None
    s = np.sqrt(area[[0, 12, 28]])
    values = found.functions("wall", learned("wall-law", s, mean=6 * (s - 1)))
    assert values is not None
    assert math.isnan(values[0])
    assert values[1:] == pytest.approx(6 * (s[1:] - 1), abs=0.01)  # the logarithm of the exponential's slope
    (tmp_path / "keys").mkdir()
    (tmp_path / "keys" / "case-9.json").write_text(json.dumps(entry))
    assert read_key(tmp_path / "keys", tmp_path)[0] == [found]


def test_own_keys_tell_the_component_of_listed_effects() -> None:
    effect = {
        "effect": "tangent-wall", "vessel": None, "subtree": False, "amplitudes": {"1/gamma": 0.2},
        "priors_95": {"1/gamma": [0.0, 1.0]},
    }  # fmt: skip
    entry = {
        "case": "case-001", "kind": "listed", "effect": "tangent-wall", "effects": [effect],
        "noise": {"white": {"mmHg": 0.05}, "correlated_mmHg": 0.0}, "gap_mmHg": {"before": 0.2},
        "truth": {"v1@0 pressure_mmHg": "1 2 3"}, "digest": "", "layout": "MPA", "network": {"kind": "tree"},
    }  # fmt: skip
    found = own_key(entry)
    assert found.components == ("wall",)
    assert found.tags["series"] == "one"
    assert found.effects == (TrueEffect("tangent-wall", found.effects[0].location, 0.2, (0.0, 1.0)),)
    own = scored(found, answer({"wall": 0.6, "inflow": 0.4}))
    assert own.leader_right
    assert scored(replace(found, components=("inflow",)), answer({"wall": 0.6, "inflow": 0.4})).found is False
