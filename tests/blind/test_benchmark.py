"""The benchmark's causes, which no catalogue lists, its sets, keys made elsewhere, and the frozen cases."""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import benchmarks.blind.frozen.__main__ as frozen
import numpy as np
import pytest
from benchmarks.blind.causes import CAUSES, COMPONENTS, SHORTEST, constant_phase_sections, ladder_sections
from benchmarks.blind.other_keys import other_keys
from benchmarks.blind.sets import COMPARABLE, KINDS, QUIET, QUIET_MMHG, SMALL, make_set, plan
from benchmarks.other_states import row_of

from zoo.blood.baseline import get_baseline
from zoo.blood.blind.study_cases import GAP_OVER_NOISE, GENERATOR
from zoo.blood.case import simulate
from zoo.blood.effects import CATALOGUE
from zoo.blood.study import load_study
from zoo.core.blindcheck import Answer, BlindError
from zoo.core.blindcheck.folders import case_files, digest_of, read_key
from zoo.core.blindcheck.scoring import QUESTIONS
from zoo.core.effects import EVERYWHERE
from zoo.core.parameters import pack, start_of

# loads and stiffness of a case are drawn, some of them beyond what is usual
pytestmark = pytest.mark.filterwarnings("ignore::zoo.blood.study.UnitWarning")

N = {"component": 3, "pair": 2, "small": 5, "quiet": 5, "coloured": 2}


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Path]]:
    """A few cases of each kind, and their key."""
    folder = tmp_path_factory.mktemp("kinds")
    for kind in KINDS:
        make_set(folder / kind, folder / f"{kind}.json", kind, N[kind], "5" * 32, ["MPA"], cores=1)
    return {kind: (folder / kind, folder / f"{kind}.json") for kind in KINDS}


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
    rho, kappa = ladder_sections(0.5, 1.7, 6)
    R, C = 0.5 ** np.arange(6), 1.7 ** np.arange(6)
    R, C = R / R.sum(), C / C.sum()
    for w in (0.0, 0.3, 2.0, 30.0):
        z = 0j
        for r, c in zip(R[::-1], C[::-1], strict=True):
            z = 1 / (1j * w * c + 1 / (r + z))
        assert np.sum(rho / (1 + 1j * w * rho * kappa)) == pytest.approx(z, rel=1e-9)
    uniform = ladder_sections(1.0, 1.0, 1)
    assert (uniform[0][0], uniform[1][0]) == pytest.approx((1.0, 1.0))


def test_plans_are_even_over_components_and_pairs() -> None:
    assert set(Counter(plan("component", 70, "4" * 32)).values()) == {10}
    pairs = math.comb(len(COMPONENTS), 2)
    found = Counter(plan("pair", 2 * pairs, "4" * 32))
    assert (len(found), set(found.values())) == (pairs, {2})
    small = plan("small", 20, "4" * 32)
    assert (small.count("no-gap"), sum(x in CATALOGUE for x in small)) == (4, 8)
    assert set(plan("coloured", 20, "4" * 32)) == {"no-gap"}


def test_keys_tell_components_and_gaps_in_range(sets: dict[str, tuple[Path, Path]]) -> None:
    for kind in KINDS:
        for key in read_key(sets[kind][1])[1]:
            low, high = SMALL if kind == "small" else GAP_OVER_NOISE
            if kind == "quiet":
                low, high = (x / QUIET_MMHG for x in QUIET)
            white, correlated = key.drawn["white"]["mmHg"], key.drawn["correlated"]
            assert key.noise == pytest.approx(math.hypot(white, correlated["mmHg"]))
            assert key.kind == "none" or low <= key.gap / key.noise <= high  # type: ignore[operator]
            assert len(key.components) == {"none": 0, "listed": 1, "component": 1, "pair": 2}[key.kind]
            if kind == "coloured":
                assert key.accepted == ()
                assert 0.3 <= correlated["mmHg"] / white <= 2.0
                assert 1e-3 <= correlated["s"] <= 8e-3
    kinds = Counter(key.kind for key in read_key(sets["small"][1])[1])
    assert kinds == {"none": 1, "listed": 2, "component": 2}
    assert COMPARABLE > 1


def test_the_key_s_causes_make_the_data(sets: dict[str, tuple[Path, Path]]) -> None:
    """The baseline with the key's causes, solved here, gives the key's noise-free data."""
    for kind in ("component", "pair"):
        for key in read_key(sets[kind][1])[1]:
            study = load_study(sets[kind][0] / key.case)
            flow = get_baseline("linear-constant").forward(study, options=GENERATOR)
            case = flow.configure(pack(flow.parameters, key.drawn["base_parameters"]))
            for effect in key.drawn["effects"]:
                cause = CAUSES[effect["effect"]]
                made = cause.effect(key.drawn["shapes"][cause.name])
                assert made.apply is not None
                case = made.apply(case, tuple(effect["amplitudes"].values()), EVERYWHERE)
            waves = simulate(case, [(s.vessel, s.position, s.quantity) for s in study.series], study.time_s)
            assert np.allclose(np.array(key.truth), waves, atol=2e-4)


def test_nothing_but_the_values_tells_the_kind(sets: dict[str, tuple[Path, Path]]) -> None:
    """Files of all kinds have the same times; no name of a cause is in them."""
    times = set()
    words = {name.encode() for name in CAUSES} | {b"component", b"pair", b"small", b"coloured"}
    for folder, _ in sets.values():
        for path in folder.rglob("*"):
            times.add(path.stat().st_mtime)
            if path.is_file() and path.parent != folder:
                assert not any(word in path.read_bytes() for word in words)
    assert len(times) == 1


# -- keys made elsewhere -----------------------------------------------------------------------------


def other(folder: Path, **changes: Any) -> Any:
    content = {
        "case": "case-101", "effect": "junction_loss", "in_library": True, "amplitude": 3.0, "extra": {},
        "layout": "MPA", "observed": [[1, 0.0]], "noise": {"white_sd_mmHg": 0.03, "ar1_sd_mmHg": 0.04},
        "theta": {"chi": 4e4, "c": 1.5},
        "base_fit": {"rms_noisefree_mmHg": [0.2, 0.4]},
    } | changes  # fmt: skip
    (folder / "case-101.json").write_text(json.dumps(content))
    [found] = other_keys(folder, "blind/")
    return found


@pytest.mark.parametrize(
    ("changes", "kind", "effects", "amplitude"),
    [
        ({}, "listed", ("minor-losses",), 3.0),
        ({"effect": None, "amplitude": 0.0}, "none", (), None),
        ({"effect": "active_tone", "in_library": False}, "outside", (), None),
        ({"effect": "distributed_outflow", "amplitude": 4}, "listed", ("distributed-outflow",), 3.0),
        ({"effect": "velocity_profile", "amplitude": 2.0}, "listed", ("velocity-profile",), 1.0),
        ({"effect": "nonlinear_wall", "amplitude": 0.3}, "listed", ("tangent-wall",), 0.3),
        ({"effect": "catheter_gain", "amplitude": 0.2}, "listed", ("sensor-gain",), 0.2),
        ({"effect": "correlated_noise"}, "listed", (), None),
        ({"effect": "coarse_grid"}, "listed", ("coarse-grid",), None),
    ],
)
def test_keys_made_elsewhere(
    changes: dict[str, Any], kind: str, effects: tuple[str, ...], amplitude: float | None, tmp_path: Path
) -> None:
    found = other(tmp_path, **changes)
    assert (found.case, found.kind, found.effects) == ("blind/case-101", kind, effects)
    assert found.parameter == amplitude
    assert found.parameters == {"f3": 4e4, "c": 1.5}
    assert found.noise == pytest.approx(0.05)
    assert found.gap == pytest.approx(math.sqrt((0.04 + 0.16) / 2))
    assert other(tmp_path, effect="stenosis", extra={"vessel": 3}).place == 3
    with pytest.raises(BlindError, match="not in the catalogue"):
        other(tmp_path, effect="warp_drive")


@pytest.mark.needs_data
def test_the_independent_simulators_keys_are_read(data_dir: Path) -> None:
    keys = frozen.keys_elsewhere(data_dir.parent)
    assert Counter(key.tags["set"] for key in keys) == {"blind": 13, "blind2": 5}
    assert {key.kind for key in keys} >= {"none", "listed", "outside", "component"}


# -- frozen cases ------------------------------------------------------------------------------------


def test_frozen_cases_are_those_of_their_keys(tmp_path: Path) -> None:
    """Every case unpacks to the files that its key has the digest of, and is a study; no other is there."""
    keys = {key.case: key for key in frozen.frozen_keys()}
    frozen.unpack(tmp_path, frozen.sets())
    folders = {f"{p.parent.name}/{p.name}": p for p in tmp_path.glob("*/*")}
    assert folders.keys() == keys.keys()
    for name, folder in folders.items():
        assert digest_of(case_files(folder)) == keys[name].files
    for name in list(folders)[::40]:
        study = load_study(folders[name])
        assert np.shape(keys[name].truth) == study.values.shape


def test_frozen_answers_are_shared_out_among_components_and_nothing() -> None:
    """Rivals of which one is true: together they have all, whether by component, by name or by group."""
    keys, lines = frozen.frozen_keys(), frozen.frozen_lines()
    for case, answer in frozen.frozen_answers().items():
        assert answer is not None
        assert answer.nothing + sum(answer.components.values()) == pytest.approx(1.0, abs=0.005)
        own = {e["name"]: e["probability"] for e in lines[case]["answer"]["explanations"]}
        assert all(own[name] == p for name, p in answer.effects.items())
        assert sorted(n for g in answer.groups for n in g.names) == sorted(answer.effects)
        assert sum(g.probability for g in answer.groups) >= sum(answer.effects.values()) - 1e-9
    score = frozen.score_of(keys, frozen.frozen_answers())
    assert set(score.summary["questions"]) == set(QUESTIONS)
    assert score.by["set"]["pair"]["questions"]["components"].log.mean < -10  # of two one has nearly all
    assert score.summary["left"].n > 100


def test_more_cases_of_a_seed_are_the_same_and_others() -> None:
    keys = frozen.frozen_keys()
    few, more = (frozen.chosen_keys(keys, n, 3) for n in (2, 4))
    assert few.items() <= more.items()
    assert set(Counter(key.tags["set"] for key in more.values()).values()) == {4}
    assert few != frozen.chosen_keys(keys, 2, 4)
    assert len(frozen.chosen_keys(keys, None, 3)) == len(keys)


def test_today_s_answers_stand_beside_the_former_ones_and_a_run_goes_on(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[str] = []

    def guess(self: Any, case: Path, out: Path) -> Answer:
        asked.append(case.name)
        return Answer(components={"wall": 0.25}, nothing=0.75)

    monkeypatch.setattr("zoo.blood.blind.StudyDiagnosis.__call__", guess)
    monkeypatch.delenv("ZOO_DATA_DIR", raising=False)
    for each, diagnosed in ((2, 2), (3, 3)):
        arguments = ["--kinds", "coloured", "--each", str(each), "--run", str(tmp_path), "--cores", "1"]
        monkeypatch.setattr(sys, "argv", ["frozen", *arguments])
        frozen.main()
        assert len(asked) == len(set(asked)) == diagnosed
    printed = capsys.readouterr().out
    assert "c4fb767" in printed
    assert "| 3 cases, 0 without an answer |" in printed
    assert "| coloured | that nothing is wrong | 3 | -0.288 ± 0.000 |" in printed


def test_what_follows_from_one_state_in_another_is_read_from_the_file() -> None:
    """The leader and whether it holds, and other components that hold where they are not true."""
    left = [SimpleNamespace(mean=x) for x in (0.1, 0.08, 0.01, 0.02)]
    carried = [
        SimpleNamespace(names=[name], holds=True, error=error)
        for name, error in zip(("wall", "geometry"), left[2:], strict=True)
    ]
    first = SimpleNamespace(causes=["law, softer"], components=["wall"], probability=0.8)
    state = SimpleNamespace(carried=carried, baseline=left[0], sensor=left[1])
    file: Any = SimpleNamespace(cause=first.causes, sets=[first], states=[state])
    row = row_of("wall", file)
    assert (row["right"], row["holds"], row["others hold"]) == (True, True, True)
    assert row["errors"] == (0.1, 0.08, 0.01)
    assert row_of("fluid", file)["right"] is False
    nothing: Any = SimpleNamespace(
        cause=[], sets=[first, SimpleNamespace(causes=[], components=[], probability=0.1)]
    )
    nothing.states = file.states
    assert row_of("wall", nothing)["errors"] == (0.1, 0.08, 0.1)
