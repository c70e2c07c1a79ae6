"""Components of the simulator on the page of a diagnosis and on the screen: rows of tables."""

from __future__ import annotations

from typing import Any

from zoo.core.diagnosis import DiagnosisFile
from zoo.core.diagnosis.file import ComponentResult, LearnedFunction
from zoo.plots.subject import unit_words
from zoo.report.words import percent, span

TOLD = 0.005
"""Least share of a nearest effect that is told."""


def component_rows(file: DiagnosisFile) -> list[dict[str, Any]]:
    """A row for each component, most probable first."""
    return [_row(c) for c in sorted(file.components, key=lambda c: -c.probability)]


def _row(c: ComponentResult) -> dict[str, Any]:
    held = c.held_out
    share = "" if c.share is None else _share(c.share.mean, c.share.low, c.share.high)
    after = "" if c.gap_after is None else span(c.gap_after, c.gap_after_interval or (c.gap_after,) * 2)
    bayes = "" if c.log10_bayes_factor is None else f"{c.log10_bayes_factor:+.1f}"
    confirmed = "" if held is None else "yes" if held.found else "no"
    return {
        "name": c.name,
        "cells": [percent(c.probability), str(c.group), bayes, share, after, confirmed],
        "nearest": _nearest(c),
        "plausible": c.plausible.why if c.plausible else "",
    }


def _share(mean: float, low: float, high: float) -> str:
    return f"{percent(mean)} ({percent(low)} to {percent(high)})"


def _nearest(c: ComponentResult) -> str:
    return ", ".join(
        f"{one.name} {percent(one.share)}{' with the other sign' if one.opposite_sign else ''}"
        for one in c.nearest_effects
        if one.share >= TOLD
    )


def function_rows(file: DiagnosisFile) -> list[list[str]]:
    """A row for each learned function: component, function, where it is largest there, and its prior size."""
    rows = []
    for c in sorted(file.components, key=lambda c: -c.probability):
        rows += [[c.name, f.name.replace("-", " "), *_largest(f)] for f in c.functions if f.mean]
    return rows


def _largest(f: LearnedFunction) -> list[str]:
    i = max(range(len(f.mean)), key=lambda k: abs(f.mean[k]))
    at = f.labels[i] if f.labels else f"{f.values[i]:.3g}{unit_words(f.argument_unit)}"
    size = "" if f.prior_size is None else f"{f.prior_size:.2g}{unit_words(f.unit)}"
    return [at, f"{span(f.mean[i], (f.low[i], f.high[i]))}{unit_words(f.unit)}", size, str(len(f.narrowed))]
