"""The table [priors] of a study, and the option --prior, read into priors; what each mistake is."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from zoo.core.priors import InverseGamma, LogNormal, LogUniform, Normal, ParameterError, Prior, Uniform
from zoo.core.words import OneLineError, choices, meant, nearest, short

PAPER_SET = "paun2020"
"""Table 2 of Paun et al. 2020, as it stands in the files of the models."""
STUDY_SET = "study"
"""Priors that follow from the study, `zoo.blood.study_priors`."""
SETS = (PAPER_SET, STUDY_SET)

FIELDS = ("set", "wave_speed_m_s")
"""Fields of a table that are no parameters."""

WAVE_SPEED_M_S = (0.7, 20.0)
"""Pulse wave speeds at rest that hold 95 % of the prior of the stiffness, if a study gives no others."""
_SPEEDS = (0.01, 1000.0)

STIFFNESS = "stiffness"
"""What a model's overall stiffness is also called: f3, or m_chi."""

OVERALL = ("f3", "m_chi")
"""What it is called in the models that have one."""
MOST_HELD = 1e30
"""Largest size of a value that a parameter is held at."""

LAWS: Mapping[str, tuple[type[Prior], tuple[str, ...], tuple[int, ...]]] = {
    "uniform": (Uniform, ("low", "high"), (2,)),
    "log_uniform": (LogUniform, ("low", "high"), (2,)),
    "normal": (Normal, ("mean", "sd", "low", "high"), (2, 4)),
    "log_normal": (LogNormal, ("median", "sd of the logarithm", "low", "high"), (2, 4)),
    "inverse_gamma": (InverseGamma, ("shape", "scale"), (2,)),
}
"""Law -> its class, the names of its numbers, and how many of them there may be."""


class PriorsError(OneLineError, ValueError):
    """Priors that cannot be used; its text names the field, the value and what to change."""


@dataclass(frozen=True)
class PriorTable:
    """A table of priors, read.

    Parameters
    ----------
    set : {"paun2020", "study"}
    wave_speed_m_s : (low, high)
        Wave speeds at rest, m/s, that hold 95 % of the prior of the stiffness in the set "study".
    own : mapping of str to Prior
        Of single parameters.
    """

    set: str = STUDY_SET
    wave_speed_m_s: tuple[float, float] = WAVE_SPEED_M_S
    own: Mapping[str, Prior] = field(default_factory=dict)


def read_priors(table: Mapping[str, Any]) -> PriorTable:
    """A table of priors as study.toml has it.

    Parameters
    ----------
    table : mapping
        "set", "wave_speed_m_s", and parameters, each with one law: {"log_uniform": [2e4, 4e5]}.

    Returns
    -------
    PriorTable

    Raises
    ------
    PriorsError
        In one line for the first mistake: field, value, remedy.

    Examples
    --------
    >>> read_priors({"f3": {"log_uniform": [2e4, 4e5]}}).own
    {'f3': LogUniform(low=20000.0, high=400000.0)}
    """
    chosen = table.get("set", STUDY_SET)
    if chosen not in SETS:
        raise PriorsError(f"set = {short(chosen)}: {nearest(chosen, SETS)}")
    speeds = WAVE_SPEED_M_S
    if "wave_speed_m_s" in table:
        if chosen == PAPER_SET:
            raise PriorsError(
                f"wave_speed_m_s: the set {PAPER_SET!r} has a stiffness of its own; leave out one of them"
            )
        speeds = _wave_speeds(table["wave_speed_m_s"])
    own = {name: _prior(name, value) for name, value in table.items() if name not in FIELDS}
    _refuse_twice(own)
    return PriorTable(str(chosen), speeds, own)


def names_of(name: str) -> tuple[str, ...]:
    """A parameter's name, and those under which some model has the same parameter."""
    if name == STIFFNESS:
        return (name, *OVERALL)
    return (name, STIFFNESS) if name in OVERALL else (name,)


def _refuse_twice(names: Iterable[str]) -> None:
    """Raise where one parameter is given under two names."""
    given = list(names)
    for name in OVERALL:
        if STIFFNESS in given and name in given:
            raise PriorsError(
                f"{name} and {STIFFNESS}: are one parameter under two names; keep one of them, also where a "
                "study gives the one and an option the other"
            )


def check_held(held: Mapping[str, Any], priors: Mapping[str, Any]) -> None:
    """Refuse values of parameters that are no numbers, are given twice, or have a prior beside them.

    Raises
    ------
    PriorsError
    """
    _refuse_twice(held)
    for name, value in held.items():
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (number and abs(value) <= MOST_HELD):
            raise PriorsError(f"{name} = {short(value)}: must be a number to be held at; correct it")
        for other in names_of(name):
            if other in priors:
                both = name if other == name else f"{name} and {other}"
                raise PriorsError(f"{both}: has a prior and a value that it is held at; keep one of them")


def read_held(text: str) -> tuple[str, float]:
    """What `--fix` is given, as name and value.

    Raises
    ------
    PriorsError
        If it cannot be read.

    Examples
    --------
    >>> read_held("psi1=1.0")
    ('psi1', 1.0)
    """
    name, sign, value = (part.strip() for part in text.partition("="))
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not (name and sign and math.isfinite(number)):
        raise PriorsError(f"{text!r}: write NAME=NUMBER, such as psi1=1.0")
    return name, number


def _numbers(value: Any) -> list[float] | None:
    """The numbers of a list, if it is one of numbers; infinite bounds are allowed."""
    if not isinstance(value, list | tuple):
        return None
    try:
        good = all(
            isinstance(x, int | float) and not isinstance(x, bool) and not math.isnan(x) for x in value
        )
        return [float(x) for x in value] if good else None
    except OverflowError:  # a whole number beyond a double
        return None


def _wave_speeds(value: Any) -> tuple[float, float]:
    speeds = _numbers(value)
    if speeds is None or len(speeds) != 2:
        raise PriorsError(f"wave_speed_m_s = {short(value)}: must be two numbers in m/s, such as [0.7, 20.0]")
    low, high = speeds
    if not _SPEEDS[0] <= low < high <= _SPEEDS[1]:
        raise PriorsError(
            f"wave_speed_m_s = {short(value)}: must ascend and lie between {_SPEEDS[0]:g} and {_SPEEDS[1]:g} "
            "m/s; pulse waves travel at some 1 to 20 m/s, correct the numbers or their unit"
        )
    return low, high


def _prior(name: str, value: Any) -> Prior:
    """The prior of one parameter, from its law."""
    if name == "chi":
        raise PriorsError("chi: is a population of stiffnesses; give m_chi or v_chi instead")
    if not isinstance(value, Mapping) or len(value) != 1:
        hint = meant(name, FIELDS, 0.4, "the field ")
        raise PriorsError(
            f"{name} = {short(value)}: {hint}a parameter has one law, such as {{ log_uniform = [2e4, 4e5] }}"
        )
    ((law, given),) = value.items()
    if law not in LAWS:
        raise PriorsError(f"{name}: {short(law)}: unknown law; {choices(law, list(LAWS))}")
    made, words, counts = LAWS[law]
    numbers = _numbers(given)
    if numbers is None or len(numbers) not in counts:
        shown = " or ".join("[" + ", ".join(words[:n]) + "]" for n in counts)
        raise PriorsError(f"{name}: {law} = {short(given)}: must be {shown}, of numbers")
    try:
        return made(*numbers)
    except ParameterError as error:
        raise PriorsError(f"{name}: {law} = {short(given)}: {error}") from None


def table_of(prior: Prior) -> dict[str, list[float]]:
    """A prior as a table has it: {"log_uniform": [2e4, 4e5]}.

    Raises
    ------
    PriorsError
        If a table cannot have its law.
    """
    for law, (made, _, counts) in LAWS.items():
        if type(prior) is made:
            numbers = [float(x) for x in vars(prior).values()]
            whole = made(*numbers[: counts[0]])
            return {law: numbers[: counts[0]] if whole == prior else numbers}
    raise PriorsError(
        f"{prior!r}: not a law of a table; use one of {', '.join(LAWS)}, or write a model of your own"
    )


def read_option(text: str) -> tuple[str, Any]:
    """What `--prior` is given, as field and value of the table.

    Parameters
    ----------
    text : str
        Such as "f3=log_uniform(2e4, 4e5)", "wave_speed_m_s=1,4" or "set=paun2020".

    Raises
    ------
    PriorsError
        If it cannot be read.

    Examples
    --------
    >>> read_option("f3=log_uniform(2e4,4e5)")
    ('f3', {'log_uniform': [20000.0, 400000.0]})
    """
    name, sign, value = (part.strip() for part in text.partition("="))
    if not sign or not name or not value:
        raise PriorsError(
            f"{text!r}: write NAME=LAW(NUMBERS), such as f3=log_uniform(2e4,4e5), wave_speed_m_s=1,4 or "
            "set=paun2020"
        )
    if name == "set":
        return name, value.strip("'\"")
    called = re.fullmatch(r"(\w+)\s*\((.*)\)", value)
    if called is None and name != "wave_speed_m_s":
        hint = meant(name, FIELDS, 0.6, "the field ")
        raise PriorsError(f"{text!r}: {hint}a parameter has one law, such as {name}=log_uniform(2e4,4e5)")
    listed = (called[2] if called else value).strip("[]() ")
    try:
        numbers = [float(part) for part in listed.split(",")]
    except ValueError:
        raise PriorsError(f"{text!r}: {listed!r} is not numbers with commas between them") from None
    return name, {called[1]: numbers} if called else numbers
