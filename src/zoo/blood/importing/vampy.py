"""Networks of VaMpy: a .cfg file and its inflow, in cgs, as a study: an artery, or one with two daughters."""

from __future__ import annotations

import configparser
import math
from pathlib import Path

import numpy as np

from zoo.blood.importing.imported import Imported, ImportedFileError, study_of
from zoo.blood.study import Blood, Vessel, Windkessel
from zoo.blood.study.reading import inside, read_text
from zoo.core.words import short

USED = {"ru", "rd", "lam", "rho", "nu", "k1", "k2", "k3", "r1", "r2", "ct", "depth"}


def import_vampy(path: str | Path) -> Imported:
    """A study from VaMpy's .cfg; ImportedFileError where a study cannot express it."""
    path = Path(path)
    file = configparser.ConfigParser(interpolation=None)
    try:
        file.read_string(read_text(path))
        files, arteries, simulation = file["Files"], file["Arteries"], file["Simulation"]
    except (configparser.Error, KeyError) as error:
        reason = short(str(error).split("\n")[0])
        raise ImportedFileError(f"{path}: {reason}: not read as a file of VaMpy; correct it") from None

    def numbers(section: configparser.SectionProxy, field: str, n: int = 1) -> list[float]:
        text = section.get(field, "")
        try:
            found = [float(one) for one in text.split(",")]
        except ValueError:
            found = []
        if len(found) != n or not all(abs(x) < 1e30 and (x > 0 or field == "k2") for x in found):
            raise ImportedFileError(
                f"{path}: {field} = {short(text)}: must be {n} positive numbers; correct it"
            )
        return found

    depth = numbers(arteries, "depth")[0]
    if depth not in (1, 2):
        raise ImportedFileError(
            f"{path}: depth = {depth:g}: trees of depth 1 and 2 are read; give one of these"
        )
    n = 1 if depth == 1 else 3
    (k1,), (k2,), (k3,) = (numbers(arteries, name) for name in ("k1", "k2", "k3"))
    (R1,), (R2,), (C,) = (numbers(arteries, name) for name in ("R1", "R2", "Ct"))
    sizes = zip(*(numbers(arteries, name, n) for name in ("Ru", "Rd", "lam")), strict=True)
    vessels = tuple(
        Vessel(
            i,
            f"v{i}",
            up * part,
            up,
            down,
            1 if i > 1 else None,
            Windkessel(R1, R2, C) if i > 1 or n == 1 else None,
            stiffness_g_cm_s2=k1 * math.exp(k2 * up) + k3,
            stiffness_out_g_cm_s2=k1 * math.exp(k2 * down) + k3,
        )
        for i, (up, down, part) in enumerate(sizes, 1)
    )
    name = f"{files.get('data_dir', '.')}/{files.get('inlet', '')}"
    if wrong := inside(path.parent, name):
        raise ImportedFileError(f"{path}: inlet = {short(name)}: {wrong}")
    try:
        rows = [line.split(",") for line in read_text(path.parent / name).split("\n") if line.strip()]
        curve = np.array(rows, dtype=np.float64).reshape(-1, 2)
    except ValueError:
        curve = np.empty((0, 2))
    (period,) = numbers(simulation, "T")
    curve = curve[curve[:, 0] < period * (1 - 1e-9)]
    if len(curve) < 2 or curve[0, 0] != 0 or not np.all(np.diff(curve[:, 0]) > 0):
        raise ImportedFileError(
            f"{path}: inlet {short(name)}: must be rows of time,flow from 0 on; correct it"
        )
    blood = Blood(numbers(arteries, "rho")[0], numbers(arteries, "nu")[0])
    study, distance = study_of(path, vessels, blood, curve, period)
    flow = study.inflow_ml_s
    converted = (
        "lengths are lam times the upstream radius; chi = k1 exp(k2 r) + k3 at both ends",
        "the wall (4/3) chi (1 - sqrt(A0/A)) became (4/3) chi (sqrt(A/A0) - 1), alike near rest",
        f"inflow: {len(curve)} samples became {len(flow)}, at most {distance:.2g} ml/s off",
    )
    left = [f"{one} of [Arteries]" for one in arteries if one not in USED]
    left.append("[Simulation] but T, and other files of [Files]")
    read = (f"{n} vessels; inflow: period {period:g} s, mean {flow.mean():.4g} ml/s",)
    return Imported(study, read, converted, tuple(left))
