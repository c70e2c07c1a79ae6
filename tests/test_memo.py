"""Checkpoints are data with digests: what is damaged is refused, what is cut off is made again."""

from __future__ import annotations

import json
import os
import pickle
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pymc as pm
import pytest

from gaussian import SETTINGS, Doubling, gaussian_model
from zoo.core.diagnosis.solve_store import FILE, SolveStore
from zoo.core.inference import pool
from zoo.core.inference.checkpoint import CheckpointError, Folder
from zoo.core.inference.memo import Found, Memo, to_line
from zoo.core.inference.progress import Display
from zoo.core.inference.record import RunRecord
from zoo.core.inference.sampling import sample
from zoo.core.outputs import OutputFileError

FEW = {**SETTINGS, "cores": 0, "draws": 20, "tune": 250}
FILES = ["run.json", "chain-0.memo", "chain-1.memo"]


def same(one: Any, other: Any) -> None:
    """All draws and statistics of two posteriors."""
    for group in ("posterior", "sample_stats"):
        for name in other[group].data_vars:
            np.testing.assert_array_equal(one[group][name], other[group][name])


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[Path, Any]:
    """A checkpoint, and the draws of its run."""
    folder = tmp_path_factory.mktemp("run") / "checkpoint"
    return folder, sample(gaussian_model(), checkpoint=folder, **FEW)


@pytest.fixture
def mine(made: tuple[Path, Any], tmp_path: Path) -> Path:
    """A copy of the checkpoint."""
    return Path(shutil.copytree(made[0], tmp_path / "checkpoint"))


def read_all(folder: Path) -> list[Any]:
    """Everything that a resumed run reads."""
    from zoo.core import digests

    opened = Folder(folder)
    try:
        stored = opened.run()
        assert stored is not None
        run = digests.of_json(stored["identity"])
        memos = [Memo(opened.chain(k), f"{run}, chain {k}") for k in range(2)]
    finally:
        opened.close()
    for memo in memos:
        memo.close()
    return [stored, *(bytes(memo.lines) for memo in memos)]


def _loaded(text: bytes | bytearray) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return None


@pytest.mark.parametrize("name", FILES)
def test_no_flipped_bit_goes_unseen(made: tuple[Path, Any], mine: Path, name: str) -> None:
    """100 bits of each file, one at a time: refused by name with the remedy, but for the last line's end.

    In JSON few change nothing: the seventeenth digit of a number, or the e of its exponent.
    """
    whole = read_all(made[0])
    raw = (mine / name).read_bytes()
    rng, same_content = random.Random(name), 0
    for _ in range(100):
        damaged = bytearray(raw)
        damaged[at := rng.randrange(len(raw))] ^= 1 << rng.randrange(8)
        (mine / name).write_bytes(damaged)
        if name != "run.json" and at == len(raw) - 1:
            continue
        if name == "run.json" and _loaded(damaged) == _loaded(raw):
            same_content += 1
            assert read_all(mine) == whole
            continue
        with pytest.raises(CheckpointError, match=r"start afresh|another version") as caught:
            read_all(mine)
        assert str(caught.value).startswith(str(mine))
        assert "\n" not in str(caught.value)
    assert same_content < 5
    (mine / name).write_bytes(raw)
    assert read_all(mine) == whole


def test_what_is_cut_off_is_solved_again_and_nothing_else(made: tuple[Path, Any], mine: Path) -> None:
    """A memo cut in its first, a middle and its last line; run.json cut is refused."""
    file = mine / "chain-0.memo"
    raw = file.read_bytes()
    for n in (0, 10, len(raw) // 2, len(raw) - 1):
        file.write_bytes(raw[:n])
        model = gaussian_model()
        same(sample(model, checkpoint=mine, **FEW), made[1])
        assert file.read_bytes() == raw
    (mine / "run.json").write_bytes((mine / "run.json").read_bytes()[:-9])
    with pytest.raises(CheckpointError, match=r"run\.json: cannot be read; remove the folder"):
        sample(gaussian_model(), checkpoint=mine, **FEW)


def test_no_solve_is_made_twice(tmp_path: Path) -> None:
    """Of the chains none; three of the identity, and some of the checks at the mode."""
    counted: list[Doubling] = []

    class Counted(Doubling):
        def perform(self, node, inputs, output_storage):
            counted.append(self)
            super().perform(node, inputs, output_storage)

    def model() -> pm.Model:
        with pm.Model() as made:
            a = pm.Normal("a", 0.3, 1.0, shape=2)
            x, ok = Counted(limit=0.0)(a)
            pm.Potential("solved", pm.math.switch(pm.math.eq(ok, 1), 0.0, -np.inf))
            pm.Deterministic("twice", x)
        return made

    first = sample(model(), checkpoint=tmp_path / "c", **FEW)
    assert len(counted) > 2 * (250 + 2 * 20)
    counted.clear()
    again = sample(model(), checkpoint=tmp_path / "c", **FEW)
    same(again, first)
    assert len(counted) < 10
    one, two = RunRecord.of(first), RunRecord.of(again)
    assert (one.solves, one.failures, one.mode_evaluations) == (
        two.solves,
        two.failures,
        two.mode_evaluations,
    )
    assert two.sittings == 2
    assert one.failures["collapse"] > 0


def test_memos_of_other_chains_and_runs_are_refused(mine: Path, tmp_path: Path) -> None:
    wrong = r"line 1 is damaged, or of another run or chain; remove the folder to start afresh"
    raw = (mine / "chain-1.memo").read_bytes()
    shutil.copy(mine / "chain-0.memo", mine / "chain-1.memo")
    with pytest.raises(CheckpointError, match=rf"chain-1\.memo: {wrong}"):
        sample(gaussian_model(), checkpoint=mine, **FEW)
    (mine / "chain-1.memo").write_bytes(raw)
    sample(gaussian_model(), checkpoint=tmp_path / "other", **{**FEW, "seed": 12})
    shutil.copy(tmp_path / "other" / "chain-0.memo", mine / "chain-0.memo")
    with pytest.raises(CheckpointError, match=rf"chain-0\.memo: {wrong}"):
        sample(gaussian_model(), checkpoint=mine, **FEW)


class Bomb:
    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self):
        return Path.touch, (self.marker,)


def test_a_crafted_checkpoint_runs_nothing(mine: Path, tmp_path: Path) -> None:
    """Pickles under every name, also as an array of objects in a line whose digest fits."""
    marker = tmp_path / "marker"
    bomb = pickle.dumps(Bomb(marker))
    pickle.loads(bomb)
    assert marker.exists()  # it would work
    marker.unlink()
    for name in FILES:
        raw = (mine / name).read_bytes()
        (mine / name).write_bytes(bomb + b"\n")
        with pytest.raises(CheckpointError, match=name):
            sample(gaussian_model(), checkpoint=mine, **FEW)
        (mine / name).write_bytes(raw)
    objects = to_line("run", b"key", Found((np.array([Bomb(marker)], dtype=object),)))
    (tmp_path / "memo").write_bytes(objects)
    with pytest.raises(CheckpointError, match="line 1 cannot be read"):
        Memo(tmp_path / "memo", "run")
    assert not marker.exists()


@pytest.mark.parametrize("name", ["lock", "run.json", "chain-0.memo", "solves.memo"])
@pytest.mark.parametrize("there", [True, False])
def test_a_link_in_a_checkpoint_is_not_written_through(tmp_path: Path, name: str, there: bool) -> None:
    elsewhere, checkpoint = tmp_path / "thesis.tex", tmp_path / "checkpoint"
    checkpoint.mkdir()
    (checkpoint / name).symlink_to(elsewhere)
    if there:
        elsewhere.write_text("years of work")
    with pytest.raises(OutputFileError, match=f"{name}: is a link") as caught:
        Folder(checkpoint)
    assert "\n" not in str(caught.value)
    assert elsewhere.exists() == there
    assert not there or elsewhere.read_text() == "years of work"


@pytest.mark.parametrize("name", ["chain-0.memo", "solves.memo"])
def test_a_file_of_two_names_in_a_checkpoint_is_not_written(tmp_path: Path, name: str) -> None:
    elsewhere, checkpoint = tmp_path / "thesis.tex", tmp_path / "checkpoint"
    checkpoint.mkdir()
    elsewhere.write_text("years of work")
    (checkpoint / name).hardlink_to(elsewhere)
    with pytest.raises(OutputFileError, match=f"{name}: is a link"):
        Folder(checkpoint)
    assert elsewhere.read_text() == "years of work"


@pytest.mark.parametrize("link", [Path.symlink_to, Path.hardlink_to])
def test_kept_solves_are_not_written_through_a_link(
    tmp_path: Path, link: Callable[[Path, Path], None]
) -> None:
    elsewhere, kept = tmp_path / "empty", tmp_path / "solves"
    kept.mkdir()
    elsewhere.write_text("")
    link(kept / FILE, elsewhere)
    with pytest.raises(CheckpointError, match=f"{FILE}: is a link"):
        SolveStore(kept)
    assert elsewhere.read_text() == ""


@pytest.mark.parametrize("content", ["", "abc", "years of work", "0" * 24 + " of work", "a\nb"])
def test_a_memo_of_others_stays_as_it_is(mine: Path, tmp_path: Path, content: str) -> None:
    """In a folder without a run, and in one of a run, where it is only dropped if it can be zoo's own."""
    (tmp_path / "new").mkdir()
    for name in ("chain-0.memo", "solves.memo"):
        file = tmp_path / "new" / name
        file.write_text(content)
        with pytest.raises(CheckpointError, match=f"{name}: is of no run"):
            sample(gaussian_model(), checkpoint=tmp_path / "new", **FEW)
        assert file.read_text() == content
        file.unlink()
    (mine / "chain-0.memo").write_text(content)
    if content not in ("", "abc"):
        with pytest.raises(CheckpointError, match=r"chain-0\.memo: (ends in what zoo did not|line 1 is dam)"):
            sample(gaussian_model(), checkpoint=mine, **FEW)
        assert (mine / "chain-0.memo").read_text() == content


def test_what_a_killed_run_left_is_removed(mine: Path, tmp_path: Path) -> None:
    (tmp_path / "new").mkdir()
    for folder in (mine, tmp_path / "new"):
        names = f".zoo-{'0' * 16}.part", ".zoo-mine.part"
        for name in names:
            (folder / name).write_text("mine")
        Folder(folder).close()
        assert [name for name in names if (folder / name).exists()] == [names[1]]


def test_a_run_killed_in_its_first_write_can_be_removed_and_a_lock_of_others_not(tmp_path: Path) -> None:
    killed, theirs = tmp_path / "killed", tmp_path / "theirs"
    for folder in (killed, theirs):
        folder.mkdir()
        (folder / "lock").touch()
    (killed / f".zoo-{'0' * 16}.part").write_text("half")
    Folder(killed).remove()
    assert not killed.exists()
    (theirs / "lock").write_text("of somebody")
    with pytest.raises(OutputFileError, match="move lock away"):
        Folder(theirs).remove()
    assert (theirs / "lock").read_text() == "of somebody"


def test_a_removal_that_was_killed_is_done_by_another(mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (mine / "solves.memo").write_text("")
    removed: list[str] = []

    def killed(path: Path, *given: Any) -> None:
        if len(removed) == 2:
            raise KeyboardInterrupt
        removed.append(path.name)
        os.unlink(path)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", killed)
        with pytest.raises(KeyboardInterrupt):
            Folder(mine).remove()
    assert (mine / "run.json").exists()
    Folder(mine).remove()
    assert not mine.exists()


def test_a_folder_that_is_a_link_is_not_followed(mine: Path, tmp_path: Path) -> None:
    link, before = tmp_path / "link", sorted(mine.iterdir())
    link.symlink_to(mine)
    with pytest.raises(OutputFileError, match="link: is a link; give the folder itself"):
        sample(gaussian_model(), checkpoint=link, **FEW)
    assert sorted(mine.iterdir()) == before


def test_a_folder_or_a_pipe_in_a_checkpoint_is_named(tmp_path: Path) -> None:
    (tmp_path / "chain-0.memo").mkdir()
    with pytest.raises(OutputFileError, match=r"chain-0\.memo: is a link, or no file"):
        Folder(tmp_path)
    (tmp_path / "chain-0.memo").rmdir()
    os.mkfifo(tmp_path / "lock")  # opened for writing, it waits for ever
    with pytest.raises(OutputFileError, match="lock: is a link, or no file"):
        Folder(tmp_path)


def test_a_checkpoint_of_another_version_is_refused_by_name(mine: Path) -> None:
    stored = json.loads((mine / "run.json").read_text())
    for written in (1, 5, None):
        stored["identity"]["format"] = written
        (mine / "run.json").write_text(json.dumps(stored))
        with pytest.raises(CheckpointError, match=f"written by another version of zoo .format {written},"):
            sample(gaussian_model(), checkpoint=mine, **FEW)


@pytest.mark.parametrize("options", [{}, {"crank_nicolson": 0.0, "constrained": 0.0, "tune": "lambda"}])
def test_a_run_that_is_interrupted_resumes_with_identical_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: dict
) -> None:
    """Cut after its first refit at 200 steps."""
    settings = {**FEW, "step_options": options, "draws": 40, "tune": 450}
    whole = sample(gaussian_model(), **settings)

    def interrupt(self: pool.Chains, until: int) -> None:
        if self.states[1].steps == 230:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(pool, "SLICE_S", 0.0)  # one step
        patched.setattr(pool.Chains, "_show", interrupt)
        with pytest.raises(KeyboardInterrupt):
            sample(gaussian_model(), checkpoint=tmp_path / "c", **settings)
    again = sample(gaussian_model(), checkpoint=tmp_path / "c", **settings)
    same(again, whole)


def test_work_of_unknown_length_says_how_far_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    import time

    done = iter(range(1000))
    with (
        Display(True, every_s=0.01) as show,
        show.during("finding the mode", lambda: f"{next(done)} evaluations"),
    ):
        time.sleep(0.2)
    told = capsys.readouterr().err.splitlines()
    assert told[1].startswith("finding the mode: 1 evaluations, 0 s so far")
    with Display(False, every_s=0.01) as show, show.during("nothing", str):
        time.sleep(0.05)
    assert capsys.readouterr().err == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is always full")
def test_a_full_disk_is_told(tmp_path: Path) -> None:
    memo = Memo(tmp_path / "memo", "run")
    memo._file.close()
    memo._file = open("/dev/full", "r+b")  # noqa: SIM115 (closed by close)
    with pytest.raises(OutputFileError, match=r"cannot be written \(No space left on device\); make room"):
        memo.add(to_line("run", b"key", Found((np.ones(2),))))
    memo.close()
