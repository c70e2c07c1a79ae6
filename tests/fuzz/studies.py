"""Mutated studies and files to import: each is loaded as what holds together, or refused in one line."""

from __future__ import annotations

import random
import shutil
import warnings
from pathlib import Path

from mutate import TEXT, VALUES, mutated
from outcome import Outcome, judged

from zoo.blood.importing.imported import Imported, ImportedFileError
from zoo.blood.importing.openbf import import_openbf
from zoo.blood.importing.table import import_table
from zoo.blood.network import Network
from zoo.blood.study import Study, StudyError, load_study, save_study
from zoo.core.outputs import OutputFileError

CORPUS = Path(__file__).parent / "corpus"
REFUSED = (StudyError, ImportedFileError, OutputFileError)


def read(folder: Path) -> Study:
    """What `zoo.load_study` or `zoo import` make of a folder of the corpus."""
    if (folder / "net.yaml").exists():
        return imported(import_openbf(folder / "net.yaml"), folder)
    if (folder / "vessels.csv").exists():
        inflow, observations = folder / "inflow.csv", folder / "observations.csv"
        return imported(import_table(folder / "vessels.csv", inflow, 1.0, observations=observations), folder)
    return load_study(folder)


def imported(found: Imported, folder: Path) -> Study:
    """Written as a study and read back."""
    return found.save(folder / "study")


def case(number: int, seed: str, work: Path) -> Outcome:
    """One mutated study: 0.3 of the time two of its files are."""
    rng = random.Random(f"{seed}/study/{number}")
    origin = rng.choice(sorted(path for path in CORPUS.iterdir() if path.is_dir()))
    folder = work / "case"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(origin, folder)
    names = sorted(path.name for path in folder.iterdir())
    changed = rng.sample(names, 2 if rng.random() < 0.3 else 1)
    for name in changed:  # half of them with files that are of their format still
        kinds = TEXT if rng.random() < 0.5 else VALUES
        (folder / name).write_bytes(mutated(rng, (folder / name).read_bytes(), kinds))
    return judged(lambda: whole(folder, work / "again"), REFUSED, folder, [])


def whole(folder: Path, again: Path) -> None:
    """Read a study; what is read can be written, is read back as the same, and has arrays or is refused."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        study = read(folder)
        shutil.rmtree(again, ignore_errors=True)
        save_study(study, again)
        back = load_study(again)
        assert back == study, "a study that was written reads back as another"
        Network.from_study(study)
