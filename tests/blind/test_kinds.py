"""Kinds of sets: causes of known components, pairs, small ones and noise; what their key says."""

from __future__ import annotations

import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zoo.blood.baseline import get_baseline
from zoo.blood.blind import BlindError, make_cases
from zoo.blood.blind.bench import GENERATOR
from zoo.blood.blind.causes import CAUSES, COMPONENTS
from zoo.blood.blind.causes.outlets import SHORTEST, constant_phase_sections, tapering_ladder
from zoo.blood.blind.draw import CATALOGUE_SET, SETS, SMALL_GAPS, Draw
from zoo.blood.case import simulate
from zoo.blood.effects import CATALOGUE
from zoo.blood.study import load_study
from zoo.core.effects import EVERYWHERE
from zoo.core.parameters import pack, start_of

# loads and stiffness of a case are drawn, some of them beyond what is usual
pytestmark = pytest.mark.filterwarnings("ignore::zoo.blood.study.UnitWarning")

KINDS = [kind for kind in SETS if kind != CATALOGUE_SET]
N = {"component": 3, "pair": 2, "small": 3, "coloured": 2}


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory, tiny: dict[str, Any]) -> dict[str, tuple[Path, Path]]:
    """A few cases of each kind, and their key."""
    folder = tmp_path_factory.mktemp("kinds")
    for kind in KINDS:
        make_cases(folder / kind, N[kind], folder / f"{kind}.json", kind=kind, **tiny)
    return {kind: (folder / kind, folder / f"{kind}.json") for kind in KINDS}


def entries(sets: dict[str, tuple[Path, Path]], kind: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(sets[kind][1].read_text())["cases"]
    return found


@pytest.mark.parametrize("name", sorted(CAUSES))
def test_causes_are_in_no_catalogue_and_grow_from_0(name: str) -> None:
    assert name not in CATALOGUE
    study = load_study("demo")
    flow = get_baseline("linear-constant").forward(study)
    case = flow.configure(pack(flow.parameters, start_of(flow.parameters)))
    cause = CAUSES[name]
    effect, size, shape = cause.draw(np.random.default_rng(5))
    assert cause.low <= size <= cause.high
    assert set(shape) == set(cause.shapes)
    apply = effect.apply
    assert apply is not None
    places = [(1, 0.0, "pressure_mmHg"), (3, 0.5, "pressure_mmHg")]

    def wave(x: float) -> Any:
        return simulate(apply(case, (x,), EVERYWHERE), places, study.time_s)

    plain = simulate(case, places, study.time_s)
    sizes = [float(np.abs(wave(x) - plain).max()) for x in (1e-3 * cause.low, cause.low, cause.high)]
    assert np.array_equal(wave(0.0), plain)
    assert sizes[0] < max(0.1 * sizes[1], 0.01)
    assert sizes[1] < sizes[2]
    assert sizes[2] > 0.05


def test_plans_are_even_over_components_and_pairs() -> None:
    def plan(kind: str, n: int) -> list[tuple[str, str]]:
        return Draw(n, "4" * 32, tuple(CATALOGUE), kind=kind).plan()

    found = plan("component", 10 * len(COMPONENTS))
    assert {kind for kind, _ in found} == {"component"}
    assert set(Counter(CAUSES[name].component for _, name in found).values()) == {10}
    for component in COMPONENTS:  # each cause of a component as often, but for one
        counts = Counter(name for _, name in found if CAUSES[name].component == component)
        assert max(counts.values()) - min(counts.values()) <= 1
    pairs = math.comb(len(COMPONENTS), 2)
    assert set(Counter(name for _, name in plan("pair", 2 * pairs)).values()) == {2}
    assert Counter(kind for kind, _ in plan("small", 20)) == {"none": 4, "listed": 8, "component": 8}
    assert {kind for kind, _ in plan("coloured", 20)} == {"none"}


def test_a_catalogue_s_key_and_streams_are_those_of_older_ones() -> None:
    """Cases of an older key are made again from its secret: neither head nor seeds may change."""
    import hashlib

    draw = Draw(40, "7" * 32, ("a", "b"), layouts=("MPA",))
    assert "kind" not in draw.head
    seed = hashlib.sha256(json.dumps([2, "7" * 32, 40, "noise", 3]).encode()).digest()
    expected = np.random.default_rng(int.from_bytes(seed)).random(4)
    assert np.array_equal(draw.rng("noise", 3).random(4), expected)
    assert Draw(40, "7" * 32, ("a", "b"), kind="pair").rng("noise", 3).random() not in expected


def test_a_constant_phase_circuit_has_the_impedance_of_its_law() -> None:
    """Sections against 1/(1 + (i x)^order), x = w R2 C, up to what is faster than the shortest section."""
    for lack in (0.1, 0.3, 0.6):
        fast, rho, kappa = constant_phase_sections(lack)
        assert fast + rho.sum() == pytest.approx(1.0)
        assert np.all(rho > 0)
        x = np.geomspace(1.0, 0.2 * math.exp(-SHORTEST), 20)
        circuit = fast + np.sum(rho / (1 + 1j * x[:, None] * rho * kappa), axis=1)
        law = 1 / (1 + (1j * x) ** (1 - lack))
        # what is slower than the longest section is at it, which is felt at low frequencies alone
        assert np.abs(circuit - law).max() < 0.04
        assert np.abs(circuit - law)[x > 3].max() < 0.015


def test_a_tapering_ladder_has_the_impedance_of_its_nodes() -> None:
    """Foster's form against the ladder put together from its far end, resistances in series with nodes."""
    rho, kappa = tapering_ladder(0.5, 1.7, 6)
    R, C = 0.5 ** np.arange(6), 1.7 ** np.arange(6)
    R, C = R / R.sum(), C / C.sum()
    for w in (0.0, 0.3, 2.0, 30.0):
        z = 0j
        for r, c in zip(R[::-1], C[::-1], strict=True):
            z = 1 / (1j * w * c + 1 / (r + z))
        assert np.sum(rho / (1 + 1j * w * rho * kappa)) == pytest.approx(z, rel=1e-9)
    uniform = tapering_ladder(1.0, 1.0, 1)
    assert (uniform[0][0], uniform[1][0]) == pytest.approx((1.0, 1.0))


def test_keys_tell_components_and_what_the_true_cause_leaves(sets: dict[str, tuple[Path, Path]]) -> None:
    for kind, many in (("component", 1), ("pair", 2)):
        for e in entries(sets, kind):
            assert e["kind"] == kind
            assert [x["component"] for x in e["effects"]] == e["components"]
            assert len(e["components"]) == many
            assert {f["component"] for f in e["functions"]} == set(e["components"])
            noise = math.hypot(e["noise"]["white"]["mmHg"], e["noise"]["correlated_mmHg"])
            assert 0.45 * noise < e["gap_mmHg"]["before"] < 22 * noise
            # six parameters at most, fitted to 512 samples
            assert e["refit_with_true_effects"]["gap_mmHg"] < 0.5 * noise


def test_small_and_coloured_sets_hold_their_limits(sets: dict[str, tuple[Path, Path]]) -> None:
    kinds = Counter(e["kind"] for e in entries(sets, "small"))
    assert kinds == {"none": 1, "listed": 1, "component": 1}
    assert json.loads(sets["small"][1].read_text())["gap_over_noise"] == list(SMALL_GAPS)
    for e in entries(sets, "small"):
        noise = math.hypot(e["noise"]["white"]["mmHg"], e["noise"]["correlated_mmHg"])
        assert e["gap_mmHg"]["before"] < 1.1 * SMALL_GAPS[1] * noise
    for e in entries(sets, "coloured"):
        assert e["effect"] == "no-gap"
        assert 0.3 <= e["noise"]["correlated_mmHg"] / e["noise"]["white"]["mmHg"] <= 2.0
        assert 1e-3 <= e["noise"]["correlation_time_s"] <= 8e-3


def test_the_key_s_causes_make_the_data(sets: dict[str, tuple[Path, Path]]) -> None:
    """The baseline with the key's causes, solved here, gives the key's noise-free data."""
    for e in [*entries(sets, "component"), *entries(sets, "pair")]:
        study = load_study(sets[e["kind"]][0] / e["case"])
        flow = get_baseline(e["base"]).forward(study, options=GENERATOR)
        case = flow.configure(pack(flow.parameters, e["base_parameters"]))
        for effect in e["effects"]:
            cause = CAUSES[effect["effect"]]
            made = cause.effect(e["shapes"][cause.name])
            assert made.apply is not None
            case = made.apply(case, tuple(effect["amplitudes"].values()), EVERYWHERE)
        waves = simulate(case, [(s.vessel, s.position, s.quantity) for s in study.series], study.time_s)
        truth = np.array([[float(x) for x in row.split()] for row in e["truth"].values()])
        assert np.allclose(truth, waves, atol=2e-4)


def test_nothing_but_the_values_tells_the_kind(sets: dict[str, tuple[Path, Path]]) -> None:
    """Files of all kinds have the sizes, times and columns of one another; no name of a cause is in them."""
    sizes: dict[str, set[int]] = {}
    times = set()
    words = {name.encode() for name in CAUSES} | {b"component", b"pair", b"small", b"coloured"}
    for folder, _ in sets.values():
        for path in folder.rglob("*"):
            times.add(path.stat().st_mtime)
            if path.is_file() and path.parent != folder:
                sizes.setdefault(path.name, set()).add(path.stat().st_size)
                assert not any(word in path.read_bytes() for word in words)
    assert len(times) == 1
    assert {name: len(found) for name, found in sizes.items()} == dict.fromkeys(
        ("study.toml", "network.toml", "inflow.csv", "observations.csv"), 1
    )


def test_an_unknown_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BlindError, match="kind = 'pairs'"):
        make_cases(tmp_path / "cases", key=tmp_path / "key.json", kind="pairs")
