"""Blind cases of blood flow: files that tell nothing of the effect, a key that tells all, the commands."""

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
from scipy.stats import binom, kstest, truncnorm
from typer.testing import CliRunner

import zoo.blood.blind as blind
from zoo.blood.baseline import get_baseline
from zoo.blood.blind import BlindError, Draw, StudyDiagnosis, diagnose_cases, make_cases, score_cases
from zoo.blood.blind.networks import tree
from zoo.blood.blind.study_cases import GAP_OVER_NOISE, GENERATOR, autoregressive, draw_listed, stream
from zoo.blood.case import simulate
from zoo.blood.effects import CATALOGUE, EffectParameter, Location
from zoo.blood.solver import Solver
from zoo.blood.study import load_study
from zoo.blood.study_diagnosis import SEARCH_SHARE
from zoo.cli import app
from zoo.core.blindcheck import Answer, CaseKey
from zoo.core.blindcheck.folders import KEY_DIGEST, read_key
from zoo.core.effects import Effect
from zoo.core.parameters import pack

# loads and stiffness of a case are drawn, some of them beyond what is usual
pytestmark = pytest.mark.filterwarnings("ignore::zoo.blood.study.UnitWarning")


def secret(i: int) -> str:
    return f"{i:032x}"


def plan_of(n: int, i: int) -> list[str]:
    return Draw(n, secret(i), tuple(CATALOGUE), ("mouse", "tree"), ("MPA",), (5, 15)).plan()


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def noise_of(key: CaseKey) -> float:
    return math.hypot(key.drawn["white"]["mmHg"], key.drawn["correlated"]["mmHg"])


# -- make --------------------------------------------------------------------------------------------


def test_cases_are_studies_and_the_key_is_apart(made: tuple[Path, Path]) -> None:
    """The key's effect at its size, solved here, is its truth, and the data are that and the stated noise."""
    cases, path = made
    digest = (cases / KEY_DIGEST).read_text().split()[0]
    assert digest == hashlib.sha256(path.read_bytes()).hexdigest()
    files = ("study.toml", "network.toml", "inflow.csv", "observations.csv")
    _, keys = read_key(path)
    assert [k.case for k in keys] == ["case-001", "case-002", "case-003"]
    assert sorted(contents(cases)) == sorted([KEY_DIGEST, *(f"{k.case}/{f}" for k in keys for f in files)])
    for key in keys:
        low, high = (x * noise_of(key) for x in GAP_OVER_NOISE)
        assert key.gap is not None
        assert low <= key.gap <= high
        study = load_study(cases / key.case)
        flow = get_baseline("linear-constant").forward(study, options=GENERATOR)
        case = flow.configure(pack(flow.parameters, key.drawn["base_parameters"]))
        [effect] = key.drawn["effects"]
        known = CATALOGUE[effect["effect"]].of(flow)
        assert all(a.low <= effect["amplitudes"][a.name] <= a.high for a in known.parameters)
        assert (key.accepted, key.parameter) == ((known.name,), next(iter(effect["amplitudes"].values())))
        at = Location(key.place, key.subtree)
        case = known.apply(case, tuple(effect["amplitudes"].values()), at)  # type: ignore[misc]
        waves = simulate(case, [(s.vessel, s.position, s.quantity) for s in study.series], study.time_s)
        np.testing.assert_allclose(np.array(key.truth), waves, atol=2e-4)
        assert np.std(study.values - waves) == pytest.approx(noise_of(key), rel=0.25)


def test_the_grid_is_not_the_diagnosis_own() -> None:
    for study in (load_study("demo"), replace(load_study("demo"), numerics={})):
        flow = get_baseline("B").forward(study, share=SEARCH_SHARE)
        its, own = (Solver.for_study(study, options=o).grid()[0] for o in (flow.options, GENERATOR))
        assert np.all(own > 2 * its)
        assert np.any(own % its)
        assert GENERATOR.cfl != flow.options.cfl


def test_a_secret_makes_its_cases_again_and_only_the_key_holds_it(
    made: tuple[Path, Path], tiny: dict[str, Any], tmp_path: Path
) -> None:
    cases, key = made
    again = make_cases(tmp_path / "again", 3, tmp_path / "again.json", **tiny)
    assert contents(tmp_path / "again") == contents(cases)
    assert again.read_bytes() == key.read_bytes()
    assert plan_of(40, 1) != plan_of(40, 2)
    found = []
    for name in "ab":
        own = make_cases(tmp_path / name, 1, tmp_path / f"{name}.json", **tiny | {"secret": None})
        digits = read_key(own)[0]["secret"]
        assert int(digits, 16).bit_length() > 64
        assert not any(digits[:8].encode() in text for text in contents(tmp_path / name).values())
        found.append((digits, contents(tmp_path / name)))
    assert found[0][0] != found[1][0]
    assert found[0][1] != found[1][1]


def test_what_a_case_shows_comes_from_another_stream_than_its_effect() -> None:
    """Streams of one secret share nothing, between purposes or cases, and none has a small seed."""
    streams = [
        stream(secret(3), what, i) for what in ("plan", "network", "effect", "noise") for i in range(5)
    ]
    streams += [np.random.default_rng([3, 40, i]) for i in range(5)]
    first = np.array([rng.random(4) for rng in streams])
    assert len(np.unique(first)) == first.size
    assert np.array_equal(stream(secret(3), "effect", 2).random(3), stream(secret(3), "effect", 2).random(3))


def test_an_interrupted_make_leaves_nothing(
    tiny: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = blind.draw_case

    def stopping(draw: Draw, job: tuple[int, str]) -> Any:
        if job[0] == 2:
            raise KeyboardInterrupt
        return original(draw, job)

    monkeypatch.setattr(blind, "draw_case", stopping)
    with pytest.raises(KeyboardInterrupt):
        make_cases(tmp_path / "cases", 3, tmp_path / "key.json", **tiny)
    assert list(tmp_path.iterdir()) == []


def test_nothing_but_the_values_depends_on_the_effect(
    made: tuple[Path, Path], tiny: dict[str, Any], tmp_path: Path
) -> None:
    """A guesser that sees everything else sees the same for two draws with different effects."""
    cases, key = made
    others = ("sensor-gain", "inflow-gain", "catheter-resonance", "inflow-offset")
    make_cases(tmp_path / "cases", 3, tmp_path / "key.json", **tiny | {"effects": others})
    own, other = (read_key(path)[1] for path in (key, tmp_path / "key.json"))
    assert not {k.label for k in own} & {k.label for k in other}

    def seen(folder: Path) -> dict[Any, Any]:
        found: dict[Any, Any] = {}
        for path in sorted(folder.rglob("*")):
            name, stat = str(path.relative_to(folder)), path.stat()
            found[name, "time"], found[name, "mode"] = (stat.st_mtime, stat.st_atime >= 0), stat.st_mode
            if path.is_file():
                text = path.read_text()
                if path.name == "observations.csv":
                    rows = [line.rsplit(",", 1) for line in text.splitlines()]
                    text = "\n".join(row[0] for row in rows)
                    assert max(len(row[1].split(".")[1]) for row in rows[1:]) == 4
                if path.name != KEY_DIGEST:
                    found[name, "text"] = text
        return found

    assert seen(cases) == seen(tmp_path / "cases")
    for k in (*own, *other):
        for name, content in contents(cases).items():
            assert not any(word.encode() in content for word in (k.kind, k.label)), name


def test_the_order_of_cases_tells_nothing() -> None:
    """Guess whether a case has an effect from its neighbours and its place: no better than by chance."""
    right = total = 0
    for i in range(40):
        quiet = [name == "no-gap" for name in plan_of(40, i)]
        assert sum(quiet) == 5
        right += sum(a and b for a, b in itertools.pairwise(quiet))
        total += sum(quiet[:-1])
    low, high = binom.interval(0.999, total, 4 / 39)
    assert low <= right <= high
    low, high = binom.interval(0.999, 200, 5 / 40)
    assert low <= sum(plan_of(40, i)[0] == "no-gap" for i in range(200)) <= high
    counts = {name: plan_of(120, 3).count(name) for name in CATALOGUE}
    assert max(counts.values()) - min(counts.values()) <= 1


class Line:
    """A bench without solves: the gap is a quarter of the amplitude's size, mmHg."""

    flow = None

    def solve(self, added: Any) -> Any:
        return np.full((1, 4), abs(added[0][1][0]) / 4)

    def gap(self, waves: Any) -> float:
        return math.inf if waves is None else float(waves[0, 0])


def one_effect(monkeypatch: pytest.MonkeyPatch) -> EffectParameter:
    given = EffectParameter("a", "1", 1.0, -4.0, 4.0, (1.0,))
    one = Effect("one", (given,), lambda case, values, at: case, family="wall", statement="", equation="")
    monkeypatch.setattr("zoo.blood.blind.study_cases.CATALOGUE", {"one": one})
    return given


def test_amplitudes_follow_the_prior_within_the_stated_range(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draws in range are the prior's own, cut where the gap leaves the limits; what is cut is counted."""
    one_effect(monkeypatch)
    prior = truncnorm(-4.0, 4.0)
    rng, sizes, below = np.random.default_rng(3), [], 0
    for _ in range(600):
        found = draw_listed(rng, Line(), ["one"], (0.025, 1.0))  # type: ignore[arg-type]
        assert found is not None
        sizes.append(found.added[0][1][0])
        below += found.drawn["redrawn"].get("one below", 0)
    x = np.array(sizes)
    assert np.abs(x).min() >= 0.1
    p = prior.cdf(np.array([-4.0, -0.1, 0.1, 4.0]))
    low, high = p[1] - p[0], p[3] - p[2]
    inside = np.where(x < 0, prior.cdf(x) - p[0], low + prior.cdf(x) - p[2]) / (low + high)
    assert kstest(inside, "uniform").pvalue > 0.01
    assert below / (below + 600) == pytest.approx(p[2] - p[1], abs=0.03)


def test_what_is_never_in_range_or_never_solved_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    one_effect(monkeypatch)
    bench, asked = Line(), []
    monkeypatch.setattr(Line, "solve", lambda self, added: asked.append(added))
    assert draw_listed(np.random.default_rng(3), bench, ["one"], (0.025, 1.0)) is None  # type: ignore[arg-type]
    assert len(asked) == 60


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


def test_noise_of_first_order_follows_its_recursion() -> None:
    """x_i = a x_(i-1) + sqrt(1 - a^2) w_i, to the last bit: cases of one secret stay the same files."""
    white = np.random.default_rng(3).standard_normal((2, 200))
    keep = math.exp(-0.1 / 0.4)
    for i in range(1, 200):
        white[:, i] = keep * white[:, i - 1] + math.sqrt(1 - keep**2) * white[:, i]
    assert np.array_equal(autoregressive(np.random.default_rng(3), 0.4, 0.1, (2, 200)), white)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"n": 0}, "n = 0"),
        ({"layouts": ("MPA", "LPA")}, "give some of MPA"),
        ({"effects": ("sensor-gain",)}, "give two or more"),
        ({"vessels": (4, 4)}, "odd number"),
        ({"secret": "7"}, "32 hexadecimal digits"),
        ({"secret": "x" * 32}, "32 hexadecimal digits"),
    ],
)
def test_make_refuses(arguments: dict[str, Any], text: str, tmp_path: Path) -> None:
    with pytest.raises(BlindError, match=text):
        make_cases(tmp_path / "cases", key=tmp_path / "key.json", **arguments)
    assert not (tmp_path / "cases").exists()


# -- run and score -----------------------------------------------------------------------------------


def test_run_reads_nothing_outside_the_cases_and_keeps_what_is_answered(
    made: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Path] = []
    original = Path.read_bytes

    def spy(self: Path) -> bytes:
        opened.append(self)
        return original(self)

    answer = Answer.ranked({"sensor-offset": 0.7, "no-gap": 0.3})
    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_bytes", spy)
        patch.setattr(StudyDiagnosis, "__call__", lambda self, case, out: answer)
        found = diagnose_cases(made[0], tmp_path / "answers", cores=1)
        assert len(found.diagnosed) == 3
        assert diagnose_cases(made[0], tmp_path / "answers", cores=1).kept == found.diagnosed
        inside = {made[0], tmp_path / "answers"}
        own = [p for p in opened if p.name.endswith((".toml", ".csv", ".json", ".sha256"))]
        assert len(own) >= 12
        assert all(inside & set(p.parents) or "zoo-" in str(p) for p in own)
        for other in ({"seed": 2}, {"effects": ["taper"]}):
            with pytest.raises(BlindError, match="--fresh"):
                diagnose_cases(made[0], tmp_path / "answers", cores=1, **other)
        patch.setattr(blind, "library_digest", lambda: "another")
        with pytest.raises(BlindError, match="--fresh"):
            diagnose_cases(made[0], tmp_path / "answers", cores=1)
    score = score_cases(tmp_path / "answers", made[1], tmp_path / "score")
    assert score.summary["n"] == 3
    tampered = tmp_path / "key.json"
    tampered.write_text(made[1].read_text().replace('"kind": "listed"', '"kind": "none"', 1))
    with pytest.raises(BlindError, match="not the key of these cases"):
        score_cases(tmp_path / "answers", tampered, tmp_path / "other")
    assert not (tmp_path / "other").exists()


@pytest.mark.slow
def test_from_make_to_figures(tiny: dict[str, Any], tmp_path: Path) -> None:
    """One case, made, diagnosed and scored: the answer is that of its diagnosis.json, and of its own fit."""
    cases, key, answers, out = (str(tmp_path / x) for x in ("cases", "key.json", "answers", "score"))
    make_cases(cases, 1, key, **tiny)
    assert diagnose_cases(cases, answers, effects=tiny["effects"], cores=1).failed == {}
    result = CliRunner().invoke(app, ["blind", "score", answers, "--key", key, "-o", out])
    assert result.exit_code == 0, result.output
    assert {p.name for p in Path(out).glob("[!.]*")} == {
        "score.json", "score.md", "cases.csv", "reliability.png", "confusion.png"
    }  # fmt: skip
    assert "best constant" in " ".join(result.output.split())
    again = CliRunner().invoke(app, ["blind", "score", answers, "--key", key, "-o", out, "--json"])
    assert json.loads(again.stdout) == json.loads((Path(out) / "score.json").read_text("utf-8"))
    folder = Path(answers) / "case-001"
    assert {p.name for p in folder.iterdir()} == {"answer.json", "diagnosis.json"}
    stored, file = (json.loads((folder / f"{x}.json").read_text()) for x in ("answer", "diagnosis"))
    answer = Answer.model_validate(stored["answer"])
    assert answer.components == {c["name"]: c["probability"] for c in file["components"]}
    assert answer.effects == {c["name"]: c["probability"] for c in file["causes"] if not c["free"]}
    assert answer.fitted is not None
    base, leader = answer.fitted.left(load_study(f"{cases}/case-001").values.tolist())
    assert base == pytest.approx(file["gap"]["residual_rms_before_mmHg"], rel=1e-3)
    assert leader == pytest.approx(file["gap"]["residual_rms_after_mmHg"], rel=1e-3)


def test_commands_complain_in_one_line(made: tuple[Path, Path], tmp_path: Path) -> None:
    shutil.copytree(made[0], tmp_path / "there")
    for words in (
        ["make", str(tmp_path / "c"), "--effects", "warp", "--key", str(tmp_path / "k.json")],
        ["make", str(tmp_path / "c"), "--key", str(tmp_path / "no" / "k.json")],
        ["make", str(tmp_path / "there"), "--key", str(tmp_path / "k.json")],
        ["run", str(tmp_path / "nothing")],
        ["run", str(made[0]), "-o", str(tmp_path / "a"), "--base", "spiral"],
        ["score", str(tmp_path / "nothing"), "--key", str(made[1]), "-o", str(tmp_path / "s")],
    ):
        result = CliRunner().invoke(app, ["blind", *words])
        assert result.exit_code == 2, words
        errors = [line for line in result.stderr.splitlines() if line.startswith("error:")]
        assert len(errors) == 1, result.output
