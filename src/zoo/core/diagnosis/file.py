"""diagnosis.json: what a diagnosis writes and reads back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import (
    AliasChoices,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)

from zoo.core import digests
from zoo.core.words import OneLineError

FORMAT = 2


class DiagnosisError(OneLineError, ValueError):
    """A diagnosis that cannot be made or read; its text says why and what to change."""


def unit_suffix(unit: str) -> str:
    """A unit as the end of a field's name: "_mmHg", "_ml_s"; nothing for a pure number."""
    return "" if unit == "1" else "_" + unit.replace("/", "_").replace(" ", "_")


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", populate_by_name=True)


class _Amounts(_Part):
    """Some of the fields are amounts in one unit, which ends their names in the file, as `before_mmHg`."""

    amounts: ClassVar[tuple[str, ...]] = ()
    unit: str = "1"

    @model_validator(mode="before")
    @classmethod
    def _without_unit(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            return given
        found: dict[str, Any] = {}
        suffixes: set[str] = set()
        for key, value in given.items():
            names = [a for a in cls.amounts if key.startswith(a + "_")]
            if key in cls.amounts or not names:
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
        suffix = unit_suffix(self.unit)
        return {k + suffix if k in self.amounts else k: v for k, v in handler(self).items()}


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

    amounts = (
        "before",
        "before_interval",
        "noise_floor",
        "after",
        "after_interval",
        "residual_rms_before",
        "residual_rms_after",
        "held_out_before",
        "held_out_after",
    )
    before: float
    before_interval: tuple[float, float]
    noise_floor: float
    after: float
    after_interval: tuple[float, float]
    residual_rms_before: float
    residual_rms_after: float
    removed: float
    removed_interval: tuple[float, float]
    held_out_before: float | None
    held_out_after: float | None
    held_out_removed: float | None
    held_out: str
    per_series: list[SeriesGap]


class LocationShare(_Part):
    """Probability of a location; a part of null stands for everywhere alike.

    In the file the part is called what the simulator calls it, such as `vessel`.
    """

    part: int | str | None
    subtree: bool
    probability: float
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
    """A parameter of an effect: mean, standard deviation and 95 % interval of one distribution."""

    name: str
    mean: float
    sd: float
    interval: tuple[float, float] | None = None
    unit: str


class HypothesisResult(_Amounts):
    """One explanation of the data."""

    amounts = ("gap_after", "gap_after_interval", "residual_rms")
    name: str
    place: int | str | None
    subtree: bool = False
    probability: float
    prior_probability: float | None = None
    prior_made: bool = False
    and_more: float | None = None
    group: int
    log_evidence: float
    log10_bayes_factor: float | None = None
    log10_bayes_factor_to_best: float | None = None
    amplitude: Estimate | None
    other_amplitudes: list[Estimate] = []
    gap_after: float
    gap_after_interval: tuple[float, float]
    searched_twice: bool = True
    residual_rms: float
    shift_of_base: dict[str, float] = {}
    places: list[LocationShare] = []


class LearnedFunction(_Part):
    """A function that a component lacks, as learned: values of its argument, mean and 95 % band there.

    `narrowed` are directions in which the data halve the prior's standard deviation: for each the values of
    the function along it, of norm 1. `bent` is by how much, in parts, the response to one prior sd of its
    strongest direction differs from that to the opposite. `beside` are the baseline's parameters with it: a
    function that they can partly stand in for is one only together with them.
    """

    name: str
    argument: str
    argument_unit: str
    unit: str
    values: list[float]
    labels: list[str] = []
    mean: list[float]
    low: list[float]
    high: list[float]
    prior_sd: list[float] = []
    location: int | str | None = None
    equation: str = ""
    size: float | None = None
    prior_size: float | None = None
    length: float | None = None
    probability: float | None = None
    narrowed: list[list[float]] = []
    bent: float | None = None
    beside: dict[str, float] = {}


class NearestEffect(_Part):
    """A listed effect and the part of a learned signal's energy that its own explains."""

    name: str
    share: float
    opposite_sign: bool = False


class Plausible(_Part):
    """Whether what was learned is of a size that the component's error can have."""

    value: bool
    why: str = ""


class HeldOutComponentResult(_Amounts):
    """Rms of residuals in data that were held out: baseline, free discrepancy at the sensor, component."""

    amounts = ("baseline", "sensor", "component")
    baseline: Interval
    sensor: Interval
    component: Interval
    found: bool
    what: str = ""


class ComponentResult(_Amounts):
    """One component of the simulator: how probable an error in it is, and what was learned of it."""

    amounts = ("gap_after", "gap_after_interval")
    name: str
    probability: float
    own_probability: float | None = None
    log_evidence: float | None
    log10_bayes_factor: float | None = None
    group: int
    share: Interval | None = None
    one_of_several: bool = False
    together: dict[str, float] = {}
    gap_after: float | None = None
    gap_after_interval: tuple[float, float] | None = None
    plausible: Plausible | None = None
    functions: list[LearnedFunction] = []
    nearest_effects: list[NearestEffect] = []
    angles: dict[str, tuple[float, float]] = {}
    refined: bool = False
    held_out: HeldOutComponentResult | None = None


class CarriedResult(_Amounts):
    """A function or listed effect, fixed as learned in the study, in another state of it.

    `error` is the rms of what it leaves there, the noise's part taken off; `better` the part of draws in
    which that is less than what both the baseline and the sensor's discrepancy leave; `beyond` the part of
    the argument's range there that the study does not visit.
    """

    amounts = ("error",)
    names: list[str]
    functions: list[str]
    error: Interval
    better: float
    holds: bool
    beyond: float | None = None


class StateFile(_Amounts):
    """Another state of the same study: what is left there, the baseline's parameters fitted again."""

    amounts = ("noise", "baseline", "sensor")
    state: str
    checksum: str
    noise: float
    baseline: Interval
    sensor: Interval | None
    carried: list[CarriedResult]
    failed: list[str] = []


class SeveralResult(_Part):
    """The best set of several listed effects: log odds and log Bayes factor over the best one alone."""

    names: list[str]
    log_odds: float
    log_bayes_factor: float
    weighed: int


class NextMeasurement(BaseModel):
    """The measurement that would best tell the leading explanations apart; further fields say what it is."""

    model_config = ConfigDict(extra="allow")

    separates: tuple[str, str]
    expected_log_odds: float

    if TYPE_CHECKING:  # the further fields

        def __getattr__(self, name: str) -> Any: ...


class AddedStep(_Amounts):
    """An effect that was added, and what it left."""

    amounts = ("gap_before", "gap_after")
    name: str
    place: int | str | None
    subtree: bool
    probability: float
    amplitudes: list[Estimate] = []
    gap_before: float
    gap_after: float


class LiftedBound(_Part):
    """A bound of the baseline's prior that was lifted, and what fits best beyond it."""

    parameter: str
    unit: str
    side: Literal["lower", "upper"]
    bound: float
    best: float


class ExcludedFit(_Amounts):
    """What the baseline's prior excludes: the explanations were weighed with these bounds lifted."""

    amounts = ("residual_rms_within", "residual_rms_free")
    bounds: list[LiftedBound]
    residual_rms_within: float
    residual_rms_free: float


class DiagnosisFile(_Part):
    """Content of diagnosis.json; documented in docs/diagnosis.md."""

    format: Literal[1, 2] = 2
    study: str
    study_checksum: str
    base: str
    gap: Gap
    where: Where
    cause: list[str]
    verdict: str
    warnings: list[str] = []
    excluded: ExcludedFit | None = None
    hypotheses: list[HypothesisResult]
    components: list[ComponentResult] = []
    several: SeveralResult | None = None
    states: list[StateFile] = []
    steps: list[AddedStep]
    invisible: list[str]
    failed: list[str]
    next_measurement: NextMeasurement | None
    base_parameters: dict[str, dict[str, float]]
    posteriors: dict[str, Any] | None = Field(
        default=None, validation_alias=AliasChoices("posteriors", "confirmation")
    )
    record: dict[str, Any]

    @model_validator(mode="before")
    @classmethod
    def _older(cls, given: Any) -> Any:
        """In the first format the names said mmHg whatever the unit was; the record has it."""
        if isinstance(given, dict) and given.get("format", 1) == 1 and isinstance(given.get("record"), dict):
            unit = given["record"].get("gap_unit")
            lists = [given.get(name) or [] for name in ("hypotheses", "steps")]
            if unit and all(isinstance(found, list) for found in lists):
                parts = [given.get("gap"), *lists[0], *lists[1]]
                renewed = [p | {"unit": unit} if isinstance(p, dict) else p for p in parts]
                n = len(lists[0])
                given = given | {
                    "gap": renewed[0],
                    "hypotheses": renewed[1 : n + 1],
                    "steps": renewed[n + 1 :],
                }
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
