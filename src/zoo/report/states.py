"""Other states of a study on the page of its diagnosis: rows of a table, and sentences."""

from __future__ import annotations

from zoo.core.diagnosis import DiagnosisFile
from zoo.core.diagnosis.file import CarriedResult, Interval, StateFile
from zoo.plots.subject import unit_words
from zoo.report.words import listed, percent, span

BEYOND = 0.1
"""Part of a range that was not visited from which on that is told."""


def state_sentences(file: DiagnosisFile) -> list[str]:
    """For each other state what is left there, and whose functions hold."""
    return [_sentence(state, file.cause) for state in file.states]


def _sentence(state: StateFile, cause: list[str]) -> str:
    unit = unit_words(state.unit)
    lines = [
        f"In {state.state}, its parameters fitted again, the baseline misses by {state.baseline.mean:.2g}"
    ]
    if state.sensor is not None:
        lines.append(f"with the discrepancy that was seen at the sensor by {state.sensor.mean:.2g}")
    leader = next((c for c in state.carried if set(c.names) & set(cause)), None)
    if leader is not None:
        lines.append(f"with what was learned of {listed(leader.names)} by {leader.error.mean:.2g}")
    holding = [listed(c.names) for c in state.carried if c.holds]
    told = f"what holds there: {', '.join(holding)}" if holding else "nothing that was learned holds there"
    text = f"{', '.join(lines)}{unit}; {told}"
    if leader is not None and leader.beyond is not None and leader.beyond > BEYOND:
        text += f" ({percent(leader.beyond)} of the range there was not visited before)"
    return f"{text}."


def state_rows(file: DiagnosisFile) -> list[list[str]]:
    """Rows of the table: state, explanation, what was fixed, error, and whether it holds."""
    rows = []
    for state in file.states:
        rows.append([state.state, "baseline", "", _error(state.baseline), ""])
        if state.sensor is not None:
            rows.append([state.state, "sensor's discrepancy", "", _error(state.sensor), ""])
        rows += [_row(state.state, c) for c in state.carried]
        rows += [[state.state, name, "", "cannot be solved", "no"] for name in state.failed]
    return rows


def _error(x: Interval) -> str:
    return span(x.mean, (x.low, x.high))


def _row(state: str, c: CarriedResult) -> list[str]:
    names = listed(one.replace("-", " ") for one in c.functions)
    return [state, listed(c.names), names, _error(c.error), "yes" if c.holds else "no"]
