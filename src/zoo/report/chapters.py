"""The page on stored posteriors: a chapter for each study."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zoo.blood.fetch import FetchError
from zoo.blood.plugins import get_model
from zoo.blood.study import load_study
from zoo.core.arviz_lines import InferenceData
from zoo.core.inference.convergence import ESS_TARGET, RHAT_LIMIT
from zoo.core.inference.record import ResultsError, RunRecord, versions
from zoo.core.outputs import output_file
from zoo.core.posterior import storage
from zoo.core.posterior.files import find, load_posterior
from zoo.models import MODELS
from zoo.report.chapter import Chapter, part_of
from zoo.report.page import ReportError, write_page

if TYPE_CHECKING:
    import pymc as pm

    from zoo.blood.study import Study

BANNER = "not converged: do not cite"


def write_report(
    path: str | Path,
    study: Study,
    posteriors: Mapping[str, InferenceData],
    models: Mapping[str, pm.Model],
    **options: Any,
) -> Path:
    """Write the report on one study; see `write_chapters`.

    Parameters
    ----------
    path : path
        HTML file to write.
    study : Study
    posteriors : mapping of model to InferenceData
    models : mapping of model to pm.Model
    **options
        Of `write_chapters`.

    Returns
    -------
    Path
        The written file.

    Raises
    ------
    ReportError
        If a posterior has no model.
    zoo.core.outputs.OutputFileError
        If the file cannot be written.
    """
    title = f"Models of blood flow: {study.name}"
    chapter = Chapter(study.name, posteriors, study, models)
    return write_chapters(path, [chapter], **{"title": title} | options)


def write_chapters(
    path: str | Path,
    chapters: Sequence[Chapter],
    *,
    title: str = "Models of blood flow",
    ic: str = "waic",
    n_draws: int = 1000,
    command: str = "",
    say: Callable[[str], None] = lambda text: None,
) -> Path:
    """Write one self-contained HTML page with a chapter for each study.

    Figures and style are inside the page; nothing is loaded from elsewhere.

    Parameters
    ----------
    path : path
        HTML file to write.
    chapters : sequence of Chapter
    title : str
    ic : {"waic", "loo"}
        What ranks, in tables made here.
    n_draws : int
        Draws of each posterior that are scored, in tables made here.
    command : str
        The command that made the page.
    say : callable
        Told what is being done, one line each.

    Returns
    -------
    Path
        The written file.

    Raises
    ------
    ReportError
        If there is nothing to report, or a posterior has no model.
    zoo.core.outputs.OutputFileError
        If the file cannot be written.
    zoo.core.posterior.comparison.ComparisonError
        If posteriors and models do not fit each other.
    """
    path = output_file(path)
    if not chapters:
        raise ReportError("no chapters: give at least one study")
    anchors: set[str] = set()
    parts = [part_of(chapter, _anchor(chapter.name, anchors), ic, n_draws, say) for chapter in chapters]
    return write_page(
        path,
        "report.html",
        title=title,
        made=datetime.now(UTC).strftime("%d %B %Y, %H:%M UTC").lstrip("0"),
        versions=versions(),
        parts=parts,
        command=command,
        banner=BANNER,
        limits={"rhat": RHAT_LIMIT, "ess": int(ESS_TARGET)},
    )


def _anchor(name: str, taken: set[str]) -> str:
    base = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "study"
    anchor, n = base, 1
    while anchor in taken:
        n += 1
        anchor = f"{base}-{n}"
    taken.add(anchor)
    return anchor


def stored(folders: Iterable[Path], study: str, letters: Sequence[str] = MODELS) -> dict[str, InferenceData]:
    """Posteriors of a study in folders, by the name in their records: for when its data are not here.

    Parameters
    ----------
    folders : iterable of Path
    study : str
        Its name.
    letters : sequence of str
        Models to take.

    Returns
    -------
    dict
        Model -> InferenceData, in the order of the models' names; of several the last.
    """
    found = {}
    for file in (file for folder in folders for file in sorted(folder.glob("*.nc"))):
        try:
            idata = storage.load(file)
            record = RunRecord.of(idata)
        except ResultsError:
            continue
        if record.study == study and record.model in letters:
            found[record.model] = idata
    return dict(sorted(found.items()))


def gather(
    studies: Iterable[str],
    folders: Sequence[Path],
    *,
    letters: Sequence[str] = MODELS,
    data: bool = False,
    load: Callable[[str], Study] = load_study,
    say: Callable[[str], None] = lambda text: None,
) -> list[Chapter]:
    """Chapters on studies with the posteriors that folders hold.

    A chapter on measured data that cannot be had shows what needs only the posteriors.

    Parameters
    ----------
    studies : iterable of str
        Names or folders, as `zoo.load_study` takes them.
    folders : sequence of Path
        With posteriors; each study finds its own by their records.
    letters : sequence of str
        Models to take.
    data : bool
        Refuse measured data that cannot be had.
    load : callable
        What loads a study by its name.
    say : callable
        Told of files that are passed over, one line each.

    Returns
    -------
    list of Chapter

    Raises
    ------
    zoo.blood.fetch.FetchError
        If `data` and measured data cannot be had.
    zoo.core.posterior.files.PosteriorError
        If a folder does not exist, or a posterior was drawn with other conventions.
    ReportError
        If there is no posterior of any of the studies.
    """
    chapters = []
    for name in studies:
        try:
            study = load(name)
        except FetchError as error:
            if data:
                raise
            note = f"The measured data are not here, so there are no fits and no comparison. {error}"
            posteriors = stored(folders, name, letters)
            chapters.append(Chapter(name, posteriors, note=note, commands=[f"zoo fetch {name}"]))
            continue
        files_found = find(folders, letters, study, say=say)
        models = {letter: get_model(letter)(study) for letter in letters if letter in files_found}
        posteriors = {letter: load_posterior(files_found[letter], model) for letter, model in models.items()}
        commands = [] if posteriors else [f"zoo sample {x} {study.name} --seed 1 -o {x}.nc" for x in letters]
        chapters.append(Chapter(study.name, posteriors, study, models, commands=commands))
    if not any(chapter.posteriors for chapter in chapters):
        names, where = (", ".join(str(x) for x in given) for given in (studies, folders))
        raise ReportError(
            f"no posterior of {names} in {where or 'no folder'}; `zoo sample A {chapters[0].name} -o A.nc` "
            "makes one"
        )
    return chapters
