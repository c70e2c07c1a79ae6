"""Units that a study seems to be in: a mistake is one warning with its remedy, right studies give none."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from zoo.blood.study import (
    Blood,
    Series,
    Study,
    StudyError,
    UnitWarning,
    Vessel,
    Windkessel,
    load_study,
    save_study,
    suspect_units,
)

ROOT = Path(__file__).resolve().parents[1]
MMHG = 1333.22
N = 100

# size at rest of animals' arteries: root's radius (cm), period (s), mean flow (ml/s), mean and pulse (mmHg)
ANIMALS = {
    "mouse": (0.06, 0.12, 0.25, 95.0, 30.0),
    "rat": (0.12, 0.17, 1.2, 100.0, 40.0),
    "human": (1.4, 0.85, 90.0, 93.0, 40.0),
    "human, pulmonary": (1.3, 0.85, 90.0, 15.0, 15.0),
    "human, brachial": (0.2, 1.0, 1.2, 95.0, 50.0),
    "horse": (2.4, 1.6, 400.0, 110.0, 50.0),
    "whale": (10.0, 5.0, 5000.0, 100.0, 40.0),
}


def tree(animal: str, *, loads: bool = True, observed: str = "pq") -> Study:
    """Seven vessels, each the parent of two, with a half sine for the inflow and a Windkessel's pressure."""
    radius, period, flow, mean, pulse = ANIMALS[animal]
    times = np.arange(N) * period / N
    inflow = np.maximum(0.0, np.sin(np.pi * times / (0.35 * period))) * (times < 0.35 * period)
    inflow *= flow / inflow.mean()
    pressure = np.convolve(np.tile(inflow, 3), np.exp(-np.arange(N) / 30))[2 * N : 3 * N]
    pressure = mean + pulse * (pressure - pressure.mean()) / np.ptp(pressure)
    resistance = 4 * mean * MMHG / flow
    load = Windkessel(0.1 * resistance, 0.9 * resistance, 1.5 * period / resistance) if loads else None
    vessels = []
    for i in range(1, 8):
        r = radius * 0.76 ** (i.bit_length() - 1)
        vessels.append(Vessel(i, f"v{i}", 4 * r, r, r, i // 2 or None, load if i > 3 else None))
    series = [Series(1, 0.0, "pressure_mmHg", pressure), Series(4, 0.5, "pressure_mmHg", pressure)]
    flows = [Series(1, 0.0, "flow_ml_s", inflow), Series(4, 0.5, "flow_ml_s", inflow / 4)]
    found = (series if "p" in observed else []) + (flows if "q" in observed else [])
    empty = np.empty(0)
    blood = Blood(1.06, 0.04)
    return Study(
        animal, period, blood, tuple(vessels), times, inflow, times if found else empty, tuple(found)
    )


def scaled(study: Study, quantity: str, factor: float) -> tuple[Series, ...]:
    return tuple(replace(s, value=s.value * factor) if s.quantity == quantity else s for s in study.series)


def pressures(study: Study, factor: float) -> Study:
    return replace(study, series=scaled(study, "pressure_mmHg", factor))


def flows(study: Study, factor: float) -> Study:
    return replace(study, series=scaled(study, "flow_ml_s", factor), inflow_ml_s=study.inflow_ml_s * factor)


def lengths(study: Study, factor: float) -> Study:
    names = "length_cm", "radius_cm", "radius_out_cm"
    sized = [{name: getattr(v, name) * factor for name in names} for v in study.vessels]
    return replace(study, vessels=tuple(replace(v, **s) for v, s in zip(study.vessels, sized, strict=True)))


def loads(study: Study, factor: float) -> Study:
    vessels = (
        replace(v, windkessel=Windkessel(w.R1 * factor, w.R2 * factor, w.C / factor))
        if (w := v.windkessel)
        else v
        for v in study.vessels
    )
    return replace(study, vessels=tuple(vessels))


# the numbers that would stand in the file: of 1 mmHg, 1 ml/s, 1 cm, 1 dyn s/cm5
MISTAKES: dict[str, tuple[Callable[[Study, float], Study], float, str]] = {
    "pressure in kPa": (pressures, 0.1333224, "kPa"),
    "pressure in Pa": (pressures, 133.3224, "Pa"),
    "flow in l/min": (flows, 0.06, "l/min"),
    "flow in m3/s": (flows, 1e-6, "m3/s"),
    "lengths in mm": (lengths, 10.0, "mm"),
    "lengths in m": (lengths, 0.01, "m"),
    "loads in SI": (loads, 1e5, "Pa s/m3 and m3/Pa"),
    "loads in mmHg": (loads, 1 / 1333.224, "mmHg s/ml and ml/mmHg"),
}


def one(study: Study, mistake: str) -> None:
    """One suspicion, which names the unit and whose factors undo the mistake."""
    change, factor, unit = MISTAKES[mistake]
    wrong = change(study, factor)
    found = suspect_units(wrong)
    assert [s.unit for s in found] == [unit], [str(s) for s in found]
    assert found[0].factors[0] == pytest.approx(1 / factor, rel=1e-4)
    assert suspect_units(change(wrong, found[0].factors[0])) == ()
    text = str(found[0])
    assert f"{unit} would fit" in text
    assert f"{found[0].factors[0]:.6g}" in text
    assert "\n" not in text


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize("animal", [*ANIMALS, "demo", pytest.param("mouse-c6", marks=pytest.mark.needs_data)])
def test_each_mistake_in_each_animal(animal: str, mistake: str) -> None:
    one(tree(animal) if animal in ANIMALS else load_study(animal), mistake)


@pytest.mark.parametrize("mistake", [m for m in MISTAKES if not m.startswith("pressure")])
@pytest.mark.parametrize("observed", ["", "q"])
def test_without_pressures(observed: str, mistake: str) -> None:
    one(tree("human", observed=observed), mistake)


@pytest.mark.parametrize("animal", ANIMALS)
@pytest.mark.parametrize("given", [{}, {"loads": False}, {"observed": ""}, {"observed": "q"}])
def test_right_studies_give_none(animal: str, given: dict) -> None:
    assert suspect_units(tree(animal, **given)) == ()


def test_studies_in_the_repository_give_none() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", UnitWarning)
        load_study("demo")
        load_study(ROOT / "docs" / "example-study")


@pytest.mark.needs_data
def test_measured_studies_give_none(blind_cases: list[Path]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", UnitWarning)
        for name in ("mouse-c6", "mouse-h1", *blind_cases):
            load_study(name)


def test_several_mistakes_are_several_suspicions() -> None:
    """A study all in SI."""
    study = tree("human")
    for mistake in ("pressure in Pa", "flow in m3/s", "lengths in m", "loads in SI"):
        change, factor, _ = MISTAKES[mistake]
        study = change(study, factor)
    study = replace(study, blood=Blood(1060.0, 0.004))
    units = {"Pa", "m3/s", "m", "Pa s/m3 and m3/Pa", "kg/m3", "Pa s"}
    assert {s.unit for s in suspect_units(study)} == units


def test_one_file_of_two_in_another_unit() -> None:
    """The inflow in ml/s, what was observed in l/min: only the second is named."""
    study = tree("human")
    wrong = replace(study, series=scaled(study, "flow_ml_s", 0.06))
    (found,) = suspect_units(wrong)
    assert found.fields == ("observations: flow_ml_s",)
    radii = replace(study, vessels=tuple(replace(v, length_cm=100 * v.length_cm) for v in study.vessels))
    assert [s.fields for s in suspect_units(radii)] in ([], [("network: length_cm",)])


def walls(study: Study, factor: float) -> Study:
    """A modulus of 4e6 g/(cm s2), 0.4 MPa, walls a tenth of the radius."""
    given = {"youngs_modulus_g_cm_s2": 4e6 * factor}
    vessels = [replace(v, wall_thickness_cm=0.1 * v.radius_cm, **given) for v in study.vessels]
    return replace(study, vessels=tuple(vessels))


def areas(study: Study, factor: float) -> Study:
    area = np.pi * 1.4**2 * (1.1 + 0.1 * np.sin(2 * np.pi * study.time_s / study.period_s))
    return replace(study, series=(*study.series, Series(1, 0.0, "area_cm2", factor * area)))


def density(study: Study, factor: float) -> Study:
    return replace(study, blood=Blood(1.06 * factor, 0.04))


def viscosity(study: Study, factor: float) -> Study:
    return replace(study, blood=Blood(1.06, 0.04 * factor))


def period(study: Study, factor: float) -> Study:
    times = {name: factor * getattr(study, name) for name in ("period_s", "inflow_time_s", "time_s")}
    return replace(study, **times)


@pytest.mark.parametrize(
    ("change", "factor", "unit"),
    [
        (density, 1e3, "kg/m3"),
        (viscosity, 0.1, "Pa s"),
        (viscosity, 100.0, "mPa s"),
        (walls, 1e-4, "kPa"),
        (walls, 1e-7, "MPa"),
        (areas, 100.0, "mm2"),
        (areas, 1e-4, "m2"),
        (period, 1e3, "ms"),
    ],
)
def test_other_quantities_in_other_units(
    change: Callable[[Study, float], Study], factor: float, unit: str
) -> None:
    assert suspect_units(change(tree("human"), 1.0)) == ()
    (found,) = suspect_units(change(tree("human"), factor))
    assert (found.unit, found.factors[0]) == (unit, pytest.approx(1 / factor))


def test_an_outflow_pressure_above_the_observed() -> None:
    """5 mmHg in Pa, of the study and of one vessel; a venous pressure below the observed one is none."""
    study = tree("human")
    assert suspect_units(replace(study, outflow_pressure_mmHg=12.0)) == ()
    one_of = [replace(study.vessels[-1], outflow_pressure_mmHg=666.6)]
    for wrong in (
        replace(study, outflow_pressure_mmHg=666.6),
        replace(study, vessels=(*study.vessels[:-1], *one_of)),
    ):
        (found,) = suspect_units(wrong)
        assert (found.fields, found.unit) == (("network: outflow_pressure_mmHg",), "Pa")
        assert "outflow_pressure_mmHg is 666.6" in str(found)


def test_sizes_that_no_unit_explains_have_no_remedy() -> None:
    study = tree("human")
    assert suspect_units(pressures(study, 1e9)) == ()
    assert suspect_units(replace(study, blood=Blood(1.06, 1e9))) == ()


def test_loading_warns_and_can_be_silenced(tmp_path: Path) -> None:
    save_study(pressures(load_study("demo"), 0.1333224), tmp_path / "kpa")
    with pytest.warns(UnitWarning, match="kPa would fit") as caught:
        load_study(tmp_path / "kpa")
    assert len(caught) == 1
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", UnitWarning)
        load_study(tmp_path / "kpa")


@pytest.mark.parametrize(("sign", "words"), [(";", "semicolons"), ("\t", "tabs")])
def test_other_separators_are_named(tmp_path: Path, sign: str, words: str) -> None:
    save_study(load_study("demo"), tmp_path)
    for name in ("inflow.csv", "observations.csv"):
        text = (tmp_path / name).read_text()
        (tmp_path / name).write_text(text.replace(",", sign))
        with pytest.raises(StudyError, match=f"{name}, row 1: the columns are separated by {words}"):
            load_study(tmp_path)
        (tmp_path / name).write_text(text)


@pytest.mark.parametrize("mistake", ["pressure in kPa", "flow in l/min"])
def test_warnings_in_the_documents_are_real(tmp_path: Path, mistake: str, monkeypatch) -> None:
    change, factor, _ = MISTAKES[mistake]
    monkeypatch.chdir(tmp_path)
    save_study(change(load_study(ROOT / "docs" / "example-study"), factor), "my-study")
    with pytest.warns(UnitWarning) as caught:
        load_study("my-study")
    text = (ROOT / "docs" / "study-format.md").read_text(encoding="utf-8")
    assert f"warning: {caught[0].message}\n" in text


@pytest.mark.parametrize(
    ("study", "odd"),
    [
        ("demo", "the time of a wave to the furthest outlet would be 1.17 of the beat"),
        (
            str(ROOT / "docs" / "example-study"),
            "the median length of the vessels would be 100 of their radii",
        ),
    ],
)
def test_lengths_ten_times_too_long_alone(study: str, odd: str) -> None:
    """Radii are right, and the way to the outlets is one that some animal has."""
    right = load_study(study)
    assert suspect_units(right) == ()
    long = tuple(replace(v, length_cm=10 * v.length_cm) for v in right.vessels)
    (found,) = suspect_units(replace(right, vessels=long))
    assert found.fields == ("network: length_cm",)
    assert found.factors == (0.1,)
    assert odd in found.text


@pytest.mark.parametrize(("field", "factor"), [("radius_cm", 10.0), ("length_cm", 40.0)])
def test_one_vessel_in_another_unit(field: str, factor: float) -> None:
    """Its own number alone is in mm, or too long by as much; those of the others are right."""
    study = tree("human")
    odd = [replace(v, **{field: factor * getattr(v, field)}) if v.id == 5 else v for v in study.vessels]
    (found,) = suspect_units(replace(study, vessels=tuple(odd)))
    assert found.fields == (f"network: {field}",)
    assert f"{field} of vessel 5 is" in found.text
