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
from scipy.stats import binom, kstest

import zoo.blood.blind.make as making
from zoo.blood.baseline import get_baseline
from zoo.blood.blind import BlindError, make_cases
from zoo.blood.blind.bench import GENERATOR
from zoo.blood.blind.draw import GAP_OVER_NOISE, Draw
from zoo.blood.blind.effect_draw import EffectDraw
from zoo.blood.blind.networks import tree
from zoo.blood.blind.noise import autoregressive
from zoo.blood.blind.outside import OUTSIDE, leaking_valve
from zoo.blood.case import Case, simulate
from zoo.blood.diagnosis import SEARCH_SHARE
from zoo.blood.effects import CATALOGUE, EffectParameter, Location
from zoo.blood.solver import Physics, Solver
from zoo.blood.study import load_study
from zoo.core.blindcheck.sealing import KEY_DIGEST, unfinished
from zoo.core.effects import Effect
from zoo.core.parameters import pack, start_of

# loads and stiffness of a case are drawn, some of them beyond what is usual
pytestmark = pytest.mark.filterwarnings("ignore::zoo.blood.study.UnitWarning")


def read_entries(key: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(key.read_text())["cases"]
    return found


def secret(i: int) -> str:
    return f"{i:032x}"


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# -- make --------------------------------------------------------------------------------------------


def test_cases_are_studies_and_the_key_is_apart(made: tuple[Path, Path]) -> None:
    cases, key = made
    entries = read_entries(key)
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
        noise = math.hypot(e["noise"]["white"]["mmHg"], e["noise"]["correlated_mmHg"])
        low, high = (x * noise for x in GAP_OVER_NOISE)
        assert low * 0.9 < e["gap_mmHg"]["before"] < high * 1.1
        for effect in e["effects"]:
            known = CATALOGUE.get(effect["effect"]) or OUTSIDE[effect["effect"]]
            for a in known.parameters:
                assert a.low <= effect["amplitudes"][a.name] <= a.high


def test_data_are_the_truth_and_noise_of_the_stated_size(made: tuple[Path, Path]) -> None:
    """The key's effect at its amplitude, solved here, leaves noise of 0.05 mmHg (0.064 with its AR part)."""
    cases, key = made
    e = next(e for e in read_entries(key) if e["kind"] == "listed")
    study = load_study(cases / e["case"])
    flow = get_baseline(e["base"]).forward(study, options=GENERATOR)
    case = flow.configure(pack(flow.parameters, e["base_parameters"]))
    [effect] = e["effects"]
    values = tuple(effect["amplitudes"].values())
    case = CATALOGUE[effect["effect"]].apply(case, values, Location(effect["vessel"], effect["subtree"]))  # type: ignore[misc]
    waves = simulate(case, [(s.vessel, s.position, s.quantity) for s in study.series], study.time_s)
    truth = np.array([[float(x) for x in row.split()] for row in e["truth"].values()])
    assert list(e["truth"]) == [s.label for s in study.series]
    assert np.allclose(truth, waves, atol=2e-4)
    sd = math.hypot(0.05, e["noise"]["correlated_mmHg"])
    assert np.std(study.values - waves) == pytest.approx(sd, rel=0.25)


def test_the_grid_is_not_the_diagnosis_own() -> None:
    for study in (load_study("demo"), replace(load_study("demo"), numerics={})):
        flow = get_baseline("B").forward(study, share=SEARCH_SHARE)
        its, own = (Solver.for_study(study, options=o).grid()[0] for o in (flow.options, GENERATOR))
        assert np.all(own > 2 * its)
        assert np.any(own % its)
        assert GENERATOR.cfl != flow.options.cfl


def test_a_secret_makes_its_cases_again_and_another_one_others(
    made: tuple[Path, Path], tiny: dict[str, Any], tmp_path: Path
) -> None:
    cases, key = made
    again = make_cases(tmp_path / "cases", 3, tmp_path / "other.json", **tiny)
    assert contents(tmp_path / "cases") == contents(cases)
    assert again.read_bytes() == key.read_bytes()
    other, same = (Draw(40, secret(s), tuple(CATALOGUE)).plan() for s in (1, 2))
    assert other != same


def test_the_secret_is_128_bits_that_only_the_key_holds(tiny: dict[str, Any], tmp_path: Path) -> None:
    """Two sets of the same arguments differ, and nothing in the cases has the secret or a part of it."""
    found = []
    for name in "ab":
        cases = tmp_path / name
        key = make_cases(cases, 1, tmp_path / f"{name}.json", **tiny | {"secret": None})
        own = json.loads(key.read_text())["secret"]
        assert len(own) == 32
        assert int(own, 16).bit_length() > 64
        assert not any(own[:8].encode() in text for text in contents(cases).values())
        found.append((own, contents(cases)))
    assert found[0][0] != found[1][0]
    assert found[0][1] != found[1][1]
    for wrong in ("7", "x" * 32, secret(1) + "0"):
        with pytest.raises(BlindError, match="32 hexadecimal digits"):
            make_cases(tmp_path / "c", 1, tmp_path / "c.json", **tiny | {"secret": wrong})


def test_what_a_case_shows_comes_from_another_stream_than_its_effect() -> None:
    """Streams of one secret share nothing, between purposes or cases, and none has a small seed."""
    draw = Draw(40, secret(3), tuple(CATALOGUE))
    streams = [draw.rng(what, i) for what in ("plan", "network", "effect", "noise") for i in range(5)]
    streams += [np.random.default_rng([3, 40, i]) for i in range(5)]
    first = np.array([rng.random(4) for rng in streams])
    assert len(np.unique(first)) == first.size
    assert np.array_equal(draw.rng("effect", 2).random(3), draw.rng("effect", 2).random(3))


def test_an_interrupted_make_goes_on(
    made: tuple[Path, Path], tiny: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cases, key = made
    drawn: list[str] = []
    original = making.draw_case

    def stopping(job: Any) -> Any:
        if job.name == "case-003" and "case-003" not in drawn:
            drawn.append(job.name)
            raise KeyboardInterrupt
        drawn.append(job.name)
        return original(job)

    monkeypatch.setattr(making, "draw_case", stopping)
    own = tmp_path / "key.json"
    arguments = (tmp_path / "cases", 3, own)
    with pytest.raises(KeyboardInterrupt):
        make_cases(*arguments, **tiny)
    assert not own.exists()
    assert not (tmp_path / "cases").exists()  # until all are made, none is written
    with unfinished(own).open("a") as file:
        file.write('{"entry": {"case": "case-0')  # as a kill leaves it
    finished: list[str] = []
    make_cases(*arguments, **tiny | {"secret": None}, done=finished.append)  # the secret lies beside the key
    assert drawn == ["case-001", "case-002", "case-003", "case-003"]
    assert finished == ["case-001", "case-002", "case-003"]
    assert contents(tmp_path / "cases") == contents(cases)
    assert own.read_bytes() == key.read_bytes()
    assert not list(tmp_path.glob("*.part"))
    make_cases(*arguments, **tiny)  # complete: nothing is drawn again
    assert len(drawn) == 4
    with pytest.raises(BlindError, match="another draw"):
        make_cases(*arguments, **tiny | {"secret": secret(6)})


def test_files_are_written_together_in_an_order_of_their_own(
    made: tuple[Path, Path], tiny: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cases that take half a second and more leave files of one moment: times of birth tell no solve."""
    folder = tmp_path / "cases"
    make_cases(folder, 3, tmp_path / "key.json", **tiny)
    changed = [path.stat().st_ctime for path in folder.rglob("*.*")]
    assert max(changed) - min(changed) < 0.2
    assert {path.stat().st_mtime for path in (folder, *folder.rglob("*"))} == {1577836800.0}
    orders = set()
    original = Path.write_bytes
    for _ in range(3):
        shutil.rmtree(folder)
        (tmp_path / "key.json").unlink()
        seen: list[str] = []

        def spy(self: Path, content: bytes, seen: list[str] = seen) -> int:
            seen.append(f"{self.parent.name}/{self.name}")
            return original(self, content)

        with monkeypatch.context() as patch:
            patch.setattr(Path, "write_bytes", spy)
            make_cases(folder, 3, tmp_path / "key.json", **tiny)
        assert len(seen) == 12
        orders.add(tuple(seen))
    assert len(orders) > 1


def test_nothing_but_the_values_depends_on_the_effect(
    made: tuple[Path, Path], tiny: dict[str, Any], tmp_path: Path
) -> None:
    """A guesser that sees everything else sees the same for two draws with different effects."""
    cases, key = made
    others = ("sensor-gain", "inflow-gain", "catheter-resonance", "inflow-offset")
    make_cases(tmp_path / "cases", 3, tmp_path / "key.json", **tiny | {"effects": others})
    own, other = (read_entries(k) for k in (key, tmp_path / "key.json"))
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
        plan = Draw(40, secret(seed), tuple(CATALOGUE)).plan()
        kinds = [kind for kind, _ in plan]
        assert (kinds.count("none"), kinds.count("outside"), kinds.count("listed")) == (5, 8, 27)
        right += sum(a == b == "outside" for a, b in itertools.pairwise(kinds))
        total += sum(a == "outside" for a in kinds[:-1])
    low, high = binom.interval(0.999, total, 7 / 39)
    assert low <= right <= high
    first = [Draw(40, secret(seed), tuple(CATALOGUE)).plan()[0][0] for seed in range(200)]
    low, high = binom.interval(0.999, 200, 27 / 40)
    assert low <= first.count("listed") <= high


def test_effects_come_evenly() -> None:
    names = [name for kind, name in Draw(120, secret(3), tuple(CATALOGUE)).plan() if kind == "listed"]
    counts = {name: names.count(name) for name in CATALOGUE}
    assert set(counts.values()) <= {2, 3}
    assert "correlated-noise" in counts


class Line:
    """A bench without solves: the discrepancy is a quarter of the amplitude's size, mmHg."""

    clean, sensors, flow = np.zeros((1, 4)), [(1, 0.0, "pressure_mmHg")], None

    def solve(self, added: Any) -> Any:
        return np.full((1, 4), abs(added[0][1][0]) / 4)

    def change(self, waves: Any) -> float:
        return float(waves[0, 0])

    discrepancy = change


def test_amplitudes_follow_the_prior_within_the_stated_range() -> None:
    """Draws in range are the prior's own, cut where the discrepancy leaves 0.5 to 20 times the noise."""
    given = EffectParameter("a", "1", 1.0, -4.0, 4.0, (1.0,))
    one = Effect("one", (given,), lambda case, values, at: case, family="wall", statement="", equation="")
    drawn = EffectDraw(np.random.default_rng(3), Line(), 0.05)  # type: ignore[arg-type]
    sizes = []
    for _ in range(600):
        found = drawn._one(one)
        if found is not None:
            [(_, values, _)] = found[0]
            sizes.append(values[0])
    assert not {given.low, given.high} & set(sizes)
    x = np.array(sizes)
    assert np.abs(x).min() >= 0.1  # 0.025 mmHg
    p = given.prior.cdf(np.array([-4.0, -0.1, 0.1, 4.0]))
    low, high = p[1] - p[0], p[3] - p[2]
    inside = np.where(x < 0, given.prior.cdf(x) - p[0], low + given.prior.cdf(x) - p[2]) / (low + high)
    assert kstest(inside, "uniform").pvalue > 0.01
    counts = drawn.redrawn["one"]
    assert counts["kept"] == len(sizes)
    share = counts["below"] / sum(counts.values())
    assert share == pytest.approx(p[2] - p[1], abs=0.03)
    assert set(counts) == {"kept", "below"}


def test_what_is_too_large_or_not_solved_is_counted() -> None:
    class Failing(Line):
        def solve(self, added: Any) -> Any:
            return None if added[0][1][0] < 0 else np.full((1, 4), 30.0)

        def change(self, waves: Any) -> float:
            return math.inf if waves is None else float(waves[0, 0])

        discrepancy = change

    given = EffectParameter("a", "1", 1.0, -4.0, 4.0, (1.0,))
    one = Effect("one", (given,), lambda case, values, at: case, family="wall", statement="", equation="")
    drawn = EffectDraw(np.random.default_rng(3), Failing(), 0.05)  # type: ignore[arg-type]
    assert drawn._one(one) is None
    assert drawn.redrawn["one"].keys() == {"above", "unsolved"}
    assert sum(drawn.redrawn["one"].values()) == 12


def test_the_key_counts_what_was_drawn_again(made: tuple[Path, Path]) -> None:
    key = json.loads(made[1].read_text())
    assert key["gap_over_noise"] == list(GAP_OVER_NOISE)
    kept = sum(counts.get("kept", 0) for counts in key["redrawn"].values())
    assert kept >= len(key["cases"])
    for what in ("kept", "below", "above", "unsolved"):
        total = sum(counts.get(what, 0) for counts in key["redrawn"].values())
        assert total == sum(n.get(what, 0) for e in key["cases"] for n in e["redrawn"].values())


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
        make_cases(cases, 3, key=tmp_path / "other.json")
    assert {p: p.read_bytes() for p in cases.rglob("*") if p.is_file()} == before


def test_noise_of_first_order_follows_its_recursion() -> None:
    """x_i = a x_(i-1) + sqrt(1 - a^2) w_i, to the last bit: cases of one seed stay the same files."""
    white = np.random.default_rng(3).standard_normal((2, 200))
    keep = math.exp(-0.1 / 0.4)
    for i in range(1, 200):
        white[:, i] = keep * white[:, i - 1] + math.sqrt(1 - keep**2) * white[:, i]
    assert np.array_equal(autoregressive(np.random.default_rng(3), 0.4, 0.1, (2, 200)), white)
