"""Code blocks of the documents: how they are run, and whether what comes out is what they show."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NOT_RUN = re.compile(r"<!-- not run: (.+?) -->\n+\Z")
"""Stands before a block that is not run, with the reason."""
NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
TOLERANCE = 0.05
"""Relative, of measured numbers; the last digit shown is always free by one."""
COUNT_TOLERANCE = 0.35
"""Relative, of whole numbers above ten: draws' effective sizes, solves, seconds."""
CONVERGED = """
if "idata" in globals():
    from zoo.core.inference.convergence import diagnostics

    verdict = diagnostics(idata).verdict
    assert verdict.passes, verdict.text
"""


@dataclass(frozen=True)
class Block:
    """A code block of a document."""

    document: Path
    line: int
    language: str
    text: str
    not_run: str = ""
    shown: str = ""

    def __str__(self) -> str:
        return f"{self.document.relative_to(ROOT)}:{self.line}"

    @property
    def commands(self) -> list[tuple[str, list[str]]]:
        """Lines after a dollar sign, each with the output that is shown below it."""
        found: list[tuple[str, list[str]]] = []
        for line in self.text.splitlines():
            if line.startswith("$ "):
                found.append((line[2:], []))
            elif found:
                found[-1][1].append(line)
        return found


def blocks(document: Path) -> list[Block]:
    """All code blocks of a document; one of text right after one of Python is what that prints."""
    text = document.read_text(encoding="utf-8")
    found: list[Block] = []
    end = 0
    for match in re.finditer(r"^```(\w*)\n(.*?)^```\n", text, flags=re.S | re.M):
        language, body = match.groups()
        before = text[end : match.start()]
        if language == "text" and not before.strip() and found and found[-1].language == "python":
            found[-1] = Block(**{**vars(found[-1]), "shown": body})
        else:
            marker = NOT_RUN.search(before)
            line = text[: match.start()].count("\n") + 1
            found.append(Block(document, line, language, body, marker[1] if marker else ""))
        end = match.end()
    return found


def environment() -> dict[str, str]:
    """As a reader has it, with the package that is tested."""
    path = os.pathsep.join(filter(None, [str(ROOT / "src"), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1", "NO_COLOR": "1", "COLUMNS": "200"}


def run_command(line: str, folder: Path) -> str:
    """What a command prints; it has to succeed, unless it is said to fail."""
    shell = f'zoo() {{ "{sys.executable}" -m zoo "$@"; }}\n{line}\n'
    done = subprocess.run(
        ["bash", "-c", shell],
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=900,
        check=False,
    )
    return done.stdout


def run_python(code: str, folder: Path) -> str:
    """What a script prints; it has to succeed, and posteriors that it draws have to converge."""
    (folder / "block.py").write_text(code + CONVERGED, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "block.py"],
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


def near(shown: str, printed: str) -> bool:
    """Whether a number is the one that is shown, within the tolerances."""
    a, b = (float(text.replace("−", "-")) for text in (shown, printed))
    whole = re.fullmatch(r"\d+", shown) is not None
    digits = shown.partition("e")[0].partition(".")[2]
    step = 0.0 if whole else 10.0 ** -len(digits) * (10.0 ** float(shown.partition("e")[2] or 0))
    tolerance = COUNT_TOLERANCE if whole and a > 10 else TOLERANCE
    return abs(a - b) <= max(1.01 * step, tolerance * abs(a))


def same_line(shown: str, printed: str) -> bool:
    """Whether two lines have the same words, and numbers that are near."""
    if NUMBER.sub("#", shown).split() != NUMBER.sub("#", printed).split():
        return False
    return all(near(*pair) for pair in zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True))


def missing(shown: list[str], printed: str) -> str:
    """The first shown line that was not printed in its place; empty if all were.

    A line "..." stands for any lines, and so do blank ones. Without it, lines follow each other.
    """
    lines = [line for line in printed.splitlines() if line.strip()]
    at, anywhere = 0, True
    for line in (line for line in shown if line.strip()):
        if line.strip() == "...":
            anywhere = True
            continue
        reach = range(at, len(lines) if anywhere else min(at + 1, len(lines)))
        found = next((k for k in reach if same_line(line, lines[k])), None)
        if found is None:
            return line
        at, anywhere = found + 1, False
    return ""
