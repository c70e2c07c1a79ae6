"""Two components at once: their evidence, and what an answer says of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp

from toys import FIRST, KNOTS, LAW, MODEL, NOISE, OWN, PUSH, TIMES, TWIN, data_of, first_of, hooks, of
from zoo.core.diagnosis import diagnose
from zoo.core.diagnosis.components.pairs import _alone, _with_each, pairs_of
from zoo.core.diagnosis.components.refining import Component, explain
from zoo.core.diagnosis.components.weighing import SIZES
from zoo.core.diagnosis.scoring import score
from zoo.core.diagnosis.screening import DELTA_GRID, Screening
from zoo.core.errors.spectral import Harmonics

PUSHED = 0.15 * np.sin(4 * np.pi * TIMES + 0.5)
BOTH = {"push": PUSHED, "law": 0.1 * np.cos(2.0 * KNOTS)}


def explained_by(functions, given):  # type: ignore[no-untyped-def]
    screened = Screening(data_of(given), MODEL, [], errors=Harmonics()).run()
    return screened, explain(screened, functions, cores=1)


def test_the_evidence_of_two_is_that_of_a_normal_distribution() -> None:
    """r ~ N(J m, S + J P^-1 J' + s_a^2 X_a R X_a' + s^2 X R X'), each by a dense covariance."""
    echo = 0.1 * np.cos(6 * np.pi * TIMES)
    screened, explained = explained_by([PUSH, OWN], {"push": PUSHED, "own": echo})
    pair = pairs_of(screened, explained, [PUSH, OWN], cores=1)[0]
    assert set(pair.names) == {"inflow", "sensor"}
    first, second = pair.first, pair.second
    errors, X = screened.screening.errors, second.weighed.block.columns
    noise = second.weighed.noise["y"]
    assert noise.noise == pytest.approx(NOISE, rel=0.3)
    around = pair.around
    J, r = around.jacobian, around.residual
    own = next(b for b in around.blocks if b.function is first.function)
    A = own.columns @ first.root @ first.root.T @ own.columns.T
    centre = 1.0 - first.fit.values[0]

    def dense(C: np.ndarray) -> float:
        at = r - J[:, 0] * centre
        return float(-0.5 * (at @ np.linalg.solve(C, at) + np.linalg.slogdet(2 * np.pi * C)[1]))

    factors, sizes = np.exp(-0.5 * DELTA_GRID**2), SIZES * np.exp(-0.5 * SIZES**2)
    f = second.function
    both, alone = [], []
    for factor, w in zip(DELTA_GRID, factors / factors.sum(), strict=True):
        delta = factor * screened.allowances["y"]
        more = 0.3**2 * J @ J.T + A
        C = np.diag(errors.variances({"y": replace(pair.nothing.noise["y"], delta=delta)})) + more
        alone.append(np.log(w) + dense(C))
        C = np.diag(errors.variances({"y": replace(noise, delta=delta)})) + more
        for length in f.lengths:
            R = X @ f.correlation(length) @ X.T
            for size, v in zip(SIZES, sizes / sizes.sum(), strict=True):
                both.append(np.log(w * v / len(f.lengths)) + dense(C + (f.size * size) ** 2 * R))
    # the noise beside either is its own
    for terms, weighed in ((both, second.weighed), (alone, pair.nothing)):
        wanted = logsumexp(terms) + errors.noise_log_prior(weighed.noise["y"])
        assert weighed.log_z == pytest.approx(wanted, abs=0.3)


def test_around_a_mode_the_function_is_that_of_its_fit() -> None:
    """Whatever size and length are the most probable after it."""
    screened, explained = explained_by([PUSH, OWN], {"push": PUSHED})
    found = _with_each(screened, explained, explained.components["inflow"].best, [PUSH, OWN], 1, None)[0]
    kind = found.first
    other = next(x for x in PUSH.lengths if x != kind.weighed.best.length)
    cell = replace(kind.weighed.best, length=other, sd=2.0 * kind.weighed.best.sd)
    kind = replace(kind, weighed=replace(kind.weighed, best=cell))
    around = replace(found, first=kind).around
    values = kind.root @ kind.fit.u[1:]
    own = next(b for b in around.blocks if b.function is PUSH)
    computed = MODEL.solve({"level": kind.fit.values[0], "push": values})
    assert around.residual - own.columns @ values == pytest.approx(
        screened.screening.coefficients - screened.screening.errors.flat(computed), abs=1e-8
    )
    assert own.columns @ values == pytest.approx(found.around.blocks[-1].columns @ values)


def test_the_evidence_is_that_of_the_function_beside_which_the_second_stands() -> None:
    """Not of one that explains more with something else, nor of a size that its fit has not."""
    screened, explained = explained_by([PUSH, OWN], {"push": PUSHED})
    kind = explained.components["inflow"].best
    poor, rich = (replace(kind.weighed, log_z=kind.weighed.log_z + x) for x in (-50.0, 50.0))
    component = Component("inflow", (replace(kind, weighed=poor, more=rich), kind))
    assert component.best is not kind
    assert _alone(component) is kind
    found = _with_each(screened, explained, kind, [PUSH, OWN], 1, None)[0]
    assert found.log_z <= found.second.weighed.log_z
    larger = replace(found, first=replace(kind, weighed=rich))
    assert larger.log_z == pytest.approx(found.second.weighed.log_z)
    smaller = replace(found, first=replace(kind, weighed=poor))
    assert smaller.log_z < found.log_z - 40.0


def test_either_component_first_gives_the_evidence_of_both() -> None:
    echo = 0.1 * np.cos(6 * np.pi * TIMES)
    screened, explained = explained_by([PUSH, OWN], {"push": PUSHED, "own": echo})
    one, other = (
        _with_each(screened, explained, explained.components[name].best, [PUSH, OWN], 1, None)[0]
        for name in ("inflow", "sensor")
    )
    assert one.names == other.names
    best = max(c.log_z for c in explained.components.values())
    assert one.log_z > best + 10.0
    assert one.log_z == pytest.approx(other.log_z, abs=3.0)


def test_two_components_are_the_cause_where_neither_alone_is() -> None:
    found = diagnose(data_of(BOTH), MODEL, [], hooks=hooks([LAW, PUSH, OWN]), max_effects=1)
    assert set(found.cause[:2]) == {"wall", "inflow"}
    assert of(found, "wall").together["inflow"] > 0.9
    assert of(found, "inflow").together == pytest.approx({"wall": of(found, "wall").together["inflow"]} | {
        name: p for name, p in of(found, "inflow").together.items() if name != "wall"
    })  # fmt: skip
    assert {c.name for c in found.file.components if c.one_of_several} == {"wall", "inflow"}
    assert found.file.gap.after < 0.5 * min(of(found, n).gap_after for n in ("wall", "inflow"))
    assert "law and push" in found.file.verdict or "push and law" in found.file.verdict
    words = found.file.verdict.partition("; of its energy ")[2]
    assert all(word in words for word in ("each hold a part", "wall", "inflow"))
    wall = of(found, "wall").functions[0]
    inside = np.abs(KNOTS) < 1.2
    inside[[0, -1]] = False
    true = 0.1 * np.cos(2.0 * KNOTS)
    held = (np.array(wall.low) <= true) & (true <= np.array(wall.high))
    assert held[inside].mean() >= 0.8


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_of_two_pairs_the_more_probable_is_what_is_told(order: tuple[int, int]) -> None:
    screened, explained = explained_by([LAW, PUSH, OWN], BOTH)
    pair = pairs_of(screened, explained, [LAW, PUSH, OWN], cores=1)[0]
    fit = replace(pair.fit, u=pair.fit.u + 1e-6)
    less = replace(
        pair, names=(pair.names[0], "sensor"), second=replace(pair.second, fit=fit),
        log_prior=pair.log_prior - 1.0,
    )  # fmt: skip
    both = [pair, less]
    scored = score(screened, explained, pairs=[both[i] for i in order])
    assert scored.pair is pair
    assert scored.best[scored.leader] is pair.fit
    assert scored.members(scored.leader)[:2] == list(pair.names)
    assert not set(scored.twins(scored.leader)) & set(pair.names)


def test_two_components_that_leave_more_than_noise_are_no_cause() -> None:
    """Flexible functions may draw much of what each series has as an error of its own."""
    screened, explained = explained_by([LAW, PUSH, OWN], BOTH)
    pair = pairs_of(screened, explained, [LAW, PUSH, OWN], cores=1)[0]
    for more, kept in ((0.5, True), (1.5, False)):
        size = np.abs(pair.fit.residual) * (1.0 + more)
        fit = replace(pair.fit, residual=np.sign(pair.fit.residual) * size)
        scored = score(screened, explained, pairs=[replace(pair, second=replace(pair.second, fit=fit))])
        assert (len(scored.pairs) == 1) == kept == (scored.pair is not None)


def test_one_cause_is_no_pair() -> None:
    found = diagnose(data_of({"push": PUSHED}), MODEL, [], hooks=hooks([LAW, PUSH, OWN]), max_effects=1)
    assert found.cause[0] == "inflow"
    together = [p for c in found.file.components for p in c.together.values()]
    assert max(together, default=0.0) < 0.5
    assert not any(c.one_of_several for c in found.file.components)
    assert "each hold a part" not in found.file.verdict
    total = sum(c.probability for c in found.file.components)
    assert total <= 1.0 + 1e-9


def test_of_one_series_two_components_stay_possible_and_count_for_all_alike() -> None:
    """Each of the three pairs draws it as well as the better of its two, with a tenth of the prior of one."""
    found = diagnose(
        first_of(data_of({"push": PUSHED})), FIRST, [], hooks=hooks([LAW, PUSH, TWIN]), max_effects=1
    )
    scored = found.rounds[0]
    z = {name: c.log_z for name, c in scored.components.items()}
    assert z["inflow"] == pytest.approx(z["outlets"], abs=0.1)
    assert z["wall"] < z["inflow"] - 10.0
    # three pairs have 0.1 of the prior of all three components, so each has that of one over ten
    assert scored.untold == pytest.approx(0.1 * 3 * scored.probability["inflow"], rel=0.05)
    assert of(found, "wall").probability == pytest.approx(scored.untold / 3, abs=0.01)
    assert sum(c.probability for c in found.file.components) <= 1.0 + 1e-9
    assert any(f"are wrong, {scored.untold:.0%}, is shared equally" in w for w in found.file.warnings)
    both = diagnose(data_of({"push": PUSHED}), MODEL, [], hooks=hooks([LAW, PUSH, TWIN]), max_effects=1)
    assert both.rounds[0].untold == 0.0


def test_of_one_series_that_no_component_explains_two_are_not_likely() -> None:
    scored = diagnose(first_of(data_of({})), FIRST, [], hooks=hooks([LAW, PUSH, TWIN]), max_effects=1).rounds[
        0
    ]
    assert scored.leader == "no-gap"
    assert scored.untold < 0.05
