"""The files of a case: as many digits and columns in every case."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

from zoo.blood.study import Study, StudyError, load_study
from zoo.core.blindcheck.sealing import BlindError

DIGITS = {"pressure_mmHg": 4, "flow_ml_s": 6}


def case_files(study: Study) -> dict[str, str]:
    """Files of a case by name: `save_study`'s format with as many digits and columns in every case.

    Raises
    ------
    BlindError
        If they would not be read back as this study.
    """
    files: dict[str, str] = {}

    def write(name: str, lines: Iterable[str]) -> None:
        files[name] = "\n".join(lines) + "\n"

    write(
        "study.toml",
        (
            f'name = "{study.name}"',
            'network = "network.toml"',
            'inflow = "inflow.csv"',
            'observations = "observations.csv"',
            f"period_s = {study.period_s:.4f}",
            'conventions = "printed"',
        ),
    )
    blood = study.blood
    lines = ["[blood]", f"density_g_cm3 = {blood.density_g_cm3:.3f}"]
    lines += [f"viscosity_g_cm_s = {blood.viscosity_g_cm_s:.3f}"]
    for v in study.vessels:
        lines += ["", "[[vessel]]", f"id = {v.id}", f'name = "{v.name}"']
        lines += [f"length_cm = {v.length_cm:.4f}", f"radius_cm = {v.radius_cm:.5f}"]
        lines += [] if v.parent is None else [f"parent = {v.parent}"]
        if v.windkessel is not None:
            load = ", ".join(f"{name} = {x:.8e}" for name, x in vars(v.windkessel).items())
            lines.append(f"windkessel = {{ {load} }}")
    write("network.toml", lines)
    pairs = zip(study.inflow_time_s, study.inflow_ml_s, strict=True)
    write("inflow.csv", ("time_s,flow_ml_s", *(f"{t:.8f},{q:.6f}" for t, q in pairs)))
    rows = [
        f"{s.vessel},{s.position:.1f},{s.quantity},{t:.8f},{x:10.{DIGITS[s.quantity]}f}"
        for s in study.series
        for t, x in zip(study.time_s, s.value, strict=True)
    ]
    write("observations.csv", ("vessel,position,quantity,time_s,value", *rows))
    with TemporaryDirectory() as folder:
        for name, text in files.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        try:
            same = load_study(folder).checksum == study.checksum
        except StudyError as error:
            raise BlindError(f"{study.name}: what was written cannot be read: {error}") from None
    if not same:
        raise BlindError(f"{study.name}: what was written reads back as another study")
    return files
