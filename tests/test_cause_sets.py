"""The posterior over sets of causes of a simulator that is solved: sums, sizes, and what does not matter."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.optimize import least_squares
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

import zoo
from toys import EFFECTS, FUNCTIONS, KNOTS, MODEL, NOISE, PUSH, TIMES, bulge, data_of, hooks, kick, solve
from zoo.core.causes.evidence import SIZE_PRIORS, SetModel
from zoo.core.causes.posterior import SetRow
from zoo.core.data import Data
from zoo.core.diagnosis import Diagnosis, DiagnosisError, DiagnosisFile, diagnose, read_diagnosis
from zoo.core.diagnosis.answer import table_of
from zoo.core.diagnosis.coordinates import SearchModel
from zoo.core.diagnosis.importance import check_sets
from zoo.core.diagnosis.search import NO_DAMPING, Search, as_matrix
from zoo.core.diagnosis.solved import Linear
from zoo.core.effects import Effect, EffectParameter, effect
from zoo.core.errors.spectral import Cosines, Harmonics
from zoo.core.forward import Corrected, FunctionModel, Outputs
from zoo.core.parameters import Normal, Parameter

BULGED = {"law": 0.3 * KNOTS**2}


def found_in(configuration: dict, functions=FUNCTIONS, effects=EFFECTS, **settings: Any) -> Diagnosis:
    return diagnose(data_of(configuration), MODEL, effects, hooks=hooks(functions), cores=1, **settings)


@pytest.fixture(scope="module")
def bulged() -> Diagnosis:
    return found_in(BULGED)


@pytest.fixture(scope="module")
def between() -> Diagnosis:
    """A bump that any of several causes may be."""
    return found_in({"push": 0.02 * np.exp(-0.5 * ((TIMES - 0.6) / 0.06) ** 2)})


# -- the file --------------------------------------------------------------------------------------


@pytest.mark.parametrize("which", ["bulged", "between"])
def test_every_probability_is_a_sum_over_the_table(which: str, request: pytest.FixtureRequest) -> None:
    """By the JSON alone."""
    content = json.loads(request.getfixturevalue(which).file.model_dump_json())
    table = content["sets"]
    sets = []
    for numbers, *values in table["rows"]:
        of = [table["of"][i] for i in numbers]
        row = {name: [one[k] for one in of] for k, name in enumerate(("causes", "names", "components"))}
        sets.append(row | dict(zip(table["columns"], values, strict=True)))
    joint = np.array([row["log_prior"] + row["log_evidence"] for row in sets])
    p = np.exp(joint - logsumexp(joint))
    assert p == pytest.approx([row["probability"] for row in sets], rel=1e-9, abs=1e-300)
    assert np.all(np.diff(p) <= 1e-12)

    def holding(key: str, names: set[str]) -> float:
        return float(sum(x for x, row in zip(p, sets, strict=True) if names & set(row[key])))

    for one in content["components"]:
        near = {one["name"], *one["confounded"]}
        assert one["probability"] == pytest.approx(holding("components", {one["name"]}), abs=1e-12)
        assert one["group_probability"] == pytest.approx(holding("components", near), abs=1e-12)
        for function in one["functions"]:
            assert function["probability"] == pytest.approx(holding("names", {function["name"]}), abs=1e-12)
    for one in content["causes"]:
        assert one["probability"] == pytest.approx(holding("names", {one["name"]}), abs=1e-12)
    counts = np.array([len(row["causes"]) for row in sets])
    number = [float(p[counts == k].sum()) for k in range(len(content["number"]))]
    assert content["number"] == pytest.approx(number, abs=1e-12)
    [empty] = [i for i, row in enumerate(sets) if not row["causes"]]
    assert content["no_gap"] == pytest.approx(p[empty] * sets[empty]["negligible"], abs=1e-12)
    first = next(row for row in sets if row["solved"])
    assert content["cause"] == first["causes"]
    stated = content["sensitivity"][0]
    assert stated["nothing"] == pytest.approx(p[empty], abs=1e-4)
    for one in content["components"]:
        assert stated["components"][one["name"]] == pytest.approx(one["probability"], abs=1e-4)


def test_the_file_comes_back_and_amounts_carry_their_unit(bulged: Diagnosis, tmp_path: Path) -> None:
    content = json.loads(bulged.save(tmp_path).read_text())
    assert read_diagnosis(tmp_path).model_dump() == bulged.file.model_dump()
    assert content["format"] == 4
    assert content["gap"]["before_K"] == bulged.file.gap.before
    assert "gap_after_K" in content["sets"]["columns"]
    assert {row["name"] for row in content["causes"]} == {"law", "push", "own", "bulge", "kick"}


def test_files_of_another_format_or_another_content_are_refused(bulged: Diagnosis, tmp_path: Path) -> None:
    path = bulged.save(tmp_path)
    content = json.loads(path.read_text())
    del content["sha256"]
    path.write_text(json.dumps(content | {"format": 2}))
    with pytest.raises(DiagnosisError, match=r"format 2 is of an older program.*make it again with `zoo"):
        read_diagnosis(tmp_path)
    path.write_text(bulged.save(tmp_path).read_text().replace('"study": "toy"', '"study": "tea"'))
    with pytest.raises(DiagnosisError, match="make it again"):
        read_diagnosis(tmp_path)


def test_prior_probabilities_are_those_of_odds_of_a_tenth(bulged: Diagnosis) -> None:
    """Three components: any set of k of them weighs 0.1^k."""
    total = 1.1**3
    for one in bulged.components:
        assert one.prior_probability == pytest.approx(0.1 * 1.1**2 / total)
    by_name = {one.name: one.prior_probability for one in bulged.causes}
    whole = bulged.components[0].prior_probability
    assert by_name["own"] == pytest.approx(whole)  # all that the sensor may have
    assert by_name["bulge"] == pytest.approx(0.5 * whole)
    empty = next(row for row in bulged.table if not row.causes)
    assert np.exp(empty.log_prior) == pytest.approx(1.0 / total)


def test_more_odds_make_causes_more_probable(between: Diagnosis) -> None:
    rows = {row.prior: row for row in between.file.sensitivity}
    stated = rows["as stated"]
    assert rows["odds of causes halved"].nothing > stated.nothing > rows["odds of causes doubled"].nothing
    # of two sets of equal size the ratio stays: with odds halved, a single cause loses a half
    sets = between.sets.posterior
    half = sets.under(odds=0.05)
    single = next(w for w in sets.probability if len(w) == 1)
    ratio = [one.probability[single] / one.probability[()] for one in (half, sets)]
    assert ratio[0] == pytest.approx(0.5 * ratio[1])


# -- what is found ---------------------------------------------------------------------------------


def test_a_listed_effect_is_found_and_solved(bulged: Diagnosis) -> None:
    assert bulged.cause == ["bulge"]
    assert bulged.components[0].name == "wall"
    assert bulged.components[0].probability > 0.9
    assert max(one.probability for one in bulged.components[1:]) < 0.3
    [size] = bulged.causes[0].estimates
    assert size.mean == pytest.approx(0.3, abs=0.05)
    assert bulged.table[0].gap_after < 0.3 * NOISE
    assert bulged.components[0].share.low > 0.8


def test_a_free_function_is_found_where_no_effect_is_the_cause() -> None:
    true = 0.15 * np.sin(4 * np.pi * TIMES) ** 3
    found = found_in({"push": true})
    assert found.components[0].name == "inflow"
    assert found.components[0].probability > 0.8
    learned = found.components[0].functions[0]
    inside = (np.array(learned.low) <= true) & (true <= np.array(learned.high))
    assert inside.mean() > 0.8
    assert found.sets.search.gained(found.sets.leader) == pytest.approx(0.0, abs=0.5)  # linear in it


def test_a_function_that_its_derivative_hides_is_found_beside_an_effect_of_its_component() -> None:
    """A clock that runs fast: pulses move by more than their width, which no derivative shows."""
    times = np.linspace(0.0, 1.0, 120)

    def pulses(p: dict, at: np.ndarray) -> np.ndarray:
        x = at - p["warp"](at) - p.get("lag", 0.0)
        return p["height"] * sum(np.exp(-0.5 * ((x - middle) / 0.04) ** 2) for middle in (0.3, 0.7))

    lag = zoo.effect("lag", size=0.05, family="clock")(lambda p, size: {**p, "lag": size})
    warp = zoo.free_function("warp", along="time", size=0.05, component="clock")
    fast = pulses({"height": 1.0, "warp": lambda at: 0.15 * (at - 0.25)}, times)
    measured = fast + 0.002 * np.random.default_rng(1).standard_normal(120)
    found = zoo.diagnose(times, measured, pulses, {"height": zoo.Normal(1.0, 0.5)}, [lag, warp], cores=1)
    assert found.table[0].causes[0].startswith("warp")
    assert found.table[0].probability > 0.9
    assert found.file.gap.after_interval[1] < 0.01  # of pulses of height 1


def test_two_causes_are_two() -> None:
    found = found_in({**BULGED, "kick": 0.2}, [])
    assert set(found.cause) == {"bulge", "kick"}
    assert [one.estimates[0].mean for one in found.causes] == pytest.approx(
        [{"bulge": 0.3, "kick": 0.2}[one.name] for one in found.causes], abs=0.05
    )
    assert {one.name for one in found.components if one.probability > 0.9} == {"wall", "inflow"}
    assert found.file.number[2] > 0.7


def test_without_a_cause_there_is_no_gap() -> None:
    for seed in (1, 2, 3):
        found = diagnose(data_of({}, seed=seed), MODEL, EFFECTS, hooks=hooks(FUNCTIONS), cores=1)
        assert found.cause == []
        assert found.file.no_gap > 0.5
        assert found.file.verdict.startswith("Nothing is missing")
        assert max(one.probability for one in found.components) < 0.3


def test_without_anything_to_blame_there_is_nothing() -> None:
    found = found_in({"push": 0.3 * np.sin(6 * np.pi * TIMES)}, [], [])
    assert [row.causes for row in found.table] == [[]]
    assert found.table[0].probability == 1.0
    assert found.file.no_gap < 0.01
    assert found.file.verdict.startswith("No listed cause explains the model error of")


def test_components_of_one_response_are_told_to_be_one_group() -> None:
    push = replace(PUSH, lengths=(0.12,))
    twin = replace(push, name="twin", component="outlets")
    found = found_in({"push": 0.15 * np.sin(4 * np.pi * TIMES) ** 3}, [push, twin], [])
    rows = {one.name: one for one in found.components}
    assert rows["inflow"].probability == pytest.approx(rows["outlets"].probability, abs=0.1)
    leading = found.sets.components(found.sets.leader)[0]
    other = ({"inflow", "outlets"} - {leading}).pop()
    assert other in rows[leading].confounded
    assert rows[leading].group_probability > 0.9


# -- what does not matter --------------------------------------------------------------------------


def totals(found: Diagnosis) -> dict[str, float]:
    return {one.name: one.probability for one in found.components}


@pytest.mark.filterwarnings("ignore:effects kick and kick again do the same")
def test_a_cause_that_is_given_twice_or_renamed_changes_nothing(between: Diagnosis) -> None:
    wanted = totals(between)
    configuration = {"push": 0.02 * np.exp(-0.5 * ((TIMES - 0.6) / 0.06) ** 2)}
    twice = found_in(configuration, effects=[*EFFECTS, replace(kick, name="kick again")])
    assert totals(twice) == pytest.approx(wanted, abs=1e-6)
    renamed = found_in(configuration, effects=[replace(bulge, name="b"), replace(kick, name="a")])
    assert totals(renamed) == pytest.approx(wanted, abs=1e-6)


def test_units_change_nothing(between: Diagnosis) -> None:
    """Of series in thousandths, from data to functions."""

    def in_thousandths(configuration, times):  # type: ignore[no-untyped-def]
        return 1000.0 * solve(configuration, times)

    data = between.data
    milli = replace(data, values=1000.0 * data.values, units=("mK", "mK"))
    found = diagnose(milli, replace(MODEL, function=in_thousandths), EFFECTS, hooks=hooks(FUNCTIONS), cores=1)
    assert totals(found) == pytest.approx(totals(between), abs=0.01)
    assert found.file.gap.before == pytest.approx(1000.0 * between.file.gap.before, rel=0.02)


# -- the gap ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("harmonic", [3, 12, 25])
def test_what_is_missing_is_gap_and_not_noise_however_fast(harmonic: int) -> None:
    missing = 0.1 * np.sin(2 * np.pi * harmonic * TIMES)
    data = data_of({})
    data = replace(data, values=data.values + missing)
    gap = diagnose(data, MODEL, [], hooks=hooks([]), cores=1).file.gap
    assert gap.before**2 + gap.noise_floor**2 == pytest.approx(gap.residual_rms_before**2, rel=0.1)
    assert gap.before == pytest.approx(0.1 / np.sqrt(2.0), rel=0.1)


def test_what_a_set_leaves_is_that_of_a_solve_at_its_mode() -> None:
    """The kick alone, where the law is bent; no fit by least squares leaves more."""
    found = found_in(BULGED, [], errors=Harmonics(known={"y": NOISE}))
    [which] = [w for w in found.sets.solved if found.sets.name(w) == "kick"]
    gap = found.sets.gap_after(which, found.data.groups)
    one, noise = found.sets.solved[which], found.sets.noise["y"]

    def left(x: np.ndarray) -> np.ndarray:
        return np.asarray((found.data.values - solve({"level": x[0], "kick": x[1]}, TIMES)).ravel())

    at = left(one.forward.theta(one.point.u))
    assert gap == pytest.approx(np.sqrt(np.mean(at**2) - noise**2), rel=1e-6)
    least = least_squares(left, [1.0, 0.1]).fun
    assert np.sqrt(np.mean(least**2) - NOISE**2) == pytest.approx(gap, rel=0.1)
    assert np.mean(least**2) <= np.mean(at**2)


def test_what_is_held_out_is_told_and_predicted(bulged: Diagnosis) -> None:
    gap = bulged.file.gap
    assert gap.held_out == "each series in turn"
    assert gap.held_out_after < 0.5 * gap.held_out_before
    assert gap.held_out_before == pytest.approx(gap.before, rel=0.2)


# -- a simulator that is exactly linear ------------------------------------------------------------

T = np.arange(48) / 48.0
WAVE, RAMP = np.cos(2 * np.pi * T), T - 0.5
CAUSES = {"bump": np.exp(-0.5 * ((T - 0.6) / 0.07) ** 2), "wiggle": np.sin(10 * np.pi * T)}
PRIOR_SD, SCALE = 2.0, 0.5


def straight(c, times):  # type: ignore[no-untyped-def]
    """Linear in all."""
    return c["a"] * WAVE + c["b"] * RAMP + sum(c.get(name, 0.0) * one for name, one in CAUSES.items())


def adding(name: str) -> Effect:
    @effect(name, parameters=[EffectParameter("size", "V", SCALE, -5.0, 5.0, (0.2, -0.2))])
    def change(c, values, at):  # type: ignore[no-untyped-def]
        """Adds a wave."""
        return {**c, name: values[0]}

    return change


LINEAR = FunctionModel(
    straight, tuple(Parameter(x, Normal(1.0, PRIOR_SD), "V") for x in "ab"), Outputs(("y",), T), "straight"
)


def linear_data(seed: int, noise: float = 0.05, **added: float) -> Data:
    values = straight({"a": 1.3, "b": 0.4, **added}, T)
    values = values + noise * np.random.default_rng(seed).standard_normal(len(T))
    return Data(T, values, labels=["y"], units=["V"], name="line")


def of_the_line(seed: int, **added: float) -> Diagnosis:
    return diagnose(
        linear_data(seed, **added), LINEAR, [adding(x) for x in CAUSES], cores=1, errors=Cosines()
    )


def by_quadrature(data: Data, names: list[str]) -> float:
    """Log evidence beside white noise, log sd ~ N(log of 1 % of the range, 2^2); all else is normal."""
    X = np.stack([PRIOR_SD * WAVE, PRIOR_SD * RAMP, *(SCALE * CAUSES[name] for name in names)], axis=1)
    centre = np.log(0.01 * np.ptp(data.values))
    logs = np.linspace(-5.0, 0.0, 2001)
    terms = [
        multivariate_normal(WAVE + RAMP, np.exp(2 * x) * np.eye(len(T)) + X @ X.T).logpdf(data.values[0])
        + norm(centre, 2.0).logpdf(x)
        for x in logs
    ]
    return float(logsumexp(terms)) + float(np.log(logs[1] - logs[0]))


@pytest.mark.parametrize("names", [[], ["bump"], ["bump", "wiggle"]])
def test_solved_evidence_is_that_of_the_joint_normal(names: list[str]) -> None:
    found = of_the_line(3, bump=0.15, wiggle=0.05)
    index = {one.name: i for i, one in enumerate(found.sets.posterior.causes)}
    one = found.sets.solved[tuple(sorted(index[name] for name in names))]
    assert one.evidence.kinds[0] == 0
    assert one.evidence.log_z[0] == pytest.approx(by_quadrature(found.data, names), abs=0.05)


def test_solves_add_nothing_to_a_linear_model() -> None:
    found = of_the_line(3, bump=0.15, wiggle=0.05)
    assert len(found.sets.solved) >= 4
    for which in found.sets.solved:
        gained = found.sets.search.gained(which)
        assert gained == pytest.approx(0.0, abs=0.05), found.sets.name(which)
    assert found.file.linear_error < 0.05


def test_intervals_hold_the_size_about_as_often_as_they_say() -> None:
    """Of 20 records each; between 16 and all of them hold it, and no other cause is found."""
    held = []
    for seed in range(20):
        found = of_the_line(100 + seed, bump=0.3)
        assert found.cause == ["bump"]
        rows = {one.name: one for one in found.causes}
        assert rows["bump"].probability > 0.9
        assert rows["wiggle"].probability < 0.5
        low, high = rows["bump"].estimates[0].interval
        assert 0.03 < high - low < 0.2
        held.append(low <= 0.3 <= high)
    assert sum(held) >= 16


# -- what was not solved ---------------------------------------------------------------------------


@pytest.mark.parametrize("configuration", [{"law": 0.05 * KNOTS**2}, {"kick": 0.03, "law": 0.03 * KNOTS**2}])
def test_the_missed_probability_is_below_what_is_stated(configuration: dict) -> None:
    """All single causes and pairs solved by brute force: what the search left out has no more."""
    few = [replace(one, lengths=one.lengths[1:]) for one in FUNCTIONS[:2]]
    found = found_in(configuration, few).sets
    search = found.search
    assert len(search.causes) <= 12
    known = set(found.solved)
    sets = [(i,) for i in range(len(search.causes))] + [
        pair
        for pair in combinations(range(len(search.causes)), 2)
        if len({search.causes[i].component for i in pair}) == 2
    ]
    kinds = found.posterior.rows[0].evidence.kinds
    start = found.solved[()].evidence.only(kinds).log_noise
    joint = {which: found.posterior.log_joint[which] for which in known}
    for which in sets:
        if which in known:
            continue
        linear = SetModel(search.problem, [search.causes[i] for i in which], search.family)
        search.rows.setdefault(which, SetRow(which, 0.0, linear.evidence(kinds, start)))
        if (looked := search._look(which)) is not None:
            joint[which] = found.posterior.priors.log_prior(which) + search._refined(looked).log_z
    total = logsumexp(list(joint.values()))
    missed = sum(np.exp(x - total) for which, x in joint.items() if which not in known)
    assert missed <= 1.05 * found.missed + 1e-6  # a search ends within 0.02 of the best log posterior


def test_a_larger_set_tells_where_a_smaller_one_is() -> None:
    """Of a linear model the end of a pair without one of its causes is the mode of the other."""
    search = of_the_line(3, bump=0.5, wiggle=0.3).sets.search
    index = {one.name: i for i, one in enumerate(search.causes)}
    one, pair = (index["bump"],), tuple(sorted(index.values()))
    search._weigh_more([one, pair])
    search._solve(dict.fromkeys((one, pair)))
    small, V = search.solved[one], np.full(len(search.data), 0.1)
    at = Search(small.forward, search.data, V)
    u, jacobian = search._without(search.solved[pair], small.order, at)
    np.testing.assert_allclose(jacobian, small.point.jacobian, atol=1e-6)
    mode = small.point.u + at.step(at.resume(small.point), NO_DAMPING)
    assert at.cost(u, small.forward(u)) == pytest.approx(at.cost(mode, small.forward(mode)), abs=1e-6)
    step, precision = u - small.point.u, as_matrix(small.forward.prior(small.point.u)[0])
    square = np.sum((small.point.jacobian @ step) ** 2 / V) + step @ precision @ step
    assert np.sqrt(square) == pytest.approx(0.308, abs=0.01)  # in posterior sds: its errors are others


def steeper(c, times):  # type: ignore[no-untyped-def]
    """A wiggle counts exp(4 bump) times: what it does beside the bump is not what it does alone."""
    return straight({**c, "wiggle": c.get("wiggle", 0.0) * np.exp(4.0 * c.get("bump", 0.0))}, times)


def test_sets_are_solved_on_while_what_was_not_may_be_the_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    found = of_the_line(3, bump=0.15).sets
    for missed, times in ((0.4, 4), (0.6, 8)):
        monkeypatch.setattr(found.search, "missed_by_set", lambda _, missed=missed: {(0,): missed})
        assert [found.search._goes_on(found.posterior, wave) for wave in range(10)].count(True) == times


def test_around_the_leading_set_the_linear_model_promises_what_solves_find() -> None:
    """Around the baseline it is wrong by the logarithm of a response that is seven times as large."""
    model = FunctionModel(steeper, LINEAR.parameters, LINEAR.outputs, "steeper")
    data = linear_data(3, bump=0.5)
    found = diagnose(data, model, [adding(x) for x in CAUSES], cores=1, errors=Cosines())
    search, index = found.sets.search, {one.name: i for i, one in enumerate(found.sets.posterior.causes)}
    bump, pair = (index["bump"],), tuple(sorted(index.values()))
    assert found.sets.leader == bump

    def promised(linear: Linear, which: tuple[int, ...]) -> float:
        inside = SetModel(linear.problem, [linear.causes[i] for i in which], search.family)
        return inside.evidence(search.rows[bump].evidence.kinds, search.family.noise_start).total(SIZE_PRIORS)

    search._weigh_more([pair])
    search._solve({pair: None})
    around = search._linear(search.solved[bump], fresh=True)
    for which in (bump, pair):
        assert promised(around, which) == pytest.approx(search.solved[which].log_z, abs=0.3)
    assert abs(promised(search.linears[0], pair) - search.solved[pair].log_z) > 1.0


def saturating(c, times):  # type: ignore[no-untyped-def]
    """A bump is later the larger it is, and so unlike any multiple of a small one."""
    size = c.get("bump", 0.0)
    bump = size * np.exp(-0.5 * ((T - 0.6 - 0.3 * size) / 0.07) ** 2)
    return straight({**c, "bump": 0.0}, times) + bump


def test_a_set_that_was_only_looked_at_is_not_solved_until_it_is_due_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = of_the_line(3, bump=0.15, wiggle=0.15).sets
    search, pair = found.search, found.leader
    assert len(pair) == 2
    search.solved.pop(pair)
    monkeypatch.setattr("zoo.core.diagnosis.sets.NEAR", -np.inf)
    search._solve({pair: None})
    posterior = search._corrected(found.posterior)
    assert pair in search.missed_by_set(posterior)
    assert pair in search._due(posterior, {(), pair}, True)
    search._solve({pair: None})
    assert pair not in search.missed_by_set(posterior)


def test_around_another_set_the_baseline_lends_its_responses() -> None:
    """They are right there of what the set does not change, and cost no solve."""
    model = FunctionModel(saturating, LINEAR.parameters, LINEAR.outputs, "saturating")
    values = saturating({"a": 1.3, "b": 0.4, "bump": 0.5}, T) + 0.05 * np.random.default_rng(
        3
    ).standard_normal(48)
    data = Data(T, values, labels=["y"], units=["V"], name="line")
    search = diagnose(data, model, [adding(x) for x in CAUSES], cores=1, errors=Cosines()).sets.search
    index = {one.name: i for i, one in enumerate(search.causes)}
    bump, pair = (index["bump"],), tuple(sorted(index.values()))
    search._weigh_more([pair])
    search._solve({pair: None})
    before = search.fitting.solves
    around = search._linear(search.solved[bump], fresh=False)
    assert search.fitting.solves == before
    kinds = search.rows[bump].evidence.kinds
    for linear, near in ((around, True), (search.linears[0], False)):
        inside = SetModel(linear.problem, [linear.causes[i] for i in pair], search.family)
        promised = inside.evidence(kinds, search.family.noise_start).total(SIZE_PRIORS)
        assert (abs(promised - search.solved[pair].log_z) < 0.3) is near


def test_sets_that_may_be_most_are_solved_where_none_is_probable(monkeypatch: pytest.MonkeyPatch) -> None:
    found = of_the_line(3, bump=0.15).sets
    search, tried = found.search, set(found.solved)
    monkeypatch.setattr(
        search, "missed_by_set", lambda _: {(7,): 0.2, (8,): 0.5, **dict.fromkeys(tried, 0.1)}
    )
    assert list(search._due(found.posterior, set(found.posterior.probability), True)) == [(8,), (7,)]


@dataclass(frozen=True, eq=False)
class Stepped(FunctionModel):
    """Its steps follow a parameter, as those of waves do, and so does their error, of second order."""

    steps: int | None = None
    times_finer: int = 1

    def configure(self, theta):  # type: ignore[no-untyped-def]
        return {**super().configure(theta), "steps": (self.steps, self.times_finer)}

    def refined(self) -> Stepped:
        return replace(self, times_finer=2 * self.times_finer)

    def pinned(self, configuration: dict) -> Stepped:
        return replace(self, steps=steps_of(configuration))

    @property
    def key(self) -> str:
        return f"{super().key} {self.steps} {self.times_finer}"


def steps_of(c) -> int:  # type: ignore[no-untyped-def]
    return 4 * round(4.0 * (1.0 + 5.0 * abs(c.get("bump", 0.0)) + abs(c["a"] - 1.3)))


def by_steps(c, times):  # type: ignore[no-untyped-def]
    given, finer = c["steps"]
    steps = finer * (given or steps_of(c))
    return straight(c, times) + 0.2 * (16 / steps) ** 2 * np.cos(14 * np.pi * times)


def test_the_error_of_steps_that_follow_a_parameter_is_no_evidence() -> None:
    """All sets have the evidence that they have of a simulator without it."""
    data, effects = linear_data(3, bump=0.3), [adding(x) for x in CAUSES]
    model = Stepped(by_steps, LINEAR.parameters, LINEAR.outputs, "stepped")
    exact, own = (diagnose(data, one, effects, cores=1, errors=Cosines()).sets for one in (LINEAR, model))
    assert len(own.solved) > 2
    for which, one in own.solved.items():
        assert one.log_z == pytest.approx(exact.solved[which].log_z, abs=0.1)


def test_an_absent_effect_is_given_the_steps_that_it_would_need(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a stenosis needs them at any size, and no tree without one."""
    monkeypatch.setattr(sys.modules[__name__], "steps_of", lambda c: 32 if c.get("bump", 0.0) else 16)
    stepped = Stepped(by_steps, LINEAR.parameters, LINEAR.outputs, "stepped")
    [location] = adding("bump").locations(stepped)
    model = SearchModel(stepped, (adding("bump").at(location),), Cosines().bind(linear_data(3)))
    u = model.start
    u[-1] = 0.0
    baseline = model.pinned(u).baseline
    assert isinstance(baseline, Corrected)
    assert baseline.model.steps == 32
    assert SearchModel(stepped, (), model.errors).pinned(u[:-1]).baseline.model.steps == 16


def test_a_check_by_importance_sampling_changes_nothing_of_a_linear_model() -> None:
    found = of_the_line(3, bump=0.15, wiggle=0.05)
    checked = check_sets(found.sets, draws=64)
    assert {one.which for one in checked} >= {(), found.sets.leader}
    for one in checked:
        assert one.change == pytest.approx(0.0, abs=1e-6)
        assert one.k < 0.7
        assert one.after == pytest.approx(one.before, rel=1e-6, abs=1e-12)


def bending(c, times):  # type: ignore[no-untyped-def]
    """A wiggle counts more the larger it is."""
    wiggle = c.get("wiggle", 0.0)
    return straight({**c, "wiggle": wiggle + wiggle**3}, times)


def test_a_check_by_importance_sampling_finds_what_the_linear_model_lacks() -> None:
    """Beside sums over bump and wiggle, whose response bends; the baseline's two weights are normal."""
    model = FunctionModel(bending, LINEAR.parameters, LINEAR.outputs, "bending")
    data = linear_data(3, noise=1.0, bump=0.5, wiggle=0.8)
    found = diagnose(data, model, [adding(x) for x in CAUSES], cores=1, errors=Cosines())
    search, names = found.sets.search, [one.name for one in found.sets.posterior.causes]
    pair = tuple(sorted(names.index(x) for x in CAUSES))
    one = search.solved[pair]
    best, problem = one.evidence.best(SIZE_PRIORS), one.evidence.problem
    V = one.evidence.variances(best)
    J, bound = problem.jacobian, Cosines().bind(data)
    H, b = (J.T / V) @ J + problem.P, (J.T / V) @ problem.residual - problem.pull
    linear = norm(0.0, np.sqrt(V)).logpdf(problem.residual).sum() + problem.log_prior
    linear += 0.5 * b @ np.linalg.solve(H, b) - 0.5 * np.linalg.slogdet(H / (2 * np.pi))[1]
    X = PRIOR_SD * np.stack([bound.flat(x[None]) for x in (WAVE, RAMP)], axis=1)
    joint = multivariate_normal(np.zeros(len(V)), np.diag(V) + X @ X.T)
    bumps, wiggles = np.linspace(-0.5, 1.5, 201), np.linspace(-2.0, 2.0, 401)
    terms = []
    for bump in bumps:
        series = [bending({"a": 1.0, "b": 1.0, "bump": bump, "wiggle": w}, T)[None] for w in wiggles]
        each = joint.logpdf(bound.flat(data.values) - np.stack([bound.flat(x) for x in series]))
        terms.append(each + norm(0, SCALE).logpdf(bump) + norm(0, SCALE).logpdf(wiggles))
    exact = logsumexp(terms) + np.log((bumps[1] - bumps[0]) * (wiggles[1] - wiggles[0]))
    checked = next(x for x in check_sets(found.sets, draws=2000) if x.which == pair)
    assert checked.k < 0.7
    assert checked.error < 0.03 < 0.15 < abs(exact - linear)
    assert checked.change == pytest.approx(exact - linear, abs=4.0 * checked.error)


def test_a_table_of_sets_that_is_none_is_refused(bulged: Diagnosis) -> None:
    content = json.loads(bulged.file.model_dump_json())
    assert DiagnosisFile.model_validate(content).sets == bulged.file.sets
    for change in ({"columns": []}, {"of": []}, {"rows": [1]}):
        with pytest.raises(ValidationError, match=r"is no table of sets|zip"):
            DiagnosisFile.model_validate(content | {"sets": content["sets"] | change})


def test_the_leading_set_is_in_the_table_however_improbable(
    bulged: Diagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zoo.core.diagnosis.answer.LEAST", 2.0)
    rows, p = table_of(bulged.sets, bulged.data.groups[:1])
    assert set(p) == {(), bulged.sets.leader}
    assert [row.causes for row in rows] == [bulged.cause, []]
