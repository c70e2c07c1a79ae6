"""What makes a function a command: groups of options, its inputs and outputs, errors as one line."""

from __future__ import annotations

import functools
import inspect
import os
import re
import shlex
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import MISSING, Field, field, fields, is_dataclass
from enum import Enum, auto
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_type_hints

import typer

from zoo.cli.screen import complain, only_json, warn

if TYPE_CHECKING:
    from zoo.core.outputs import Run

_debug = False


GATE = 3
"""Exit code of a gate that fails, such as --strict where chains have not converged."""


class UsageError(ValueError):
    """An option that cannot be used; its text says what to change."""


def show_tracebacks(wanted: bool) -> None:
    """Whether the next commands end in a traceback instead of one line."""
    global _debug
    _debug = wanted


class Without:
    """In ``Annotated[SamplingOptions, Without("thin")]``: options that the command leaves out."""

    def __init__(self, *names: str) -> None:
        self.names = names


class Role(Enum):
    """In the annotation of an option: what it is for a run. A path without a role is read."""

    WRITES = auto()
    """Where results go."""
    STUDY = auto()
    """Studies, which are read: built-in names or folders."""
    SEARCHED = auto()
    """Files, or folders in which posteriors are looked for, the working folder if absent; other files may be
    written beside these."""
    MODELS = auto()
    """Models, with commas, and after "+" what they have beside."""
    EFFECTS = auto()
    """Effects, with commas."""
    ASIDE = auto()
    """With another value it is the same run."""


def _studies(typed: str) -> list[str]:
    from zoo.blood.study import list_studies

    return [name for name in list_studies() if name.startswith(typed)]


def _effects(typed: str) -> list[str]:
    from zoo.blood.effects import CATALOGUE

    before, last = re.fullmatch(r"(.*[,+])?(.*)", typed).groups("")  # type: ignore[union-attr]
    return [before + name for name in CATALOGUE if name.startswith(last)]


def _models(typed: str) -> list[str]:
    from zoo.models import MODELS

    before, last = re.fullmatch(r"(.*,)?(.*)", typed).groups("")  # type: ignore[union-attr]
    return _effects(typed) if "+" in last else [before + name for name in MODELS if name.startswith(last)]


COMPLETED = {Role.STUDY: _studies, Role.EFFECTS: _effects, Role.MODELS: _models}
"""Functions from what is typed to what a shell completes it to."""

REQUIRED: Any = MISSING
"""In the place of a default: the option must be given."""


def option(default: Any, text: str, *said: str | Role, metavar: str | None = None) -> Any:
    """An option, as the default of a command's parameter or of a field of a group.

    Parameters
    ----------
    default : object
        `REQUIRED` where there is none.
    text : str
        What --help says of it.
    *said : str or Role
        Its flags, where they are others than --NAME, and its roles.
    metavar : str, optional
        What --help calls its value.
    """
    return field(
        default=default, metadata={"kind": typer.Option, "text": text, "said": said, "metavar": metavar}
    )


def argument(metavar: str, text: str, *said: Role, default: Any = REQUIRED) -> Any:
    """The same for what is given by its place."""
    return field(
        default=default, metadata={"kind": typer.Argument, "text": text, "said": said, "metavar": metavar}
    )


FRESH = option(False, "Begin anew, and replace what zoo wrote there in other runs; nothing else, ever.")


def typed_command() -> str:
    """The command line as it was typed, for what records it."""
    return shlex.join(["zoo", *sys.argv[1:]])


def command(function: Callable[..., None]) -> Callable[..., None]:
    """A function as a command: its groups of options are spread out, its errors become one line.

    A parameter whose type is a dataclass stands for that dataclass's fields, each of which is an option with
    the field's type and default; the function gets the dataclass filled in.

    A command that writes (`Role`) has an option ``--fresh``, and works within a `zoo.core.outputs.Run` that
    knows all that it reads, so that it loses no file.

    Errors end in one red line and an exit code: 2 for what the user can change, 1 for faults of ours, 130 for
    an interruption. One that names a setting, as "tune = -1: must be ...", names its option: "--tune -1".

    Parameters
    ----------
    function : callable
        Whose parameters are options, arguments and groups.

    Returns
    -------
    callable
        For ``app.command()``.
    """
    parameters, groups = _spread(function)
    flags, roles = _flags(parameters), {p.name: get_args(p.annotation)[1:] for p in parameters}
    writes, own = any(Role.WRITES in role for role in roles.values()), "fresh" in roles
    if writes and not own:
        parameters.append(_parameter("fresh", bool, FRESH))

    @functools.wraps(function)
    def run(**given: Any) -> None:
        asked = dict(given)
        if not own:
            given.pop("fresh", None)
        for name, (group, options) in groups.items():
            given[name] = group(**{option: given.pop(option) for option in options})
        try:
            with _warnings_as_lines(), only_json(bool(asked.get("as_json"))):
                if not writes:
                    function(**given)
                    return
                with _run_of(function.__name__.strip("_"), asked, roles, flags) as this:
                    taken: dict[str, str] = {}
                    for name in (name for name, role in roles.items() if Role.WRITES in role):
                        if asked[name] is not None:
                            named = f"{flags.get(name, '')} {asked[name]}".strip()
                            other = taken.setdefault(os.path.realpath(asked[name]), named)
                            if other != named:
                                raise UsageError(f"{named}: is the path of {other} too; choose another")
                            this.add(Path(asked[name]), named)
                    function(**given)
        except typer.Exit:
            raise
        except KeyboardInterrupt:
            complain("interrupted; the same command goes on from its checkpoint if it has one")
            raise typer.Exit(130) from None
        except BrokenPipeError:  # as of `| head`: nobody reads on
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(141) from None
        except Exception as error:
            if _debug:
                raise
            ours = any(kind.__module__.split(".")[0] == "zoo" for kind in type(error).__mro__)
            text = " ".join(str(error).split()) or type(error).__name__
            text = _with_option(text, flags) if ours else text
            if isinstance(error, FileExistsError | NotADirectoryError):
                text = f"{error.filename}: is a file where a folder is needed; choose another path"
            if ours or isinstance(error, OSError):
                complain(text)
                raise typer.Exit(2) from None
            complain(f"unexpected {type(error).__name__}: {text}; `zoo --debug ...` shows where")
            raise typer.Exit(1) from None

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return run


def _flags(parameters: Sequence[inspect.Parameter]) -> dict[str, str]:
    """Setting -> its option, such as "dx_cm" -> "--dx"."""
    found: dict[str, str] = {}
    for parameter in parameters:
        for extra in get_args(parameter.annotation)[1:]:
            # typer keeps the first word of an annotation as its default
            words = getattr(extra, "default", None), *(getattr(extra, "param_decls", None) or ())
            for word in words:
                if str(word).startswith("--"):
                    found.setdefault(parameter.name, word.split("/")[0])
    return found


def _with_option(text: str, options: Mapping[str, str]) -> str:
    """An error's text with the option in place of the setting that it names."""
    match = re.match(r"(\w+) = ([^\s:]+|'[^']*'): (.*)", text)
    if match is None or match[1] not in options:
        return text
    return f"{options[match[1]]} {match[2].strip(chr(39))}: {match[3]}"


def _run_of(
    name: str, given: Mapping[str, Any], roles: Mapping[str, Sequence[Any]], flags: Mapping[str, str]
) -> Run:
    """What a command reads, and what makes its run: its options, and what is in the files that they name."""
    from zoo.blood.study import StudyError
    from zoo.blood.study.settings import read_setting
    from zoo.core.digests import of_bytes
    from zoo.core.outputs import Run

    changes: dict[str, Any] = {}
    with suppress(StudyError):  # which the command itself tells
        changes = dict(map(read_setting, given.get("settings") or []))
    inputs: list[Path] = []
    identity: dict[str, Any] = {"command": name}
    for option, value in given.items():
        role = roles.get(option, (Role.ASIDE,))
        value = [Path()] if value is None and Role.SEARCHED in role else value
        if value is None or Role.WRITES in role or option == "fresh":
            continue
        same: list[Any] = []
        for one in value if isinstance(value, list) else [value]:
            paths = _read_by(one, role, changes)
            inputs += paths
            whole = () if Role.SEARCHED in role else paths  # a page may be made again of new posteriors
            files = [of_bytes(path.read_bytes()) for path in whole if path.is_file()]
            same.append(files or (str(one) if isinstance(one, Path) else one))
        if Role.ASIDE not in role:
            identity[flags.get(option, option)] = same if isinstance(value, list) else same[0]
    return Run(identity, inputs, fresh=given["fresh"])


def _read_by(value: Any, role: Sequence[Any], changes: Mapping[str, Any]) -> list[Path]:
    """Files and folders that a command reads by an option's value."""
    if Role.STUDY in role or (isinstance(value, Path) and (value / "study.toml").is_file()):
        from zoo.blood.study import study_files

        files = study_files(value, changes)
        return [*files, *{file.parent for file in files[:1]}]
    if not isinstance(value, Path):
        return []
    if Role.SEARCHED in role and value.is_dir():
        return sorted(value.glob("*.nc"))
    return [value, *_beside(value)]


def _beside(file: Path) -> list[Path]:
    """What a file reads from beside it: the modules of a Python file, the inflow of openBF's network."""
    python, folder, found = file.suffix == ".py", file.parent, [file]
    if not file.is_file() or not (python or file.suffix.lower() in (".yaml", ".yml")):
        return []
    there = set(folder.glob("*.py" if python else "*"))
    for package in folder.glob("*/__init__.py") if python else ():
        there |= set(package.parent.rglob("*.py"))
    for reader in found:  # which grows
        text = reader.read_text(encoding="utf-8", errors="replace")
        for path in sorted(there - set(found)):
            name = path.relative_to(folder).parts[0].removesuffix(".py" if python else "_inlet.dat")
            if path.is_file() and re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text):
                found.append(path)
        if not python:
            break
    return found[1:]


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Warnings of this package become lines, each text once; all others stay as they are."""
    told = set()
    with warnings.catch_warnings():
        show = warnings.showwarning

        def line(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
            if category.__module__.split(".")[0] != "zoo":
                show(message, category, *where, **more)
            elif str(message) not in told:
                told.add(str(message))
                warn(str(message))

        warnings.showwarning = line
        yield


def _spread(
    function: Callable[..., None],
) -> tuple[list[inspect.Parameter], dict[str, tuple[type, list[str]]]]:
    """Parameters of a command with those of its groups, and the groups with the names of their options."""
    hints = get_type_hints(function, include_extras=True)
    parameters: dict[str, inspect.Parameter] = {}
    groups: dict[str, tuple[type, list[str]]] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        group, *extras = get_args(hints[name]) or (hints[name],)
        if not (isinstance(group, type) and is_dataclass(group)):
            given = parameter.default
            plain = parameter.replace(annotation=hints[name])
            found = [_parameter(name, hints[name], given) if isinstance(given, Field) else plain]
        else:
            left_out = {option for extra in extras if isinstance(extra, Without) for option in extra.names}
            whole = tuple(extra for extra in extras if isinstance(extra, Role))
            found = _options(group, left_out, whole)
            groups[name] = group, [option.name for option in found]
        for option in found:
            if option.name in parameters:
                raise TypeError(f"{function.__name__}: two options named {option.name}")
            parameters[option.name] = option.replace(kind=inspect.Parameter.KEYWORD_ONLY)
    return list(parameters.values()), groups


def _options(group: type, left_out: set[str], roles: tuple[Role, ...]) -> list[inspect.Parameter]:
    hints = get_type_hints(group)
    return [
        _parameter(one.name, hints[one.name], one, roles) for one in fields(group) if one.name not in left_out
    ]


def _parameter(name: str, kind: Any, given: Field[Any], roles: tuple[Role, ...] = ()) -> inspect.Parameter:
    """A parameter as typer reads it, with its roles behind what typer knows of it."""
    told, said = given.metadata, given.metadata["said"]
    flags = [one for one in said if isinstance(one, str)]
    if told["kind"] is typer.Option and not flags:
        flags = [f"--{name.replace('_', '-')}"]
    roles = *(one for one in said if isinstance(one, Role)), *roles
    complete = next((COMPLETED[role] for role in roles if role in COMPLETED), None)
    known = told["kind"](*flags, help=told["text"], metavar=told["metavar"], autocompletion=complete)
    default = inspect.Parameter.empty if given.default is REQUIRED else given.default
    annotation = Annotated[(kind, known, *roles)]
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
