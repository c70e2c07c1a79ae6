"""The blind check: cases that tell nothing, runs that see no key, scores that can be computed by hand."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom
from typer.testing import CliRunner

import zoo.blood.blind as blind
from zoo.blood.blind import (
    GAP_MMHG,
    GENERATOR,
    KEY_DIGEST,
    OUTSIDE,
    BlindError,
    Draw,
    TrueEffect,
    Truth,
    assemble,
    make,
    read_key,
    reliability,
    run,
    score,
    score_case,
    tree,
    tree_distance,
    visible,
)
from zoo.blood.effects import CATALOGUE, Amplitude, Place, get_base, simulate
from zoo.blood.solver import Physics
from zoo.blood.study import load_study
from zoo.cli import app
from zoo.core.diagnosis.diagnosis import (
    AmplitudeEstimate,
    DiagnosisFile,
    Gap,
    HypothesisResult,
    Where,
    diagnose,
)
from zoo.core.diagnosis.screening import SEARCH
from zoo.core.inference.record import versions

CHEAP = ("sensor-offset", "inflow-shift", "inflow-bandwidth", "beat-jitter")
TINY: dict[str, Any] = {"networks": ("tree",), "layouts": ("MPA",), "vessels": (3, 3), "cores": 1}
SEED = 5


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("blind")
    return folder / "cases", make(folder / "cases", 3, SEED, folder / "key.json", effects=CHEAP, **TINY)


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
            for a in known.amplitudes:
                assert a.low <= effect["amplitudes"][a.name] <= a.high


def test_data_are_the_truth_and_noise_of_the_stated_size(made: tuple[Path, Path]) -> None:
    """The key's effect at its amplitude, solved here, leaves noise of 0.05 mmHg (0.064 with its AR part)."""
    cases, key = made
    e = next(e for e in json.loads(key.read_text()) if e["kind"] == "listed")
    study = load_study(cases / e["case"])
    case = get_base(e["base"]).case(study, e["base_parameters"], GENERATOR)
    [effect] = e["effects"]
    values = tuple(effect["amplitudes"].values())
    case = CATALOGUE[effect["effect"]].apply(case, values, Place(effect["vessel"], effect["subtree"]))  # type: ignore[misc]
    waves, reason = simulate(case, [(s.vessel, s.position, s.quantity) for s in study.series], study.time_s)
    assert reason is None
    sd = math.hypot(0.05, e["noise"]["correlated_mmHg"])
    assert np.std(study.values - waves) == pytest.approx(sd, rel=0.25)


def test_the_grid_is_not_the_diagnosis_own() -> None:
    assert GENERATOR.dx_cm / GENERATOR.refine < 0.5 * SEARCH.dx_cm
    assert (SEARCH.dx_cm / (GENERATOR.dx_cm / GENERATOR.refine)) % 1 > 0.1
    assert GENERATOR.cfl != SEARCH.cfl


def test_same_seed_same_files_and_another_seed_others(made: tuple[Path, Path], tmp_path: Path) -> None:
    cases, key = made
    again = make(tmp_path / "cases", 3, SEED, tmp_path / "other.json", effects=CHEAP, **TINY)
    assert contents(tmp_path / "cases") == contents(cases)
    assert again.read_bytes() == key.read_bytes()
    other, same = (Draw(40, s, tuple(CATALOGUE)).plan() for s in (1, 2))
    assert other != same


def test_an_interrupted_make_goes_on(
    made: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cases, key = made
    drawn: list[str] = []
    original = blind._case

    def stopping(job: Any) -> dict[str, Any]:
        if job.name == "case-003" and "case-003" not in drawn:
            drawn.append(job.name)
            raise KeyboardInterrupt
        drawn.append(job.name)
        return original(job)

    monkeypatch.setattr(blind, "_case", stopping)
    arguments = (tmp_path / "cases", 3, SEED, tmp_path / "key.json")
    with pytest.raises(KeyboardInterrupt):
        make(*arguments, effects=CHEAP, **TINY)
    assert not (tmp_path / "key.json").exists()
    finished: list[str] = []
    make(*arguments, effects=CHEAP, **TINY, done=finished.append)
    assert drawn == ["case-001", "case-002", "case-003", "case-003"]
    assert finished == ["case-001", "case-002", "case-003"]
    assert contents(tmp_path / "cases") == contents(cases)
    assert (tmp_path / "key.json").read_bytes() == key.read_bytes()
    assert not list(tmp_path.glob("*.part"))
    make(*arguments, effects=CHEAP, **TINY)  # complete: nothing is drawn again
    assert len(drawn) == 4
    with pytest.raises(BlindError, match="another draw"):
        make(tmp_path / "cases", 3, SEED + 1, tmp_path / "key.json", effects=CHEAP, **TINY)


def test_nothing_but_the_values_depends_on_the_effect(made: tuple[Path, Path], tmp_path: Path) -> None:
    """A guesser that sees everything else sees the same for two draws with different effects."""
    cases, key = made
    others = ("sensor-gain", "inflow-gain", "catheter-resonance", "inflow-offset")
    make(tmp_path / "cases", 3, SEED, tmp_path / "key.json", effects=others, **TINY)
    own, other = (json.loads(k.read_text()) for k in (key, tmp_path / "key.json"))
    assert [e["effect"] for e in own] != [e["effect"] for e in other]

    def seen(folder: Path) -> dict[str, Any]:
        found: dict[str, Any] = {}
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
    a = Amplitude("a", "1", 1.0, -4.0, 4.0, (1.0,))
    limits = (0.15, 1.0)
    assert visible(lambda x: abs(x) / 2, a, -1.2, limits, 0.5)[0] == -1.2
    value, *_ = visible(lambda x: abs(x) ** 3, a, 2.0, limits, 0.5)
    assert value is not None
    assert 0.15 <= value**3 <= 1.0
    # only the other side of 0 shows anything
    value, *_ = visible(lambda x: max(0.0, -x) / 20, a, 1.0, limits, 0.18)
    assert value is not None
    assert -4.0 <= value <= -3.0
    # the solve fails beyond 2
    value, *_ = visible(lambda x: abs(x) / 10 if abs(x) < 2 else math.inf, a, 3.0, limits, 0.17)
    assert value is not None
    assert 1.5 <= abs(value) < 2
    found, smallest, largest = visible(lambda x: abs(x) / 100, a, 1.0, limits, 0.5)
    assert found is None
    assert largest == pytest.approx(0.04)
    switch = Amplitude("s", "1", 0.5, 0.1, 1.2, (0.2,))
    found, smallest, _ = visible(lambda x: 2.0 + x, switch, 0.5, limits, 0.5)
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


@pytest.mark.parametrize("name", sorted(OUTSIDE))
def test_outside_effects_are_in_no_catalogue_and_grow_from_0(name: str) -> None:
    assert name not in CATALOGUE
    if name == "active-tone" and not hasattr(Physics(), "stiffness_wave"):
        pytest.skip("this solver's stiffness cannot change within the beat")
    study = load_study("demo")
    base = get_base("linear-constant")
    case = base.case(study, base.start)
    apply = OUTSIDE[name].apply
    assert apply is not None

    def wave(x: float) -> Any:
        values, reason = simulate(apply(case, (x,), Place()), [(1, 0.0, "pressure_mmHg")], study.time_s)
        assert reason is None
        return values

    plain, _ = simulate(case, [(1, 0.0, "pressure_mmHg")], study.time_s)
    small, large = (float(np.abs(wave(x) - plain).max()) for x in (0.05, 0.1))
    assert np.allclose(wave(0.0), plain, atol=1e-3)
    assert small > 0.02
    assert large == pytest.approx(2 * small, rel=0.3)


def test_leaking_valve_returns_its_share_in_diastole() -> None:
    study = load_study("demo")
    base = get_base("linear-constant")
    case = base.case(study, base.start)
    changed = blind.leaking_valve(case, (0.2,), Place())
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
        make(tmp_path / "cases", key=tmp_path / "key.json", **arguments)
    assert not (tmp_path / "cases").exists()


def test_make_refuses_a_key_among_the_cases_and_strange_folders(tmp_path: Path) -> None:
    with pytest.raises(BlindError, match="lies inside"):
        make(tmp_path / "cases", key=tmp_path / "cases" / "key.json")
    (tmp_path / "cases" / "mine").mkdir(parents=True)
    with pytest.raises(BlindError, match="none of these cases"):
        make(tmp_path / "cases", key=tmp_path / "key.json")


def test_make_refuses_a_folder_whose_key_is_another(made: tuple[Path, Path], tmp_path: Path) -> None:
    cases = tmp_path / "cases"
    shutil.copytree(made[0], cases)
    before = {p: p.read_bytes() for p in cases.rglob("*") if p.is_file()}
    with pytest.raises(BlindError, match="holds cases whose key is not"):
        make(cases, 3, seed=99, key=tmp_path / "other.json")
    assert {p: p.read_bytes() for p in cases.rglob("*") if p.is_file()} == before


# -- run ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def answered(made: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    answers = tmp_path_factory.mktemp("run") / "answers"
    found = run(made[0], answers, effects=CHEAP, max_effects=1, cores=1)
    assert found.failed == {}
    return answers


def test_run_answers_and_goes_on(
    made: tuple[Path, Path], answered: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = tmp_path / "answers"
    shutil.copytree(answered, answers)
    (answers / "case-002" / "diagnosis.json").write_text("{")  # as a kill leaves it
    asked: list[str] = []

    def refuse(study: Any, *arguments: Any, **settings: Any) -> Any:
        asked.append(study.name)
        raise RuntimeError("no more")

    monkeypatch.setattr(blind, "diagnose", refuse)
    found = run(made[0], answers, effects=CHEAP, max_effects=1, cores=1)
    assert asked == ["case-002"]
    assert found.kept == ("case-001", "case-003")
    assert found.failed == {"case-002": "no more"}
    assert (answers / "case-002" / "failed.txt").read_text().startswith("no more\n")
    monkeypatch.setattr(blind, "diagnose", diagnose)
    found = run(made[0], answers, effects=CHEAP, max_effects=1, cores=1)
    assert found.failed == {}
    assert not (answers / "case-002" / "failed.txt").exists()
    assert run(made[0], answers, effects=CHEAP, seed=2, max_effects=1, cores=1).kept == ()


@pytest.mark.parametrize("where", ["key.json", "my-Key-7.json", "case-001/key.json"])
def test_run_refuses_a_folder_with_a_key(where: str, made: tuple[Path, Path], tmp_path: Path) -> None:
    cases = tmp_path / "cases"
    shutil.copytree(made[0], cases)
    shutil.copy(made[1], cases / where)
    with pytest.raises(BlindError, match="a key lies with the cases"):
        run(cases, tmp_path / "answers")
    assert not (tmp_path / "answers").exists()


def test_run_opens_nothing_outside_the_cases(
    made: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Path] = []
    original = Path.read_text

    def spy(self: Path, *arguments: Any, **settings: Any) -> str:
        opened.append(self)
        return original(self, *arguments, **settings)

    monkeypatch.setattr(Path, "read_text", spy)

    def fail(*arguments: Any, **settings: Any) -> Any:
        raise RuntimeError

    monkeypatch.setattr(blind, "diagnose", fail)
    answers = tmp_path / "answers"
    run(made[0], answers, cores=1)
    assert opened
    assert all({made[0], answers} & set(path.parents) for path in opened)


def test_run_refuses_what_is_no_folder_of_cases(made: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(BlindError, match="no such folder"):
        run(tmp_path / "nothing", tmp_path / "answers")
    with pytest.raises(BlindError, match=r"no folder with a study\.toml"):
        run(tmp_path, tmp_path.parent / "answers")
    with pytest.raises(BlindError, match="lies inside"):
        run(made[0], made[0] / "answers")


# -- score -------------------------------------------------------------------------------------------


def hypothesis(name: str, probability: float, group: int, **fields: Any) -> HypothesisResult:
    return HypothesisResult(
        **{
            "name": name, "place": None, "probability": probability, "group": group, "log_evidence": 0.0,
            "amplitude": None, "gap_after_mmHg": 0.0, "gap_after_interval_mmHg": (0.0, 0.0),
            "residual_rms_mmHg": 0.05, **fields,
        }
    )  # fmt: skip


def answer(
    hypotheses: list[HypothesisResult],
    removed: tuple[float, float, float] = (0.0, 0.0, 0.0),
    checksum: str = "",
) -> DiagnosisFile:
    gap = Gap(
        before_mmHg=0.3, before_interval_mmHg=(0.2, 0.4), noise_floor_mmHg=0.05, after_mmHg=0.0,
        after_interval_mmHg=(0.0, 0.0), residual_rms_before_mmHg=0.3, residual_rms_after_mmHg=0.05,
        removed=removed[0], removed_interval=removed[1:], held_out_before_mmHg=None, held_out_after_mmHg=None,
        held_out_removed=None, held_out="", per_series=[],
    )  # fmt: skip
    return DiagnosisFile(
        study="case", study_checksum=checksum, base="linear-constant", gap=gap,
        where=Where(series={}, phase={}, harmonic={}, place=[]),
        cause=[h.name for h in hypotheses if h.group == hypotheses[0].group], verdict="",
        hypotheses=hypotheses, steps=[], invisible=[], failed=[], next_measurement=None, base_parameters={},
        confirmation=None, record={"versions": versions(), "seed": 1, "screening_seconds": 2.0},
    )  # fmt: skip


def truth(kind: str, label: str, *effects: TrueEffect, case: str = "case-001", **fields: Any) -> Truth:
    values: dict[str, Any] = {"before": 0.5, "after": 0.05, "digest": ""} | fields
    return Truth(case, kind, label, effects, "MPA", "tree", 0.05, **values)


TAPER = TrueEffect("taper", Place(), 0.2)
FOUR = [
    hypothesis("minor-losses", 0.5, 0, amplitude=AmplitudeEstimate(name="K", mean=2.0, sd=0.1, unit="1")),
    hypothesis("taper", 0.3, 0, amplitude=AmplitudeEstimate(name="taper", mean=0.25, sd=0.02, unit="1")),
    hypothesis("no-gap", 0.15, 1),
    hypothesis("unlisted", 0.05, 2),
]


def test_scores_by_hand() -> None:
    found = score_case(truth("listed", "taper", TAPER), answer(FOUR, (0.85, 0.8, 0.95)), {})
    assert (found.rank, found.group_rank, found.first, found.group_first) == (2, 1, False, True)
    assert found.right
    assert found.leader_probability == pytest.approx(0.8)
    assert found.log_score == pytest.approx(math.log(0.3))
    assert found.group_log_score == pytest.approx(math.log(0.8))
    assert found.uniform_log_score == pytest.approx(math.log(1 / 4))
    assert found.uniform_group_log_score == pytest.approx(math.log(2 / 4))
    assert found.brier == pytest.approx(0.5**2 + 0.7**2 + 0.15**2 + 0.05**2)
    assert found.uniform_brier == pytest.approx(0.75**2 + 3 * 0.25**2)
    assert found.group_brier == pytest.approx(0.2**2 + 0.15**2 + 0.05**2)
    assert found.uniform_group_brier == pytest.approx(0.5**2 + 2 * 0.25**2)
    assert found.shrinkage_true == pytest.approx(0.9)
    assert found.shrinkage_within
    assert found.shrinkage_covered
    assert found.amplitude == 0.25
    assert found.amplitude_covered is False  # 2.5 sd away
    assert found.gap_over_noise == pytest.approx(10)


def test_invisible_explanations_have_no_share_in_a_guess() -> None:
    file = answer([*FOUR, hypothesis("hydrostatic", 0.0, 3)]).model_copy(
        update={"invisible": ["hydrostatic"]}
    )
    found = score_case(truth("listed", "taper", TAPER), file, {})
    assert found.uniform_log_score == pytest.approx(math.log(1 / 4))


def test_what_was_called_impossible_costs_the_floor() -> None:
    found = score_case(truth("listed", "stenosis", TrueEffect("stenosis", Place(3), 0.2)), answer(FOUR), {})
    assert found.rank == 5
    assert found.log_score == pytest.approx(math.log(blind.FLOOR))
    assert not found.right


def test_no_effect_and_outside_cases() -> None:
    none = truth("none", "no-gap", before=0.0)
    assert score_case(none, answer(FOUR), {}).false_alarm is True
    calm = [FOUR[2].model_copy(update={"probability": 0.9}), *FOUR[:2]]
    assert score_case(none, answer(calm), {}).false_alarm is False
    out = truth("outside", "valve-click", TrueEffect("valve-click"))
    assert score_case(out, answer(FOUR), {}).called_unlisted is True  # no listed effect above 50 %
    sure = [FOUR[0].model_copy(update={"probability": 0.6}), *FOUR[1:]]
    assert score_case(out, answer(sure), {}).called_unlisted is False
    unlisted = [hypothesis("unlisted", 0.9, 0), hypothesis("taper", 0.1, 1)]
    found = score_case(out, answer(unlisted), {})
    assert found.called_unlisted
    assert found.right
    two = truth("outside", "second-effect", TAPER, TrueEffect("minor-losses", Place(), 2.0))
    found = score_case(two, answer(sure), {})
    assert (found.first, found.called_unlisted, found.shrinkage_true) == (True, True, None)
    assert found.probability == pytest.approx(0.6 + 0.3 + 0.05)


def test_place_and_amplitude_belong_to_the_place() -> None:
    parents = {1: None, 2: 1, 3: 1, 4: 2, 5: 2}
    distances = [tree_distance(parents, a, b) for a, b in ((4, 4), (4, 2), (4, 5), (4, 3), (1, 5))]
    assert distances == [0, 1, 2, 3, 2]
    size = AmplitudeEstimate(name="severity", mean=0.2, sd=0.01, unit="1")
    there = truth("listed", "stenosis", TrueEffect("stenosis", Place(4), 0.2))
    near = answer([hypothesis("stenosis", 0.9, 0, place=2, amplitude=size), hypothesis("no-gap", 0.1, 1)])
    found = score_case(there, near, parents)
    assert (found.distance, found.amplitude) == (1, None)
    exact = answer([hypothesis("stenosis", 0.9, 0, place=4, amplitude=size), hypothesis("no-gap", 0.1, 1)])
    found = score_case(there, exact, parents)
    assert (found.distance, found.amplitude, found.amplitude_covered) == (0, 0.2, True)


def test_reliability_by_hand() -> None:
    bins = reliability([0.8, 0.8, 0.8, 0.8, 0.3, 1.0], [True, True, False, True, False, True])
    assert [(b.low, b.high, b.n, b.right) for b in bins] == [
        (0.25, 0.5, 1, 0),
        (0.75, 0.9, 4, 3),
        (0.97, 1.0, 1, 1),
    ]
    # P(0 right of 4) = 0.0016, P(at most 1) = 0.0272: the lower 2.5 % end at 1
    assert bins[1].band == (1, 4)
    assert all(b.inside for b in bins)
    bad = reliability([0.99] * 10, [True] * 7 + [False] * 3)
    assert not bad[0].inside


def test_summary_counts_failures_and_rates() -> None:
    listed = truth("listed", "taper", TAPER)
    cases = [score_case(listed, answer(FOUR, (0.85, 0.8, 0.95)), {}), score_case(listed, None, {})]
    cases.append(score_case(truth("none", "no-gap", before=0.0), answer(FOUR), {}))
    found = assemble(cases)
    s = found.summary
    assert (s["n"], s["failed"]) == (3, 1)
    assert s["effect_or_group_first"]["share"] == pytest.approx(0.5)
    assert s["false_alarms"]["count"] == 1
    assert s["group_log_score"] == pytest.approx((math.log(0.8) + math.log(0.15)) / 2)
    assert s["effect_or_group_first"]["low"] == pytest.approx(0.0945, abs=1e-3)  # Wilson, 1 of 2
    assert found.confusion == {"taper": {"minor-losses": 1, "failed": 1}, "no-gap": {"minor-losses": 1}}
    assert list(found.by["gap"]) == ["no effect", "0.4 to 0.65"]
    assert found.reliability[0].n == 2
    json.dumps(found.record(), allow_nan=False)


def test_score_writes_and_checks_the_key(made: tuple[Path, Path], answered: Path, tmp_path: Path) -> None:
    found = score(answered, made[1], tmp_path / "score")
    assert found.key_checked
    assert found.summary["n"] == 3
    record = json.loads((tmp_path / "score" / "score.json").read_text())
    assert [c["case"] for c in record["cases"]] == ["case-001", "case-002", "case-003"]
    assert (tmp_path / "score" / "cases.csv").read_text().count("\n") == 4
    tampered = tmp_path / "key.json"
    tampered.write_text(made[1].read_text().replace('"kind": "listed"', '"kind": "none"', 1))
    with pytest.raises(BlindError, match="not the key of these cases"):
        score(answered, tampered, tmp_path / "score")
    copy = tmp_path / "answers"
    shutil.copytree(answered, copy)
    (copy / KEY_DIGEST).unlink()
    with pytest.raises(BlindError, match="cannot be checked"):
        score(copy, made[1], tmp_path / "score")


def test_answers_about_other_data_or_unfinished_are_refused(
    made: tuple[Path, Path], answered: Path, tmp_path: Path
) -> None:
    shutil.copytree(answered, tmp_path / "answers")
    one, two = (tmp_path / "answers" / f"case-00{i}" for i in (1, 2))
    shutil.copy(two / "diagnosis.json", one / "diagnosis.json")
    with pytest.raises(BlindError, match="other data"):
        score(tmp_path / "answers", made[1], tmp_path / "score")
    (one / "diagnosis.json").unlink()
    with pytest.raises(BlindError, match="finish"):
        score(tmp_path / "answers", made[1], tmp_path / "score")
    assert not (tmp_path / "score").exists()


def other_key(**changes: Any) -> dict[str, Any]:
    return {
        "case": "case-101", "effect": "junction_loss", "in_library": True, "amplitude": 3.0, "extra": {},
        "layout": "MPA", "noise": {"white_sd_mmHg": 0.03, "ar1_sd_mmHg": 0.04},
        "base_fit": {"rms_noisefree_mmHg": [0.2, 0.4]},
        "refit_with_true_effect": {"rms_noisy_mmHg": [0.08, 0.06]},
    } | changes  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "kind", "label", "amplitude"),
    [
        ({}, "listed", "minor-losses", 3.0),
        ({"effect": None, "amplitude": 0.0}, "none", "no-gap", None),
        ({"effect": "active_tone", "in_library": False, "amplitude": 0.2}, "outside", "active-tone", 0.2),
        ({"effect": "distributed_outflow", "amplitude": 4}, "listed", "distributed-outflow", 3.0),
        ({"effect": "velocity_profile", "amplitude": 2.0}, "listed", "velocity-profile", 1.0),
        ({"effect": "nonlinear_wall", "amplitude": 0.3}, "listed", "tangent-wall", 0.3),
        ({"effect": "catheter_gain", "amplitude": 0.2}, "listed", "sensor-gain", 0.2),
    ],
)
def test_keys_made_elsewhere(
    changes: dict[str, Any], kind: str, label: str, amplitude: float | None, tmp_path: Path
) -> None:
    (tmp_path / "key").mkdir()
    (tmp_path / "key" / "case-101.json").write_text(json.dumps(other_key(**changes)))
    [found], checked = read_key(tmp_path / "key", tmp_path)
    assert not checked
    assert (found.kind, found.label) == (kind, label)
    assert [e.amplitude for e in found.effects] == ([] if amplitude is None else [amplitude])
    assert found.noise == pytest.approx(0.05)
    assert found.before == pytest.approx(math.sqrt((0.04 + 0.16) / 2))
    assert found.after == pytest.approx(math.sqrt((0.0064 + 0.0036) / 2 - 0.0025))


def test_keys_made_elsewhere_with_places_and_unknown_names(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.mkdir()
    place = other_key(effect="stenosis", extra={"vessel": 3})
    (key / "case-101.json").write_text(json.dumps(place))
    [found], _ = read_key(key, tmp_path)
    assert found.effects[0].place == Place(3)
    (key / "case-101.json").write_text(json.dumps(other_key(effect="warp_drive")))
    with pytest.raises(BlindError, match="not in the catalogue"):
        read_key(key, tmp_path)


# -- the commands ------------------------------------------------------------------------------------


def test_commands_end_to_end(made: tuple[Path, Path], answered: Path, tmp_path: Path) -> None:
    runner = CliRunner()
    out = tmp_path / "score"
    result = runner.invoke(app, ["blind", "score", str(answered), "--key", str(made[1]), "-o", str(out)])
    assert result.exit_code == 0, result.output
    assert {p.name for p in out.iterdir()} == {
        "score.json", "score.md", "cases.csv", "reliability.png", "accuracy.png", "confusion.png", "sizes.png"
    }  # fmt: skip
    assert "no-effect cases called a gap" in " ".join(result.output.split())


def test_commands_complain_in_one_line(made: tuple[Path, Path], tmp_path: Path) -> None:
    runner = CliRunner()
    for words in (
        ["make", str(tmp_path / "c"), "--effects", "warp", "--key", str(tmp_path / "k.json")],
        ["make", str(tmp_path / "c"), "--key", str(tmp_path / "no" / "k.json")],
        ["run", str(tmp_path / "nothing")],
        ["run", str(made[0]), "-o", str(tmp_path / "a"), "--base", "spiral"],
        ["score", str(tmp_path / "nothing"), "--key", str(made[1]), "-o", str(tmp_path / "s")],
    ):
        result = runner.invoke(app, ["blind", *words])
        assert result.exit_code == 2, words
        errors = [line for line in result.stderr.splitlines() if line.startswith("error:")]
        assert len(errors) == 1, result.output
