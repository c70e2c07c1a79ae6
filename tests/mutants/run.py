"""Apply the mutants of mutants.toml one at a time, to a copy of the checkout, and see whether tests fail.

    python tests/mutants/run.py [NAME ...] [--list] [--jobs N] [--trust]

A test is a pytest argument, or "native/test_NAME" for a C test, here without sanitizers.  First all tests
that are named must pass as things are (not with --trust).  The exit status is 1 if a mutant survives whose
equivalence is not argued, or one is noticed that is said to be equivalent.
"""

from __future__ import annotations

import argparse
import os
import queue
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_name("mutants.toml")
NATIVE = "native/"
SECONDS = 600
# -O1 and one instruction set: quick to build, the same arithmetic
FLAGS = "-std=c11 -O1 -ffp-contract=fast -fno-math-errno -fno-trapping-math -w -DZOO_NO_CLONES"


@dataclass(frozen=True)
class Mutant:
    """A change of one text of one file, and the tests that must notice it."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    drawn: bool
    equivalent: str = ""

    def text(self, folder: Path) -> str:
        """The file with the change."""
        whole = (folder / self.file).read_text(encoding="utf-8")
        if (n := whole.count(self.old)) != 1:
            raise SystemExit(f"{self.name}: the old text occurs {n} times in {self.file}, and must once")
        return whole.replace(self.old, self.new)


def read(path: Path = LIST) -> list[Mutant]:
    """All mutants of a list; tests are their own, or those of the room, where the name begins."""
    content = tomllib.loads(path.read_text(encoding="utf-8"))
    rooms: dict[str, list[str]] = content["tests"]
    return [
        Mutant(
            one["name"], one["file"], one["old"], one["new"],
            tuple(one.get("tests", rooms[one["name"].partition("-")[0]])),
            "operator" in one, one.get("equivalent", ""),
        )
        for one in content["mutant"]
    ]  # fmt: skip


class Copy:
    """A copy of the checkout to change and test in."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            cwd=ROOT, check=True, capture_output=True, text=True,
        )  # fmt: skip
        for name in filter(None, listed.stdout.split("\0")):
            if (ROOT / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, folder / name)
        models = folder / "src" / "zoo" / "models"
        if not models.exists():
            models.symlink_to("../../models")
        self.built = self._extension()
        if not self.built:
            raise SystemExit("the C core does not build")
        self.library = next((folder / "src" / "zoo").glob("_native*.so"))
        self.kept = shutil.copy2(self.library, folder / "as-it-is.so")

    def _run(self, *command: str, cwd: Path | None = None) -> tuple[bool, str]:
        paths = os.pathsep.join(filter(None, (str(self.folder / "src"), os.environ.get("PYTHONPATH"))))
        environment = {**os.environ, "PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"}
        environment["CFLAGS"] = "-DZOO_NO_CLONES"
        try:
            done = subprocess.run(
                command, cwd=cwd or self.folder, env=environment, timeout=SECONDS,
                capture_output=True, text=True, errors="replace",
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return False, f"no end after {SECONDS} s"
        return done.returncode == 0, done.stdout + done.stderr

    def _extension(self) -> bool:
        good, _ = self._run(sys.executable, "setup.py", "-q", "build_ext", "--inplace", "--force")
        return good

    def native(self, tests: Iterable[str]) -> str:
        """The first of some C tests that fails, or nothing."""
        for name in tests:
            binary = f"build/{name.removeprefix(NATIVE)}"
            good, _ = self._run("make", "-s", "-C", "native", "SANITIZE=", f"FLAGS={FLAGS}", binary)
            if not good or not self._run(f"native/{binary}")[0]:
                return name
        return ""

    def pytest(self, tests: Iterable[str]) -> str:
        """What fails of some pytest tests, if anything."""
        good, said = self._run(
            sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", *tests
        )
        if good:
            return ""
        failed = re.search(r"^(?:FAILED|ERROR) (?:tests/)?(\S+)", said, re.M)
        return failed[1] if failed else said.strip().splitlines()[-1][:100]

    def noticed(self, tests: Sequence[str], in_c: bool) -> str:
        """The first test that fails, or nothing."""
        if found := self.native(t for t in tests if t.startswith(NATIVE)):
            return found
        if not (of_python := [t for t in tests if not t.startswith(NATIVE)]):
            return ""
        if in_c and not self._extension():
            return "does not build"
        return self.pytest(of_python)

    def noticed_by(self, mutant: Mutant) -> str:
        """What notices a mutant, or nothing; the copy is as it was afterwards."""
        path = self.folder / mutant.file
        before, after = path.read_bytes(), mutant.text(self.folder)
        in_c = mutant.file.startswith("native/")
        try:
            path.write_text(after, encoding="utf-8")
            return self.noticed(mutant.tests, in_c)
        finally:
            path.write_bytes(before)
            if in_c:
                shutil.copy2(self.kept, self.library)


def main() -> int:
    """Run the mutants that are named, or whose room is, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("names", nargs="*", help="of mutants, or of rooms; all if absent")
    parser.add_argument("--list", action="store_true", help="print them only")
    parser.add_argument("--jobs", type=int, default=1, help="copies that are tested at once")
    parser.add_argument("--trust", action="store_true", help="do not run the tests on the unchanged copy")
    given = parser.parse_args()
    everything = read()
    known = {m.name for m in everything} | {m.name.partition("-")[0] for m in everything}
    if unknown := [name for name in given.names if name not in known]:
        raise SystemExit(f"no mutant {unknown[0]!r}; --list prints them")
    mutants = [
        m for m in everything if not given.names or {m.name, m.name.partition("-")[0]} & set(given.names)
    ]
    for m in mutants:
        m.text(ROOT)
        if given.list:
            print(f"{m.name:16} {'drawn  ' if m.drawn else 'by hand'} {m.file}: {' '.join(m.tests)}")
    if given.list:
        return 0
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as place:
        copies: queue.Queue[Copy] = queue.Queue()
        for i in range(given.jobs):
            (Path(place) / str(i)).mkdir()
            copies.put(Copy(Path(place) / str(i)))
        if not given.trust:
            tests = list(dict.fromkeys(test for m in mutants for test in m.tests))
            copy = copies.get()
            if found := copy.noticed(tests, False):
                raise SystemExit(f"{found} fails without any change")
            copies.put(copy)
            print(f"{len(tests)} tests or files pass as things are, in {time.monotonic() - began:.0f} s")

        def one(mutant: Mutant) -> tuple[Mutant, str]:
            copy, started = copies.get(), time.monotonic()
            try:
                by = copy.noticed_by(mutant)
            finally:
                copies.put(copy)
            verdict = "killed" if by else "equivalent" if mutant.equivalent else "SURVIVED"
            print(f"{mutant.name:16} {verdict:10} {time.monotonic() - started:4.0f} s  {by}", flush=True)
            return mutant, by

        with ThreadPoolExecutor(given.jobs) as pool:
            found = list(pool.map(one, mutants))
    killed = [m for m, by in found if by]
    left = [m for m, by in found if not by]
    wrong = [m for m in killed if m.equivalent]
    print(f"\n{len(killed)} of {len(found)} killed, in {time.monotonic() - began:.0f} s")
    for m in left:
        print(f"  {m.name:16} {m.equivalent or 'SURVIVED: no test notices ' + repr(m.new.strip())}")
    for m in wrong:
        print(f"  {m.name:16} is said to be equivalent, and was noticed")
    return int(bool(wrong) or any(not m.equivalent for m in left))


if __name__ == "__main__":
    sys.exit(main())
