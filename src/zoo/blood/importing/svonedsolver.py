"""Networks of svOneDSolver: an .in file, in cgs, as a study.

A segment has p = p0 + (4/3) (k1 exp(k2 r) + k3) (1 - sqrt(A0/A)) and a velocity profile of order n, with a
momentum correction of (n + 2)/(n + 1): Wan et al. 2002, doi 10.1080/10255840290010670.
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import numpy as np

from zoo.blood.conventions import PRINTED
from zoo.blood.importing.cards import LEFT_OUT, Deck
from zoo.blood.importing.imported import Imported, study_of
from zoo.blood.study import Blood, Vessel, Windkessel
from zoo.core.words import short


def import_svonedsolver(path: str | Path) -> Imported:
    """A study from an .in file of svOneDSolver; ImportedFileError where a study cannot express it."""
    deck = Deck(Path(path))
    materials = {words[0]: (row, words[1:]) for row, words in deck.of("MATERIAL", 9)}
    if len({tuple(words[1:5]) for _, words in materials.values()}) > 1:
        row, _ = list(materials.values())[-1]
        deck.fail(row, "materials differ in blood or pressure at rest: a study has one; give all the same")
    row, first = next(iter(materials.values()))
    density, viscosity, rest, order = (deck.number(row, text) for text in first[1:5])
    ends: dict[str, int] = {}
    segments = deck.of("SEGMENT", 15)
    for i, (row, words) in enumerate(segments):
        if words[5] in ends:
            deck.fail(row, f"node {words[5]}: another segment ends there too: a loop, and a study is a tree")
        ends[words[5]] = i
    vessels = tuple(_vessel(deck, row, words, i, ends, materials) for i, (row, words) in enumerate(segments))
    row, options = deck.of("SOLVEROPTIONS", 6)[0]
    if options[5] != "FLOW":
        deck.fail(row, f"inlet {options[5]}: the import reads a flow there; give FLOW")
    curve = np.array(deck.table(row, options[4])).reshape(-1, 2)
    wrong = len(curve) < 3 or curve[0, 0] != 0 or not np.all(np.diff(curve[:, 0]) > 0)
    if wrong or curve[-1, 1] != curve[0, 1]:
        deck.fail(row, f"DATATABLE {options[4]}: must begin at 0, rise in time, and end with its first value")
    period = float(curve[-1, 0])
    blood = Blood(
        density, viscosity, velocity_profile_order=order, momentum_correction=(order + 2) / (order + 1)
    )
    study, distance = study_of(Path(path), vessels, blood, curve[:-1], period, rest / PRINTED.mmhg)
    flow = study.inflow_ml_s
    kinds = Counter(words[14] for _, words in segments if words[14] != "NOBOUND")
    read = (
        f"{len(vessels)} vessels; outlets: {', '.join(f'{n} x {kind}' for kind, n in kinds.items())}",
        f"radii at {study.radius_pressure_mmHg:.4g} mmHg; velocity profile of order {order:g}",
        f"momentum correction {study.blood.momentum_correction:g}",
        f"inflow: period {period:g} s, mean {flow.mean():.4g} ml/s",
    )
    converted = (
        "areas to radii, linear along a segment; chi = k1 exp(k2 r) + k3 at both ends of each",
        "the wall p0 + (4/3) chi (1 - sqrt(A0/A)) became p0 + (4/3) chi (sqrt(A/A0) - 1), alike near rest",
        f"inflow: {len(curve) - 1} samples, linear between, became {len(flow)}: "
        + (f"at most {distance:.2g} ml/s off" if distance else "the same curve"),
    )
    left = [text for card, text in LEFT_OUT.items() if card in deck.cards]
    left += ["solver settings", "elements, initial flows, angles and losses of segments"]
    return Imported(study, read, converted, tuple(left))


def _vessel(
    deck: Deck,
    row: int,
    words: list[str],
    i: int,
    ends: dict[str, int],
    materials: dict[str, tuple[int, list[str]]],
) -> Vessel:
    """The i-th segment."""
    number = [deck.number(row, words[at]) for at in (2, 6, 7)]
    if min(number) <= 0:
        deck.fail(row, f"length and areas {number}: must be positive; correct them")
    length, *areas = number
    if words[9] not in materials or materials[words[9]][1][0] not in ("OLUFSEN",):
        deck.fail(row, f"material {short(words[9])}: there is no OLUFSEN material of that name; add one")
    where, material = materials[words[9]]
    k1, k2, k3 = (deck.number(where, text) for text in material[5:8])
    radii = [math.sqrt(area / math.pi) for area in areas]
    chi = [k1 * math.exp(k2 * r) + k3 for r in radii]
    parent, kind, load = ends.get(words[4]), words[14], None
    resistance, behind = None, []
    table = words[15] if len(words) > 15 else ""
    if kind == "RCR":
        R1, C, R2, *behind = (value for _, value in deck.table(row, table, 3, 4))
        load = Windkessel(R1, R2, C)
    elif kind == "RESISTANCE":
        resistance, *behind = (value for _, value in deck.table(row, table, 1, 2))
    elif kind != "NOBOUND":
        deck.fail(row, f"outlet {short(kind)}: a study has RCR and RESISTANCE; give one of them")
    return Vessel(
        i + 1,
        words[0],
        length,
        radii[0],
        radii[1],
        None if parent is None else parent + 1,
        load,
        resistance=resistance,
        stiffness_g_cm_s2=chi[0],
        stiffness_out_g_cm_s2=chi[1],
        outflow_pressure_mmHg=behind[0] / PRINTED.mmhg if behind else None,
    )
