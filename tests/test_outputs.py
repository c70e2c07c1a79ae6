"""Files that results are written to: refused before the work, whole or not there after it."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from zoo.core.arviz_lines import datasets, of_draws
from zoo.core.outputs import OutputFileError, Run, output_file, output_folder, write_file
from zoo.core.posterior.storage import load, save_posterior

AS_ROOT = hasattr(os, "geteuid") and os.geteuid() == 0
NOBODY = 65534


def device(path: Path) -> None:
    path.symlink_to("/dev/null")


def listening(path: Path) -> None:
    socket.socket(socket.AF_UNIX).bind(str(path))


def circle(path: Path) -> None:
    path.symlink_to(path.name)


SPECIAL: dict[str, tuple[Callable[[Path], object], str]] = {
    "folder": (Path.mkdir, "is a folder; give a file in it"),
    "pipe": (os.mkfifo, "is a pipe; choose another path"),
    "socket": (listening, "is a device or a socket; choose"),
    "device": (device, "is a device or a socket; choose"),
    "circle": (circle, "cannot be written .*symbolic links"),
}


@pytest.mark.parametrize("kind", SPECIAL)
def test_only_regular_files_are_replaced(tmp_path, monkeypatch, kind):
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    make, said = SPECIAL[kind]
    path = Path("out.nc")
    make(path)
    before = path.lstat()
    for check in (output_file, lambda p: write_file(p, "x"), lambda p: output_folder(".", [p.name])):
        with pytest.raises(OutputFileError, match=f"out.nc: {said}"):
            check(path)
    assert path.lstat().st_ino == before.st_ino
    assert path.lstat().st_mode == before.st_mode
    assert os.listdir() == ["out.nc"]


@pytest.mark.parametrize("kind", [k for k in SPECIAL if k != "folder"])
def test_a_folder_of_results_is_a_folder(tmp_path, monkeypatch, kind):
    monkeypatch.chdir(tmp_path)
    SPECIAL[kind][0](Path("out"))
    with pytest.raises(
        OutputFileError, match=r"--output out: (is a [a-z ]+; give a folder|cannot be written)"
    ):
        output_folder("out", option="--output")


def test_a_link_stays_and_what_it_points_to_is_replaced(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk" / "a.csv").write_text("old")
    (tmp_path / "disk" / "a.csv").chmod(0o640)
    for name, target in (("there", "a.csv"), ("new", "b.csv")):
        link = tmp_path / name
        link.symlink_to(tmp_path / "disk" / target)
        assert write_file(output_file(link), "content") == link
        assert link.is_symlink()
        assert (tmp_path / "disk" / target).read_text() == "content"
    assert (tmp_path / "disk" / "a.csv").stat().st_mode & 0o777 == 0o640
    lost = tmp_path / "lost"
    lost.symlink_to(tmp_path / "nowhere" / "c.csv")
    with pytest.raises(OutputFileError, match="does not exist; create it"):
        output_file(lost)
    with pytest.raises(OutputFileError, match="is a link to nothing; give a folder"):
        output_folder(lost)
    assert sorted(os.listdir(tmp_path / "disk")) == ["a.csv", "b.csv"]


def test_what_is_read_is_not_replaced_and_what_is_private_is_the_owner_s(tmp_path):
    (tmp_path / "inflow.csv").write_text("flow")
    (tmp_path / "same.csv").symlink_to(tmp_path / "inflow.csv")
    with Run({}, [tmp_path / "gone.csv", tmp_path / "inflow.csv"], fresh=True):
        for name in ("inflow.csv", "same.csv"):
            with pytest.raises(OutputFileError, match=rf"-o .*{name}: is read here; choose another path"):
                output_file(tmp_path / name, "-o")
        output_file(tmp_path / "waves.csv", "-o")
    write_file(tmp_path / "key.json", "secret", private=True)
    assert (tmp_path / "key.json").stat().st_mode & 0o777 == 0o600


def test_a_name_too_long_and_a_folder_that_is_a_file(tmp_path):
    with pytest.raises(OutputFileError, match=r"cannot be written \(File name too long\)") as error:
        output_file(tmp_path / f"{'x' * 300}.nc")
    assert len(str(error.value)) <= 500
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputFileError, match="Not a directory"):
        output_file(tmp_path / "file" / "a.nc")
    with pytest.raises(OutputFileError, match="zero byte"):
        output_file(tmp_path / "a\0b")
    longest = tmp_path / ("y" * 252 + ".nc")
    assert write_file(output_file(longest), b"1").read_bytes() == b"1"  # its temporary name is short


def test_a_folder_may_be_new_at_one_level_or_at_any(tmp_path):
    assert output_folder(tmp_path / "new") == tmp_path / "new"
    assert not (tmp_path / "new").exists()
    with pytest.raises(OutputFileError, match="does not exist; create it"):
        output_folder(tmp_path / "a" / "b")
    assert output_folder(tmp_path / "a" / "b", deep=True) == tmp_path / "a" / "b"


def test_what_may_not_be_written_is_refused():
    """Of root by a user who has no rights: root itself may write everywhere."""
    with tempfile.TemporaryDirectory() as name:
        folder, file = Path(name), Path(name, "a.nc")
        file.write_text("")
        file.chmod(0o400)
        folder.chmod(0o500)
        if AS_ROOT:
            for path in (folder, file):
                os.chown(path, NOBODY, NOBODY)
            os.setresuid(NOBODY, NOBODY, 0)
        try:
            with pytest.raises(OutputFileError, match="it is read-only"):
                output_file(file)
            for check in (output_file, output_folder):
                with pytest.raises(OutputFileError, match="Permission denied"):
                    check(folder / "b.nc")
        finally:
            if AS_ROOT:
                os.setresuid(0, 0, 0)
            folder.chmod(0o700)


FULL = """
import resource, sys
import numpy as np
from zoo.core.arviz_lines import datasets, of_draws
from zoo.core.outputs import OutputFileError, write_file
from zoo.core.posterior.storage import save_posterior
import zoo.plots as plots

what, path = sys.argv[1:]
idata = of_draws({"posterior": {"a": np.random.default_rng(1).normal(size=(4, 500))}})
with plots.style.new_figure((8, 8)) as figure:
    figure.subplots().plot(np.random.default_rng(1).normal(size=500))
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))  # as a full disk: writing ends after 4 kB
try:
    if what == "posterior":
        save_posterior(idata, path)
    elif what == "text":
        write_file(path, "x" * 100_000)
    else:
        plots.save_figure(figure, path)
except OutputFileError as error:
    print(error)
    sys.exit(7)
"""


@pytest.mark.parametrize(
    ("what", "name", "there"),
    [("posterior", "a.nc", True), ("text", "a.csv", False), ("figure", "a.png", True)],
)
def test_a_full_disk_is_one_line_and_nothing_is_lost(tmp_path, what, name, there):
    path = tmp_path / name
    if there:
        path.write_text("what was there")
    ended = subprocess.run(
        [sys.executable, "-c", FULL, what, str(path)], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 7, ended.stderr
    assert ended.stdout.startswith(f"{path}: cannot be written (File too large); make room")
    assert ended.stdout.count("\n") == 1
    assert os.listdir(tmp_path) == ([name] if there else [])
    assert not there or path.read_text() == "what was there"


def test_a_posterior_reads_back_as_it_was(tmp_path):
    rng = np.random.default_rng(1)
    draws, stats = {"a": rng.normal(size=(2, 9, 3))}, {"diverging": np.zeros((2, 9), bool)}
    idata = of_draws(
        {"posterior": draws, "sample_stats": stats, "observed_data": {"y": np.arange(3)}},
        coords={"vessel": ["left", "right", "root"]},
        dims={"a": ["vessel"]},
    )
    idata.attrs["record"] = "{}"
    again = load(save_posterior(idata, tmp_path / "a.nc"))
    assert list(datasets(again)) == list(datasets(idata))
    assert again.attrs == idata.attrs
    for group in datasets(idata):
        assert again[group].identical(idata[group]), group


@pytest.mark.parametrize("asked", ["file", "folder"])
def test_a_link_that_is_changed_meanwhile_leads_to_no_file_of_others(tmp_path, asked):
    for name in ("ours", "theirs"):
        (tmp_path / name).mkdir()
    theirs, latest = tmp_path / "theirs" / "w.csv", tmp_path / "latest"
    theirs.write_text("mine")
    latest.symlink_to(tmp_path / "ours")
    with Run({"command": "simulate"}, fresh=True):
        if asked == "file":
            output_file(latest / "w.csv", "--output")
        else:
            output_folder(latest, ["w.csv"], "--output")
        latest.unlink()
        latest.symlink_to(tmp_path / "theirs")
        with pytest.raises(OutputFileError, match="not as zoo wrote it"):
            write_file(latest / "w.csv", "new")
    assert theirs.read_text() == "mine"


@pytest.mark.parametrize("when", ["fsync", "link"])
def test_what_comes_while_a_file_is_written_stays(tmp_path, monkeypatch, when):
    path, real = tmp_path / "w.csv", getattr(os, when)

    def meanwhile(*given):
        path.write_text("mine")
        return real(*given)

    monkeypatch.setattr(os, when, meanwhile)
    with Run({"command": "simulate"}, fresh=True):
        output_file(path, "--output")
        with pytest.raises(OutputFileError, match=r"not as zoo wrote it|came while this worked"):
            write_file(path, "new")
    assert path.read_text() == "mine"
    assert not list(tmp_path.glob("*.part"))


def test_a_file_is_new_also_where_there_are_no_hard_links(tmp_path, monkeypatch):
    def refused(*given):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refused)
    with Run({"command": "simulate"}):
        assert write_file(output_file(tmp_path / "w.csv", "--output"), "new").read_text() == "new"


def test_the_record_is_no_output_and_not_written_by_another_name(tmp_path):
    for check in (output_file, output_folder, lambda path: write_file(path, "x")):
        with pytest.raises(OutputFileError, match="is the name of the record of outputs; choose another"):
            check(tmp_path / ".zoo-outputs")
    (tmp_path / "theirs").write_text("mine")
    (tmp_path / ".zoo-outputs").hardlink_to(tmp_path / "theirs")
    with Run({"command": "x"}), pytest.raises(OutputFileError, match="is a link, or no file"):
        write_file(output_file(tmp_path / "a.csv", "--output"), "x")
    assert (tmp_path / "theirs").read_text() == "mine"


def test_a_link_among_ones_own_outputs_leads_to_no_file_of_others(tmp_path):
    theirs = tmp_path / "theirs.txt"
    theirs.write_text("mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "KEY").symlink_to(theirs)
    with Run({"command": "blind run"}):
        output_folder(tmp_path / "out", (), "--output")
        with pytest.raises(OutputFileError, match="not as zoo wrote it"):
            write_file(tmp_path / "out" / "KEY", "new")
    assert theirs.read_text() == "mine"


def test_an_option_that_is_not_given_makes_no_other_run(tmp_path):
    path = tmp_path / "w.csv"
    with Run({"command": "x", "--former": False}):
        write_file(output_file(path, "--output"), "first")
    with Run({"command": "x", "--sets": False, "--name": None}):
        write_file(output_file(path, "--output"), "second")
    with (
        Run({"command": "x", "--sets": True}),
        pytest.raises(OutputFileError, match="--sets was None, here it is True"),
    ):
        output_file(path, "--output")
