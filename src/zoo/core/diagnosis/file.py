"""diagnosis.json: what a diagnosis writes and reads back."""

from __future__ import annotations

import math
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    field_serializer,
    field_validator,
    model_serializer,
    model_validator,
)

from zoo.core import digests
from zoo.core.words import OneLineError, span, unit_words

FORMAT = 4
AMOUNT = "amount in the unit"
"""Mark of a field that is in the unit of its part of the file."""
OF_CAUSES = ("causes", "names", "components")
"""Fields of a set that are of its causes."""
LINES = 20
"""Lines that `print` shows of a diagnosis at most."""
ROUNDING = 1e-9
"""What a sum of thousands of probabilities may be above 1 by rounding."""


def _probability(p: float) -> float:
    if not 0.0 <= p <= 1.0 + ROUNDING:
        raise ValueError(f"{p:g} is no probability")
    return min(p, 1.0)


Probability = Annotated[float, AfterValidator(_probability)]


class DiagnosisError(OneLineError, ValueError):
    """A diagnosis that cannot be made or read; its text says why and what to change."""


def unit_suffix(unit: str) -> str:
    """A unit as the end of a field's name: "_mmHg", "_ml_s"; nothing for a pure number."""
    return "" if unit == "1" else "_" + unit.replace("/", "_").replace(" ", "_")


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", populate_by_name=True)


class _Amounts(_Part):
    """Fields marked as amounts are in one unit, which ends their names in the file, as `before_mmHg`."""

    unit: str = "1"

    @classmethod
    def _amounts(cls) -> list[str]:
        return [name for name, one in cls.model_fields.items() if AMOUNT in one.metadata]

    @model_validator(mode="before")
    @classmethod
    def _without_unit(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            return given
        found: dict[str, Any] = {}
        suffixes, amounts = set[str](), cls._amounts()
        for key, value in given.items():
            names = [a for a in amounts if key.startswith(a + "_")]
            if key in amounts or not names:
                found[key] = value
                continue
            name = max(names, key=len)
            if name in found:
                raise ValueError(f"{name} is given twice, as {name} and {key}")
            found[name] = value
            suffixes.add(key[len(name) :])
        if len(suffixes) > 1:
            raise ValueError(f"amounts in {' and '.join(sorted(s[1:] for s in suffixes))}: give one unit")
        if suffixes and "unit" not in given:
            found["unit"] = suffixes.pop()[1:].replace("_", "/")
        return found

    @model_serializer(mode="wrap")
    def _with_unit(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        suffix, amounts = unit_suffix(self.unit), self._amounts()
        return {k + suffix if k in amounts else k: v for k, v in handler(self).items()}


class Interval(_Part):
    """An estimate with its 95 % interval."""

    mean: float
    low: float
    high: float


class SeriesGap(_Part):
    """The model discrepancy in one observed series."""

    series: str
    unit: str
    before: Interval
    after: Interval
    noise_floor: float
    residual_rms_before: float
    residual_rms_after: float


class Gap(_Amounts):
    """Size of the model discrepancy over the series that the diagnosis is about, in their unit."""

    before: Annotated[float, AMOUNT]
    before_interval: Annotated[tuple[float, float], AMOUNT]
    noise_floor: Annotated[float, AMOUNT]
    after: Annotated[float, AMOUNT]
    after_interval: Annotated[tuple[float, float], AMOUNT]
    residual_rms_before: Annotated[float, AMOUNT]
    residual_rms_after: Annotated[float, AMOUNT]
    removed: float
    removed_interval: tuple[float, float]
    held_out_before: Annotated[float | None, AMOUNT]
    held_out_after: Annotated[float | None, AMOUNT]
    held_out_removed: float | None
    held_out: str
    per_series: list[SeriesGap]


class LocationShare(_Part):
    """Probability of a location; a part of null stands for everywhere alike.

    In the file the part is called what the simulator calls it, such as `vessel`.
    """

    part: int | str | None
    subtree: bool
    probability: Probability
    noun: str = Field(default="", exclude=True)

    @model_validator(mode="before")
    @classmethod
    def _any_noun(cls, given: Any) -> Any:
        if not isinstance(given, dict) or "part" in given:
            return given
        nouns = [key for key in given if key not in ("subtree", "probability", "noun")]
        if len(nouns) != 1:
            return given
        rest = {key: value for key, value in given.items() if key != nouns[0]}
        return {**rest, "part": given[nouns[0]], "noun": nouns[0]}

    @model_serializer(mode="wrap")
    def _with_noun(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {(self.noun or k) if k == "part" else k: v for k, v in handler(self).items()}


class Where(_Part):
    """Shares of the model discrepancy's energy, and the location."""

    series: dict[str, float]
    phase: dict[str, float]
    harmonic: dict[str, float]
    place: list[LocationShare]


class Estimate(_Part):
    """A parameter: mean, standard deviation and 95 % interval of one distribution."""

    name: str
    mean: float
    sd: float
    interval: tuple[float, float] | None = None
    unit: str


class SetResult(_Amounts):
    """A set of causes: prior, evidence and their product, normalised over the table.

    `gap_after` is by simulation at the set's mode, and missing where it was not solved; `negligible` is the
    part of the empty set's probability in which what is left is below the numerics' error or a tenth of the
    noise.
    """

    causes: list[str]
    names: list[str]
    components: list[str]
    log_prior: float
    log_evidence: float
    log_evidence_error: float
    probability: Probability
    solved: bool
    gap_after: Annotated[float | None, AMOUNT] = None
    negligible: float | None = None


class CauseResult(_Part):
    """An effect or free function: the probability that it is there, and beforehand; its size where it is.

    `places` are where it is, given that it is there.
    """

    name: str
    component: str
    free: bool
    probability: Probability
    prior_probability: Probability
    places: list[LocationShare] = []
    estimates: list[Estimate] = []


class Law(_Part):
    """A simple law in the place of a learned function, with its probability among those tried.

    `left` is what it leaves of what the function does, in parts of its rms. Its shape has a name, such as
    "exponent", a value and a 95 % interval; a sign has none.
    """

    name: str
    shape: str = ""
    value: float | None = None
    interval: tuple[float, float] | None = None
    left: float
    probability: Probability


class LearnedFunction(_Part):
    """A function that a component lacks, as learned: values of its argument, mean and 95 % band there."""

    name: str
    argument: str
    argument_unit: str
    unit: str
    values: list[float]
    labels: list[str] = []
    mean: list[float]
    low: list[float]
    high: list[float]
    prior_sd: list[float]
    location: int | str | None = None
    equation: str = ""
    prior_size: float
    length: float | None = None
    probability: Probability
    laws: list[Law] = []

    @property
    def law(self) -> str:
        """The most probable simple law, such as "power of the speed, exponent 2 (1.9 to 2.1)", in words."""
        if not self.laws:
            return ""
        best, text = self.laws[0], f"{self.laws[0].name} of the {self.argument.removeprefix('log ')}"
        if best.value is None or best.interval is None:
            return text
        unit = "" if best.shape == "exponent" else unit_words(self.argument_unit)
        return f"{text}, {best.shape} {span(best.value, best.interval)}{unit}"

    @property
    def largest(self) -> tuple[str, str]:
        """Where it is largest, and its value there with the 95 % interval, in words.

        A logarithm is told as the factor that it stands for: "length × 0.61 (0.42 to 0.85)".
        """
        i = max(range(len(self.mean)), key=lambda k: abs(self.mean[k]))
        value, low, high = self.mean[i], self.low[i], self.high[i]
        if self.unit.startswith("log "):
            mean, *ends = map(math.exp, (value, low, high))
            told = f"{self.unit.removeprefix('log ')} × {span(mean, ends)}"
        else:
            told = f"{span(value, (low, high))}{unit_words(self.unit)}"
        if self.labels:
            return self.labels[i], told
        at = math.exp(self.values[i]) if self.argument_unit.startswith("log ") else self.values[i]
        return f"{at:.3g}{unit_words(self.argument_unit.removeprefix('log '))}", told


class ComponentResult(_Part):
    """One component of the simulator: the probability that it is wrong, and beforehand; what was learned.

    `share` is its part of the gap's energy, 0 in sets without it; `confounded` are components that can stand
    in for it, and `group_probability` that of any of them.
    """

    name: str
    probability: Probability
    prior_probability: Probability
    share: Interval
    confounded: list[str] = []
    group_probability: Probability
    functions: list[LearnedFunction] = []


class SensitivityRow(_Part):
    """Probabilities under another prior: of no cause, and that each component is wrong."""

    prior: str
    nothing: Probability
    components: dict[str, Probability]

    @property
    def wrong(self) -> frozenset[str]:
        """Components that are more probably wrong than not."""
        return frozenset(name for name, x in self.components.items() if x > 0.5)


class CarriedResult(_Amounts):
    """A function or listed effect, fixed as learned in the study, in another state of it.

    `error` is the rms of what it leaves there, the noise's part taken off; `better` the part of draws in
    which that is less than what both the baseline and the sensor's discrepancy leave; `beyond` the part of
    the argument's range there that the study does not visit.
    """

    names: list[str]
    functions: list[str]
    error: Annotated[Interval, AMOUNT]
    better: float
    holds: bool
    beyond: float | None = None


class StateFile(_Amounts):
    """Another state of the same study: what is left there, the baseline's parameters fitted again."""

    state: str
    checksum: str
    noise: Annotated[float, AMOUNT]
    baseline: Annotated[Interval, AMOUNT]
    sensor: Annotated[Interval | None, AMOUNT]
    carried: list[CarriedResult]
    failed: list[str] = []


class NextMeasurement(BaseModel):
    """The measurement that would best tell the leading explanations apart; further fields say what it is."""

    model_config = ConfigDict(extra="allow")

    separates: tuple[str, str]
    expected_log_odds: float
    text: str = ""

    if TYPE_CHECKING:  # the further fields

        def __getattr__(self, name: str) -> Any: ...


class LiftedBound(_Part):
    """A bound of the baseline's prior that was lifted, and what fits best beyond it."""

    parameter: str
    unit: str
    side: Literal["lower", "upper"]
    bound: float
    best: float


class ExcludedFit(_Amounts):
    """What the baseline's prior excludes: the explanations were weighed with these bounds lifted."""

    bounds: list[LiftedBound]
    residual_rms_within: Annotated[float, AMOUNT]
    residual_rms_free: Annotated[float, AMOUNT]


class DiagnosisFile(_Part):
    """Content of diagnosis.json; documented in docs/diagnosis.md.

    Every probability of causes and components is a sum over `sets`.
    """

    format: Literal[4] = 4
    study: str
    study_checksum: str
    base: str
    verdict: str
    answer: list[str] = []
    decided: bool
    cause: list[str]
    warnings: list[str] = []
    excluded: ExcludedFit | None = None
    gap: Gap
    where: Where
    no_gap: Probability
    number: list[Probability]
    sets: list[SetResult]
    missed: Probability
    linear_error: float
    components: list[ComponentResult]
    causes: list[CauseResult]
    sensitivity: list[SensitivityRow]
    states: list[StateFile] = []
    failed: list[str] = []
    next_measurement: NextMeasurement | None = None
    base_parameters: dict[str, dict[str, Estimate]]
    labels: dict[str, tuple[str, str]] = {}
    posteriors: dict[str, Any] | None = None
    record: dict[str, Any]

    @field_serializer("sets", mode="wrap")
    def _as_table(self, sets: list[SetResult], handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Thousands of sets, each name once."""
        rows = handler(sets)
        of = [list(zip(*(row[name] for name in OF_CAUSES), strict=True)) for row in rows]
        number = {cause: i for i, cause in enumerate(dict.fromkeys(cause for one in of for cause in one))}
        columns = [name for name in rows[0] if name not in (*OF_CAUSES, "unit")]
        table = [
            [[number[cause] for cause in one], *(row[name] for name in columns)]
            for one, row in zip(of, rows, strict=True)
        ]
        return {"unit": rows[0]["unit"], "of": [*map(list, number)], "columns": columns, "rows": table}

    @field_validator("sets", mode="before")
    @classmethod
    def _from_table(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            return given
        try:
            return [
                {name: [given["of"][i][k] for i in which] for k, name in enumerate(OF_CAUSES)}
                | {"unit": given["unit"]}
                | dict(zip(given["columns"], values, strict=True))
                for which, *values in given["rows"]
            ]
        except (KeyError, IndexError, TypeError) as error:
            raise ValueError(f"is no table of sets ({type(error).__name__}: {error})") from None

    @property
    def leading(self) -> SetResult:
        """The most probable set that was solved."""
        return next(row for row in self.sets if row.causes == self.cause)

    @property
    def lines(self) -> list[str]:
        """The answer and its warnings, a line each: what command, page and `print` show."""
        return [f"{text}." for text in [*self.answer, *(f"Warning: {text}" for text in self.warnings)]]

    def __str__(self) -> str:
        head = f"{self.study}, baseline {self.base}"
        lines = [head, *self.lines]
        if len(lines) > LINES:
            lines = [*lines[: LINES - 1], f"and {len(lines) - LINES + 1} more lines in `lines`"]
        return "\n".join(lines)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        first, *rest = (escape(line) for line in self.lines)
        return f"<p><b>{first}</b></p><ul>{''.join(f'<li>{line}</li>' for line in rest)}</ul>"

    @model_validator(mode="before")
    @classmethod
    def _older(cls, given: Any) -> Any:
        if isinstance(given, dict) and given.get("format", FORMAT) != FORMAT:
            raise ValueError(f"format {given['format']} is of an older program; this one reads {FORMAT}")
        return given


def read_diagnosis(path: str | Path) -> DiagnosisFile:
    """Read a diagnosis.json back.

    Parameters
    ----------
    path : path
        The file, or the folder that holds it.

    Returns
    -------
    DiagnosisFile

    Raises
    ------
    DiagnosisError
        If it is missing, not JSON, does not fit its digest, or a field is wrong.
    """
    path = Path(path)
    path = path / "diagnosis.json" if path.is_dir() else path
    again = "make it again with `zoo diagnose` or `zoo blind run`"
    try:
        return DiagnosisFile.model_validate(digests.from_text(path.read_bytes()))
    except OSError as error:
        raise DiagnosisError(
            f"{path}: cannot be read ({error.strerror}); give a file of `zoo diagnose`"
        ) from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(x) for x in first["loc"]) or "the file"
        raise DiagnosisError(f"{path}: {where}: {first['msg']}; {again}") from None
    except ValueError as error:
        raise DiagnosisError(f"{path}: cannot be read ({error}); {again}") from None
