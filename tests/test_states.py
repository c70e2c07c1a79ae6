"""Checkpoints are data with digests: damaged, swapped and crafted files are refused, and none is ever run."""

from __future__ import annotations

import hashlib
import io
import json
import os
import pickle
import random
import shutil
from pathlib import Path

import numpy as np
import pytest

from gaussian import SETTINGS, gaussian_model
from zoo.core import digests
from zoo.core.inference.checkpoint import CheckpointError, Folder
from zoo.core.inference.pool import InlineChainPool
from zoo.core.inference.progress import ChainState, Display
from zoo.core.inference.sampling import SamplingError, sample
from zoo.core.inference.states import read_state, write_state
from zoo.core.outputs import OutputFileError

FEW = {**SETTINGS, "cores": 0, "draws": 20, "tune": 250}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "checkpoint"
    sample(gaussian_model(), checkpoint=folder, **FEW)
    return folder


def read_all(folder: Path) -> list[object]:
    """Everything that a resumed run reads."""
    opened = Folder(folder)
    try:
        stored = opened.run()
        assert stored is not None
        run = digests.of_json(stored["identity"])
        start = opened.start(run)
        opened.check_chains(run, 2)
        states = [read_state(opened.chain(k), {"run": run, "part": f"chain {k}"}) for k in range(2)]
    finally:
        opened.close()
    return [stored, start, states]


def as_text(content: object) -> str:
    """Everything to the last bit, for a comparison."""
    if isinstance(content, np.ndarray):
        return f"{content.dtype}{content.shape}{content.tobytes()!r}"
    if isinstance(content, dict):
        return "{" + ",".join(f"{k!r}:{as_text(v)}" for k, v in content.items()) + "}"
    if isinstance(content, list | tuple):
        return "[" + ",".join(map(as_text, content)) + "]"
    if hasattr(content, "points"):
        return as_text(content.points)
    return as_text(vars(content)) if hasattr(content, "__dict__") else repr(content)


FILES = ["run.json", "start.state", "chain-0.state", "chain-1.state"]


@pytest.mark.parametrize("name", FILES)
def test_no_flipped_bit_goes_unseen(folder: Path, tmp_path: Path, name: str) -> None:
    """100 bits of each file, one at a time, and 20 files cut short: refused by name, with the remedy."""
    mine = tmp_path / "checkpoint"
    shutil.copytree(folder, mine)
    raw = (folder / name).read_bytes()
    rng = random.Random(name)
    for i in range(120):
        damaged = bytearray(raw)
        if i < 100:
            damaged[rng.randrange(len(raw))] ^= 1 << rng.randrange(8)
        else:
            damaged = damaged[: rng.randrange(len(raw))]
        (mine / name).write_bytes(damaged)
        with pytest.raises(CheckpointError, match=r"start afresh|another version|earlier|later") as caught:
            read_all(mine)
        assert str(caught.value).startswith(str(mine))
        assert "\n" not in str(caught.value)
    (mine / name).write_bytes(raw)
    assert as_text(read_all(mine)) == as_text(read_all(folder))


def test_states_of_other_chains_and_runs_are_refused(folder: Path, tmp_path: Path) -> None:
    mine = tmp_path / "checkpoint"
    shutil.copytree(folder, mine)
    shutil.copy(folder / "chain-0.state", mine / "chain-1.state")
    with pytest.raises(CheckpointError, match=r"chain-1\.state: belongs to another run or another chain"):
        sample(gaussian_model(), checkpoint=mine, **FEW)
    other = tmp_path / "other"
    sample(gaussian_model(), checkpoint=other, **{**FEW, "seed": 12})
    for name in ("chain-0.state", "start.state"):
        shutil.rmtree(mine)
        shutil.copytree(folder, mine)
        shutil.copy(other / name, mine / name)
        with pytest.raises(CheckpointError, match=rf"{name}: belongs to another run"):
            sample(gaussian_model(), checkpoint=mine, **FEW)


class Bomb:
    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self):
        return Path.touch, (self.marker,)


def test_a_crafted_checkpoint_runs_nothing(folder: Path, tmp_path: Path) -> None:
    """Pickles under every name, also as an array of objects within a digest that fits."""
    marker = tmp_path / "marker"
    bomb = pickle.dumps(Bomb(marker))
    pickle.loads(bomb)
    assert marker.exists()  # it would work
    marker.unlink()
    archive = io.BytesIO()
    content = json.loads(np.load(io.BytesIO(_body(folder / "chain-0.state")))["content"].tobytes())
    text = np.frombuffer(json.dumps(content).encode(), dtype=np.uint8)
    arrays = {f"array-{i}": np.array([Bomb(marker)], dtype=object) for i in range(200)}
    np.savez(archive, content=text, **arrays)
    objects = hashlib.sha256(archive.getvalue()).hexdigest().encode() + b"\n" + archive.getvalue()
    pickled = hashlib.sha256(bomb).hexdigest().encode() + b"\n" + bomb
    mine = tmp_path / "checkpoint"
    for name in ("run.json", "start.state", "chain-0.state", "chain-1.state"):
        for crafted in (bomb, pickled, objects):
            shutil.rmtree(mine, ignore_errors=True)
            shutil.copytree(folder, mine)
            (mine / name).write_bytes(crafted)
            with pytest.raises(CheckpointError, match=name):
                sample(gaussian_model(), checkpoint=mine, **FEW)
    shutil.rmtree(mine)
    shutil.copytree(folder, mine)
    for old in ("start.pkl", "chain-0.pkl", "chain-1.pkl"):
        (mine / old).write_bytes(bomb)
    sample(gaussian_model(), checkpoint=mine, **FEW)
    assert not marker.exists()


@pytest.mark.parametrize("name", ["lock", "run.json", "start.state", "chain-0.state"])
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


def test_a_folder_or_a_pipe_in_a_checkpoint_is_named(tmp_path: Path) -> None:
    (tmp_path / ".zoo-x.part").mkdir()
    with pytest.raises(OutputFileError, match=r"\.zoo-x\.part: is a link, or no file"):
        Folder(tmp_path)
    (tmp_path / ".zoo-x.part").rmdir()
    os.mkfifo(tmp_path / "lock")  # opened for writing, it waits for ever
    with pytest.raises(OutputFileError, match="lock: is a link, or no file"):
        Folder(tmp_path)


def _body(file: Path) -> bytes:
    return file.read_bytes().partition(b"\n")[2]


@pytest.mark.parametrize(
    ("step", "options"),
    [
        ("metropolis", {}),
        ("metropolis", {"joint": False}),
        ("demetropolisz", {"crank_nicolson": 0.0, "constrained": 0.0, "tune": "lambda"}),
    ],
)
@pytest.mark.parametrize("steps", [230, 461])
def test_every_step_method_resumes_with_identical_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str, options: dict, steps: int
) -> None:
    """Cut in the tuning, after its first refit at 200 steps, and after it, between two steps of a draw."""
    settings = {**FEW, "step": step, "step_options": options, "draws": 40, "tune": 450}
    whole = sample(gaussian_model(), **settings)

    def interrupt(self: Display, states: list[ChainState], until: int) -> None:
        if states[1].steps == steps:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(InlineChainPool, "turn", 0.0)  # one step
        patched.setattr(Display, "update", interrupt)
        with pytest.raises(KeyboardInterrupt):
            sample(gaussian_model(), checkpoint=tmp_path / "c", **settings)
    again = sample(gaussian_model(), checkpoint=tmp_path / "c", **settings)
    for group in ("posterior", "sample_stats"):
        for name in whole[group].data_vars:
            np.testing.assert_array_equal(again[group][name], whole[group][name])


def test_what_no_file_can_hold_is_named(tmp_path: Path) -> None:
    with pytest.raises(SamplingError, match="a Bomb in the state of a chain cannot be stored"):
        write_state(tmp_path / "x", {}, {"proposal": Bomb(tmp_path)})
    with pytest.raises(SamplingError, match="a ndarray in the state"):
        write_state(tmp_path / "x", {}, {"array": np.array([Bomb(tmp_path)], dtype=object)})
    assert list(tmp_path.iterdir()) == []
