"""The comparison of models for machines: a file, gates, a summary in Markdown, a report as of tests."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from zoo.core import digests
from zoo.core.inference.record import versions
from zoo.core.words import OneLineError, nearest

FIELDS = re.compile(r"\s*(\w+)\s*(<=|>=|!=|=|<|>)\s*(.+?)\s*")
BASELINE = re.compile(r"baseline(?:\s*([+-])\s*([\d.eE+-]+)(\s*se)?)?")
COMPARED: Mapping[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
    "=": operator.eq,
    "!=": operator.ne,
}
ANSWERS = {"yes": True, "no": False}
COLUMNS = (
    "rank", "difference", "difference_se", "weight", "standing", "waic", "waic_se", "waic_mcse", "p_waic",
    "waic_warning", "waic_leave_one_out", "waic_one_observation", "one_observation_mcse", "p_one_observation",
    "loo", "loo_se", "loo_mcse", "p_loo", "pareto_k_max", "pareto_k_bad", "draws", "converged", "rhat_max",
    "ess_min", "convergence", "at_bounds", "uninformed", "prior_sensitive",
)  # fmt: skip
"""Of a comparison, which gates may be about, beside sums of squared errors of each group."""
OF_ARVIZ = ("elpd", "elpd_waic", "elpd_loo", "elpd_diff", "se", "dse", "warning", "scale")
"""Columns for ArviZ's plots, which differ between its lines."""
FORM = 'give such as "converged=no", "ess_min < 400" or "waic > baseline + 2 se"'


class GateError(OneLineError, ValueError):
    """A gate or a stored comparison that cannot be used; its text says what to change."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid")


class ModelScore(_Part):
    """One model: its row of the table by column, and the terms of the criterion, on the log scale."""

    row: dict[str, float | bool | str | None]
    terms: list[float]


class StudyScores(_Part):
    """All models of one study, the best first."""

    checksum: str
    models: dict[str, ModelScore]


class ComparisonFile(_Part):
    """Content of the file that `zoo compare --json` writes; documented in docs/commands.md."""

    format: Literal[1] = 1
    criterion: Literal["waic", "loo"]
    studies: dict[str, StudyScores]
    versions: dict[str, str]

    def to_text(self) -> str:
        """As JSON with its digest."""
        return digests.to_text(self.model_dump(mode="json"))

    def check(self, criterion: str) -> None:
        """Refuse to be the baseline of a comparison by another criterion."""
        if self.criterion != criterion:
            raise GateError(
                f"the baseline ranks by {self.criterion}, this comparison by {criterion}: give the same "
                "--ic as then"
            )


def _plain(value: Any) -> float | bool | str | None:
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def comparison_file(tables: Mapping[str, Any], criterion: Literal["waic", "loo"]) -> ComparisonFile:
    """Tables of `zoo.compare` as one file.

    Parameters
    ----------
    tables : mapping of study to DataFrame
    criterion : {"waic", "loo"}
        What ranks.

    Returns
    -------
    ComparisonFile
    """
    studies = {
        study: StudyScores(
            checksum=table.attrs["checksum"],
            models={
                str(model): ModelScore(
                    row={str(k): _plain(v) for k, v in row.items() if k not in OF_ARVIZ},
                    terms=table.attrs["terms"][model],
                )
                for model, row in table.iterrows()
            },
        )
        for study, table in tables.items()
    }
    return ComparisonFile(criterion=criterion, studies=studies, versions=versions())


def read_comparison(path: str | Path) -> ComparisonFile:
    """Read what `zoo compare --json` wrote.

    Parameters
    ----------
    path : path

    Returns
    -------
    ComparisonFile

    Raises
    ------
    GateError
        If it is missing, damaged, or another file.
    """
    again = "make it again with `zoo compare --json`"
    try:
        return ComparisonFile.model_validate(digests.from_text(Path(path).read_bytes()))
    except OSError as error:
        raise GateError(f"{path}: cannot be read ({error.strerror}); {again}") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(x) for x in first["loc"]) or "the file"
        raise GateError(f"{path}: {where}: {first['msg']}; {again}") from None
    except ValueError as error:
        raise GateError(f"{path}: cannot be read ({error}); {again}") from None


@dataclass(frozen=True)
class Gate:
    """What must not be so of any model, such as ``waic > baseline + 2 se``.

    Parameters
    ----------
    text : str
        As it was given.
    field : str
        A column of the comparison.
    sign : str
        One of < > <= >= = !=.
    value : float or bool
        What the column is compared with, or what is added to the baseline's own.
    of_baseline : bool
        Whether it is compared with the baseline's own value.
    in_errors : bool
        Whether `value` counts standard errors of the difference to the baseline.
    """

    text: str
    field: str
    sign: str
    value: float | bool
    of_baseline: bool = False
    in_errors: bool = False

    @classmethod
    def read(cls, text: str) -> Gate:
        """A gate from its text.

        Raises
        ------
        GateError
            If the text is none.
        """
        found = FIELDS.fullmatch(text)
        if found is None:
            raise GateError(f"gate {text!r}: is none; {FORM}")
        field, sign, right = found.groups()
        if like := BASELINE.fullmatch(right):
            added, right = f"{like[1] or ''}{like[2] or 0}", like[2] or "0"
        try:
            value = ANSWERS[right] if right in ANSWERS else float(added if like else right)
        except ValueError:
            raise GateError(f"gate {text!r}: {right!r} is no number, yes or no; {FORM}") from None
        if not math.isfinite(value) or (isinstance(value, bool) and sign not in ("=", "!=")):
            raise GateError(f"gate {text!r}: can never fail or always does; {FORM}")
        return cls(text, field, sign, value, like is not None, bool(like and like[3]))

    def check(self, criterion: str) -> None:
        """Refuse a column that no comparison has, and standard errors of another than the criterion."""
        if self.field not in COLUMNS and not self.field.startswith("sse_"):
            raise GateError(f"gate {self.text!r}: {nearest(self.field, COLUMNS)} or a sum of squares sse_...")
        if self.in_errors and self.field != criterion:
            raise GateError(f"gate {self.text!r}: se is that of a difference in {criterion}; give a number")


@dataclass(frozen=True)
class Judged:
    """A gate and a model: whether it failed, None where there is nothing to compare with; and why."""

    study: str
    model: str
    gate: Gate
    failed: bool | None
    why: str


def change(now: ModelScore, then: ModelScore, field: str) -> tuple[float, float]:
    """A criterion less what it was, and the standard error of that.

    From the terms' differences, and the Monte Carlo errors of both posteriors, which all terms share.

    Parameters
    ----------
    now, then : ModelScore
        On the same data.
    field : str
        "waic" or "loo".

    Returns
    -------
    difference, se : float
        Deviance scale.
    """
    terms = np.subtract(now.terms, then.terms)
    difference = float(now.row[field]) - float(then.row[field])  # type: ignore[arg-type]
    drawn = [float(one.row.get(f"{field}_mcse") or 0.0) for one in (now, then)]
    return difference, math.hypot(2.0 * math.sqrt(len(terms) * float(np.var(terms))), *drawn)


def judge(
    file: ComparisonFile, gates: Sequence[Gate], baseline: ComparisonFile | None = None
) -> list[Judged]:
    """Every gate on every model.

    Parameters
    ----------
    file : ComparisonFile
    gates : sequence of Gate
    baseline : ComparisonFile, optional
        An earlier one.

    Returns
    -------
    list of Judged

    Raises
    ------
    GateError
        If a gate names no column, or the baseline of another criterion or none at all.
    """
    if baseline is not None:
        baseline.check(file.criterion)
    return [
        _judged(file, study, name, gate, baseline)
        for study, scores in file.studies.items()
        for name in scores.models
        for gate in gates
    ]


def _judged(
    file: ComparisonFile, study: str, name: str, gate: Gate, baseline: ComparisonFile | None
) -> Judged:
    gate.check(file.criterion)
    now = file.studies[study].models[name]
    if gate.field not in now.row:
        raise GateError(f"gate {gate.text!r}: no column {gate.field}; there are {', '.join(now.row)}")
    own, limit, told = now.row[gate.field], gate.value, str(gate.value)
    if isinstance(gate.value, bool):
        told = "yes" if gate.value else "no"
    if gate.of_baseline:
        if baseline is None:
            raise GateError(f"gate {gate.text!r}: there is no baseline; give --baseline")
        then = baseline.studies.get(study)
        if then is None or name not in then.models:
            return Judged(study, name, gate, None, "the baseline does not have it")
        if then.checksum != file.studies[study].checksum:
            return Judged(
                study, name, gate, True, "the baseline is of other data: make a new one with --json"
            )
        before = then.models[name]
        reference = before.row.get(gate.field)
        if reference is None:
            return Judged(study, name, gate, True, f"{gate.field} is unknown in the baseline")
        if not isinstance(reference, int | float):
            raise GateError(f"gate {gate.text!r}: {gate.field} is no number in the baseline")
        scale = change(now, before, gate.field)[1] if gate.in_errors else 1.0
        limit = reference + gate.value * scale if gate.value else reference
        told = f"{limit:.6g}, was {reference:.6g}"
    if own is not None and (isinstance(own, str) or isinstance(own, bool) != isinstance(limit, bool)):
        kind = "a text" if isinstance(own, str) else "yes or no" if isinstance(own, bool) else "a number"
        raise GateError(f"gate {gate.text!r}: {gate.field} is {kind}, which that cannot be compared with")
    if own is None:
        return Judged(study, name, gate, True, f"{gate.field} is {own}, which cannot be compared")
    shown = {True: "yes", False: "no"}.get(own, own) if isinstance(own, bool) else own
    shown = f"{shown:.6g}" if isinstance(shown, float) else shown
    why = f"{gate.field} is {shown}" + (f", limit {told}" if gate.sign not in "!=" else "")
    return Judged(study, name, gate, COMPARED[gate.sign](own, limit), why)


def markdown(
    file: ComparisonFile, judged: Sequence[Judged] = (), baseline: ComparisonFile | None = None
) -> str:
    """One screen: the ranking, differences with their errors, what changed, convergence, gates.

    Parameters
    ----------
    file : ComparisonFile
    judged : sequence of Judged
    baseline : ComparisonFile, optional

    Returns
    -------
    str
    """
    return "\n".join(_lines(file, judged, baseline)) + "\n"


def _lines(file: ComparisonFile, judged: Sequence[Judged], baseline: ComparisonFile | None) -> Iterator[str]:
    name = {"waic": "WAIC", "loo": "PSIS-LOO"}[file.criterion]
    failed = [one for one in judged if one.failed]
    yield f"# Comparison of models: gates that failed: {len(failed)} of {len(judged)}"
    for one in failed:
        yield f"- **{one.study}, model {one.model}: {one.gate.text}** ({one.why})"
    for study, scores in file.studies.items():
        yield f"\n## {study}\n"
        yield f"{name}, lower is better; ± is one standard error.\n"
        yield f"| model | {name} | behind the best | since the baseline | converged |"
        yield "|---|---|---|---|---|"
        then = baseline.studies.get(study) if baseline else None
        same = then is not None and then.checksum == scores.checksum
        for model, score in scores.models.items():
            row = score.row
            before = then.models.get(model) if then is not None and same else None
            moved = "new" if same else "other data" if then is not None else "no baseline"
            if before is not None:
                moved = "{:+.1f} ± {:.1f}".format(*change(score, before, file.criterion))
            criterion, criterion_se, difference, se, rhat, ess = (
                "unknown" if row[x] is None else f"{row[x]:{form}}"
                for x, form in (
                    (file.criterion, ".1f"), (f"{file.criterion}_se", ".1f"), ("difference", ".1f"),
                    ("difference_se", ".1f"), ("rhat_max", ".3f"), ("ess_min", ".0f"),
                )
            )  # fmt: skip
            behind = f"{difference} ± {se}" if row["rank"] else "best"
            yield (
                f"| {model} | {criterion} ± {criterion_se} | {behind} | {moved} "
                f"| {'yes' if row['converged'] else 'no'}, R-hat {rhat}, ESS {ess} |"
            )


def junit(judged: Sequence[Judged]) -> str:
    """A report that CI systems show: a test suite for each study, a test for each model and gate.

    Parameters
    ----------
    judged : sequence of Judged

    Returns
    -------
    str
        XML.
    """
    root = ElementTree.Element("testsuites")
    for study in dict.fromkeys(one.study for one in judged):
        own = [one for one in judged if one.study == study]
        failures, skipped = (sum(one.failed is x for one in own) for x in (True, None))
        suite = ElementTree.SubElement(root, "testsuite", name=study, tests=str(len(own)))
        suite.attrib |= {"failures": str(failures), "skipped": str(skipped)}
        for one in own:
            case = ElementTree.SubElement(suite, "testcase", classname=one.model, name=one.gate.text)
            if one.failed is not False:
                kind = "skipped" if one.failed is None else "failure"
                ElementTree.SubElement(case, kind, message=one.why)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
