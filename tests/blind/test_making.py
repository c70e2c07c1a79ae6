"""Making blind cases: files that tell nothing of the effect, and a key that tells all."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import zoo.blood.blind.make as making
from zoo.blood.baseline import get_baseline
from zoo.blood.blind import BlindError, make_cases
from zoo.blood.blind.bench import GENERATOR
from zoo.blood.blind.draw import Draw
from zoo.blood.blind.effect_draw import GAP_MMHG
from zoo.blood.blind.networks import tree
from zoo.blood.blind.noise import autoregressive
from zoo.blood.blind.outside import OUTSIDE, leaking_valve
from zoo.blood.blind.visibility import visible_amplitude
from zoo.blood.case import Case, simulate
from zoo.blood.diagnosis import SEARCH_SHARE
from zoo.blood.effects import CATALOGUE, EffectParameter, Location
from zoo.blood.solver import Physics, Solver
from zoo.blood.study import load_study
from zoo.core.blindcheck.sealing import KEY_DIGEST
from zoo.core.parameters import pack, start_of


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# -- make --------------------------------------------------------------------------------------------


def test_cases_are_studies_and_the_key_is_apart(made: tuple[Path, Path]) -> None:
    cases, key = made
    entries = json.loads(key.read_text())
    assert [e["case"] for e in entries] == ["case-001", "case-002", "case-003"]
    assert sorted(e["kind"] for e in entries) == ["listed", "listed", "outside"]
    digest = (cases / KEY_DIGEST).read_text().split()[0]
    assert digest == hashlib.sha256(key.read_bytes()).hexdigest()
    assert sorted(contents(cases)) == sorted(
        [KEY_DIGEST]
        + [
            f"{e['case']}/{f}"
            for e in entries
            for f in ("study.toml", "network.toml", "inflow.csv", "observations.csv")
        ]
    )
    for e in entries:
        study = load_study(cases / e["case"])
        assert study.checksum == e["digest"]
        assert len(study.time_s) == 512
        gap = e["gap_mmHg"]
        assert GAP_MMHG[0] * 0.9 < gap["before"] < GAP_MMHG[1] * 1.1
        assert gap["after"] < 0.4 * gap["before"]
        for effect in e["effects"]:
            known = CATALOGUE.get(effect["effect"]) or OUTSIDE[effect["effect"]]
            for a in known.parameters:
                assert a.low <= effect["amplitudes"][a.name] <= a.high


def test_data_are_the_truth_and_noise_of_the_stated_size(made: tuple[Path, Path]) -> None:
    """The key's effect at its amplitude, solved here, leaves noise of 0.05 mmHg (0.064 with its AR part)."""
    cases, key = made
    e = next(e for e in json.loads(key.read_text()) if e["kind"] == "listed")
    study = load_study(cases / e["case"])
    flow = get_baseline(e["base"]).forward(study, options=GENERATOR)
    case = flow.configure(pack(flow.parameters, e["base_parameters"]))
    [effect] = e["effects"]
    values = tuple(effect["amplitudes"].values())
    case = CATALOGUE[effect["effect"]].apply(case, values, Location(effect["vessel"], effect["subtree"]))  # type: ignore[misc]
    waves = simulate(case, [(s.vessel, s.position, s.quantity) for s in study.series], study.time_s)
    sd = math.hypot(0.05, e["noise"]["correlated_mmHg"])
    assert np.std(study.values - waves) == pytest.approx(sd, rel=0.25)


def test_the_grid_is_not_the_diagnosis_own() -> None:
    for study in (load_study("demo"), replace(load_study("demo"), numerics={})):
        flow = get_baseline("B").forward(study, share=SEARCH_SHARE)
        its, own = (Solver.for_study(study, options=o).grid()[0] for o in (flow.options, GENERATOR))
        assert np.all(own > 2 * its)
        assert np.any(own % its)
        assert GENERATOR.cfl != flow.options.cfl


def test_same_seed_same_files_and_another_seed_others(
    made: tuple[Path, Path], tiny: dict[str, Any], tmp_path: Path
) -> None:
    cases, key = made
    again = make_cases(tmp_path / "cases", 3, 5, tmp_path / "other.json", **tiny)
    assert contents(tmp_path / "cases") == contents(cases)
    assert again.read_bytes() == key.read_bytes()
    other, same = (Draw(40, s, tuple(CATALOGUE)).plan() for s in (1, 2))
    assert other != same


def test_an_interrupted_make_goes_on(
    made: tuple[Path, Path], tiny: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cases, key = made
    drawn: list[str] = []
    original = making.draw_case

    def stopping(job: Any) -> dict[str, Any]:
        if job.name == "case-003" and "case-003" not in drawn:
            drawn.append(job.name)
            raise KeyboardInterrupt
        drawn.append(job.name)
        return original(job)

    monkeypatch.setattr(making, "draw_case", stopping)
    arguments = (tmp_path / "cases", 3, 5, tmp_path / "key.json")
    with pytest.raises(KeyboardInterrupt):
        make_cases(*arguments, **tiny)
    assert not (tmp_path / "key.json").exists()
    finished: list[str] = []
    make_cases(*arguments, **tiny, done=finished.append)
    assert drawn == ["case-001", "case-002", "case-003", "case-003"]
    assert finished == ["case-001", "case-002", "case-003"]
    assert contents(tmp_path / "cases") == contents(cases)
    assert (tmp_path / "key.json").read_bytes() == key.read_bytes()
    assert not list(tmp_path.glob("*.part"))
    make_cases(*arguments, **tiny)  # complete: nothing is drawn again
    assert len(drawn) == 4
    with pytest.raises(BlindError, match="another draw"):
        make_cases(tmp_path / "cases", 3, 6, tmp_path / "key.json", **tiny)


def test_nothing_but_the_values_depends_on_the_effect(
    made: tuple[Path, Path], tiny: dict[str, Any], tmp_path: Path
) -> None:
    """A guesser that sees everything else sees the same for two draws with different effects."""
    cases, key = made
    others = ("sensor-gain", "inflow-gain", "catheter-resonance", "inflow-offset")
    make_cases(tmp_path / "cases", 3, 5, tmp_path / "key.json", **tiny | {"effects": others})
    own, other = (json.loads(k.read_text()) for k in (key, tmp_path / "key.json"))
    assert [e["effect"] for e in own] != [e["effect"] for e in other]

    def seen(folder: Path) -> dict[Any, Any]:
        found: dict[Any, Any] = {}
        for path in sorted(folder.rglob("*")):
            name, stat = str(path.relative_to(folder)), path.stat()
            found[name, "time"], found[name, "mode"] = (stat.st_mtime, stat.st_atime >= 0), stat.st_mode
            if path.is_file():
                found[name, "size"] = stat.st_size
                text = path.read_text()
                if path.name == "observations.csv":
                    rows = [line.rsplit(",", 1) for line in text.splitlines()]
                    text = "\n".join(row[0] for row in rows)
                    found[name, "widths"] = {len(row[1]) for row in rows[1:]}
                    found[name, "digits"] = {len(row[1].split(".")[1]) for row in rows[1:]}
                if path.name != KEY_DIGEST:
                    found[name, "text"] = text
        return found

    assert seen(cases) == seen(tmp_path / "cases")
    for e in (*own, *other):
        words = {e["kind"], e["effect"], *(x["effect"] for x in e["effects"])} - {"none"}
        for name, content in contents(cases).items():
            assert not any(word.encode() in content for word in words), name


def test_sizes_times_and_widths_are_those_of_the_layout_alone(made: tuple[Path, Path]) -> None:
    cases, _ = made
    folders = sorted(p for p in cases.iterdir() if p.is_dir())
    for name in ("study.toml", "network.toml", "inflow.csv", "observations.csv"):
        assert len({(p / name).stat().st_size for p in folders}) == 1
    assert len({p.stat().st_mtime for p in cases.rglob("*")}) == 1


def test_the_order_of_cases_tells_nothing() -> None:
    """Guess each case's kind from its neighbours and its place in the list: no better than by chance."""
    right = total = 0
    for seed in range(20):
        plan = Draw(40, seed, tuple(CATALOGUE)).plan()
        kinds = [kind for kind, _ in plan]
        assert (kinds.count("none"), kinds.count("outside"), kinds.count("listed")) == (5, 8, 27)
        right += sum(a == b == "outside" for a, b in itertools.pairwise(kinds))
        total += sum(a == "outside" for a in kinds[:-1])
    low, high = binom.interval(0.999, total, 7 / 39)
    assert low <= right <= high
    first = [Draw(40, seed, tuple(CATALOGUE)).plan()[0][0] for seed in range(200)]
    low, high = binom.interval(0.999, 200, 27 / 40)
    assert low <= first.count("listed") <= high


def test_effects_come_evenly() -> None:
    names = [name for kind, name in Draw(120, 3, tuple(CATALOGUE)).plan() if kind == "listed"]
    counts = {name: names.count(name) for name in CATALOGUE}
    assert set(counts.values()) <= {2, 3}
    assert "correlated-noise" in counts


def test_an_amplitude_is_kept_or_scaled_into_the_range() -> None:
    a = EffectParameter("a", "1", 1.0, -4.0, 4.0, (1.0,))
    limits = (0.15, 1.0)
    assert visible_amplitude(lambda x: abs(x) / 2, a, -1.2, limits, 0.5)[0] == -1.2
    value, *_ = visible_amplitude(lambda x: abs(x) ** 3, a, 2.0, limits, 0.5)
    assert value is not None
    assert 0.15 <= value**3 <= 1.0
    # only the other side of 0 shows anything
    value, *_ = visible_amplitude(lambda x: max(0.0, -x) / 20, a, 1.0, limits, 0.18)
    assert value is not None
    assert -4.0 <= value <= -3.0
    # the solve fails beyond 2
    value, *_ = visible_amplitude(lambda x: abs(x) / 10 if abs(x) < 2 else math.inf, a, 3.0, limits, 0.17)
    assert value is not None
    assert 1.5 <= abs(value) < 2
    found, smallest, largest = visible_amplitude(lambda x: abs(x) / 100, a, 1.0, limits, 0.5)
    assert found is None
    assert largest == pytest.approx(0.04)
    switch = EffectParameter("s", "1", 0.5, 0.1, 1.2, (0.2,))
    found, smallest, _ = visible_amplitude(lambda x: 2.0 + x, switch, 0.5, limits, 0.5)
    assert found is None
    assert smallest > 1.0


@pytest.mark.parametrize("n", [5, 9, 15])
def test_trees_bifurcate_and_narrow(n: int) -> None:
    rows = tree(np.random.default_rng(n), n)
    parents = [parent for _, parent, _, _ in rows]
    assert len(rows) == n
    assert all(parents.count(i) in (0, 2) for i, _, _, _ in rows)
    radius = {i: r for i, _, _, r in rows}
    for i in {p for p in parents if p is not None}:
        sides = [radius[j] for j, p, _, _ in rows if p == i]
        assert sum(r**3 for r in sides) == pytest.approx(radius[i] ** 3, rel=0.6)
    assert all(length >= 0.05 and length <= 15 * r + 0.05 for _, _, length, r in rows)


def at_start(study: Any) -> Case:
    """The baseline's case where a search begins."""
    flow = get_baseline("linear-constant").forward(study)
    return flow.configure(pack(flow.parameters, start_of(flow.parameters)))


@pytest.mark.parametrize("name", sorted(OUTSIDE))
def test_outside_effects_are_in_no_catalogue_and_grow_from_0(name: str) -> None:
    assert name not in CATALOGUE
    if name == "active-tone" and not hasattr(Physics(), "stiffness_wave"):
        pytest.skip("this solver's stiffness cannot change within the beat")
    study = load_study("demo")
    case = at_start(study)
    apply = OUTSIDE[name].apply
    assert apply is not None

    def wave(x: float) -> Any:
        return simulate(apply(case, (x,), Location()), [(1, 0.0, "pressure_mmHg")], study.time_s)

    plain = simulate(case, [(1, 0.0, "pressure_mmHg")], study.time_s)
    small, large = (float(np.abs(wave(x) - plain).max()) for x in (0.05, 0.1))
    assert np.allclose(wave(0.0), plain, atol=1e-3)
    assert small > 0.02
    assert large == pytest.approx(2 * small, rel=0.3)


def test_leaking_valve_returns_its_share_in_diastole() -> None:
    study = load_study("demo")
    case = at_start(study)
    changed = leaking_valve(case, (0.2,), Location())
    assert changed.inflow_ml_s.mean() == pytest.approx(0.8 * case.inflow_ml_s.mean())
    moved = changed.inflow_ml_s != case.inflow_ml_s
    assert case.inflow_ml_s[moved].max() <= 0.02 * case.inflow_ml_s.max()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"n": 0}, "n = 0"),
        ({"layouts": ("MPA", "LPA")}, "give some of MPA"),
        ({"effects": ("sensor-gain",)}, "give two or more"),
        ({"vessels": (4, 4)}, "odd number"),
    ],
)
def test_make_refuses(arguments: dict[str, Any], text: str, tmp_path: Path) -> None:
    with pytest.raises(BlindError, match=text):
        make_cases(tmp_path / "cases", key=tmp_path / "key.json", **arguments)
    assert not (tmp_path / "cases").exists()


def test_make_refuses_a_key_among_the_cases_and_strange_folders(tmp_path: Path) -> None:
    with pytest.raises(BlindError, match="lies inside"):
        make_cases(tmp_path / "cases", key=tmp_path / "cases" / "key.json")
    (tmp_path / "cases" / "mine").mkdir(parents=True)
    with pytest.raises(BlindError, match="none of these cases"):
        make_cases(tmp_path / "cases", key=tmp_path / "key.json")


def test_make_refuses_a_folder_whose_key_is_another(made: tuple[Path, Path], tmp_path: Path) -> None:
    cases = tmp_path / "cases"
    shutil.copytree(made[0], cases)
    before = {p: p.read_bytes() for p in cases.rglob("*") if p.is_file()}
    with pytest.raises(BlindError, match="holds cases whose key is not"):
        make_cases(cases, 3, seed=99, key=tmp_path / "other.json")
    assert {p: p.read_bytes() for p in cases.rglob("*") if p.is_file()} == before


def test_noise_of_first_order_follows_its_recursion() -> None:
    """x_i = a x_(i-1) + sqrt(1 - a^2) w_i, to the last bit: cases of one seed stay the same files."""
    white = np.random.default_rng(3).standard_normal((2, 200))
    keep = math.exp(-0.1 / 0.4)
    for i in range(1, 200):
        white[:, i] = keep * white[:, i - 1] + math.sqrt(1 - keep**2) * white[:, i]
    assert np.array_equal(autoregressive(np.random.default_rng(3), 0.4, 0.1, (2, 200)), white)
