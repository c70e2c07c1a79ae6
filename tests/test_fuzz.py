"""A short slice of the fuzz with a fixed seed, and that it sees what it is for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent / "fuzz"))

from outcome import judged

from zoo.blood.study import StudyError

RUN = Path(__file__).parent / "fuzz" / "run.py"


def test_a_slice_of_mutated_studies_and_damaged_files(tmp_path):
    words = "--studies 250 --files 250 --seed 5 --save".split()
    ended = subprocess.run(
        [sys.executable, str(RUN), *words, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    first, second = ended.stdout.splitlines()
    assert first.startswith("250 studies and files to import: ")
    assert second.startswith("250 damaged files: ")
    for line in (first, second):
        assert ", 0 FAILED; " in line
        read, refused = (int(line.split(words)[0].split()[-1]) for words in (" read as", " refused in"))
        assert read > 5
        assert refused > 100


def raises(error: Exception) -> None:
    raise error


@pytest.mark.parametrize(
    ("error", "names", "kind"),
    [
        (StudyError("a.toml: no"), [], "refused"),
        (StudyError("a.toml: no"), ["b.toml"], "FAILED"),
        (ValueError("a.toml: no"), [], "FAILED"),
        (KeyError("a"), [], "FAILED"),
        (StudyError(""), [], "FAILED"),
    ],
)
def test_what_counts_as_a_failure(tmp_path, error, names, kind):
    assert judged(lambda: raises(error), (StudyError,), tmp_path, names).kind == kind


def test_a_crash_of_the_process_is_a_failure(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "studies.py").write_text("import os\ndef case(*_): os.abort()\n")
    (tmp_path / "damaged.py").write_text("def case(*_): pass\n")
    run = (RUN.parent / "run.py").read_text()
    (tmp_path / "run.py").write_text(run)
    ended = subprocess.run(
        [sys.executable, str(tmp_path / "run.py"), "--studies", "1", "--save", str(tmp_path / "kept")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 1
    assert "1 FAILED" in ended.stdout
    assert "the process ended with -6" in ended.stdout
    assert (tmp_path / "kept" / "study-1-0" / "FAILURE.txt").exists()
