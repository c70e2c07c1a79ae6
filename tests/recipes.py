"""The recipes of docs/extending.md, and a copy of the package in which they are followed."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def snippets(heading: str, language: str) -> list[str]:
    """Code blocks of a language in a section of docs/extending.md."""
    text = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    section = re.split(rf"^## {re.escape(heading)}$", text, maxsplit=1, flags=re.M)[1]
    section = re.split(r"^##", section, maxsplit=1, flags=re.M)[0]
    return re.findall(rf"^```{language}\n(.*?)^```", section, flags=re.S | re.M)


class Copy:
    """A copy of the package, to which diffs are applied."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        ignore = shutil.ignore_patterns("models", "__pycache__")
        shutil.copytree(ROOT / "src" / "zoo", folder / "zoo", ignore=ignore)
        shutil.copytree(
            ROOT / "models", folder / "zoo" / "models", ignore=shutil.ignore_patterns("__pycache__")
        )

    def place(self, path: str) -> Path:
        """Where a file of the repository stands in the copy."""
        return self.folder / (f"zoo/{path}" if path.startswith("models/") else path.removeprefix("src/"))

    def apply(self, diff: str) -> list[str]:
        """Add what a diff adds: whole new files, and lines at the end of those that exist; the files."""
        touched = []
        for part in re.split(r"^--- ", diff, flags=re.M)[1:]:
            head, *lines = part.splitlines()
            new = head == "/dev/null"
            path = lines.pop(0).removeprefix("+++ b/") if new else head.removeprefix("a/")
            assert all(line.startswith("+") for line in lines), path
            place = self.place(path)
            assert place.exists() != new, path
            with place.open("a", encoding="utf-8") as file:
                file.write("".join(f"{line[1:]}\n" for line in lines))
            touched.append(path)
        return touched

    def run(self, *words: str) -> str:
        """What Python prints with the copy in place of the package."""
        found = subprocess.run(
            [sys.executable, *words],
            env={**os.environ, "PYTHONPATH": str(self.folder)},
            cwd=self.folder,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert found.returncode == 0, found.stderr
        return found.stdout
