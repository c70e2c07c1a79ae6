"""The file of a diagnosis, its documentation, its page."""

from __future__ import annotations

import json
import math
import random
import re
from pathlib import Path
from typing import get_args

import matplotlib.pyplot as plt
import numpy as np
import pytest
from pages import Element, check_tables, read, table_of
from pydantic import BaseModel
from withheld import FILES, POSTERIORS, as_if_sampled, screen_of

import zoo
from zoo import report
from zoo.core.diagnosis import Diagnosis, DiagnosisError, DiagnosisFile, read_diagnosis
from zoo.core.errors.spectral import Harmonics
from zoo.core.outputs import OutputFileError

ROOT = Path(__file__).resolve().parents[2]
DOC = ROOT / "docs" / "diagnosis.md"


def test_the_file_comes_back_as_it_was(three: Diagnosis, one: Diagnosis, tmp_path: Path) -> None:
    for d in (three, one, as_if_sampled(one)):
        path = d.save(tmp_path / "x")
        assert path == tmp_path / "x" / "diagnosis.json"
        for again in (read_diagnosis(path), zoo.read_diagnosis(path.parent)):
            content = json.loads(path.read_text("utf-8"))
            assert len(content.pop("sha256")) == 64
            assert json.loads(again.model_dump_json()) == content
            assert again.sets == d.file.sets
            assert again.gap == d.file.gap


def test_a_file_that_does_not_fit_is_refused(one: Diagnosis, tmp_path: Path) -> None:
    path = one.save(tmp_path)
    content = json.loads(path.read_text("utf-8"))
    del content["sha256"]
    with pytest.raises(DiagnosisError, match="cannot be read"):
        read_diagnosis(tmp_path / "no.json")
    spoilt = {"gap": content["gap"] | {"before_mmHg": "large"}}
    changes = [
        ({"format": 2}, "the file"),
        ({"gapp": 1}, "gapp"),
        ({"verdict": None}, "verdict"),
    ]
    for change, field in (*changes, (spoilt, r"gap\.before")):
        path.write_text(json.dumps(content | change), "utf-8")
        with pytest.raises(DiagnosisError, match=f"{field}: .*make it again") as error:
            read_diagnosis(path)
        assert "\n" not in str(error.value)
    path.write_text("{", "utf-8")
    with pytest.raises(DiagnosisError, match="make it again"):
        read_diagnosis(path)


def test_no_damage_to_an_answer_goes_unseen(one: Diagnosis, tmp_path: Path) -> None:
    """Bits flipped one at a time, and cuts: refused in one line by name, but for 1e-5 as 1E-5 and such."""
    path = one.save(tmp_path)
    raw = path.read_bytes()
    rng, refused, whole = random.Random(6), [], read_diagnosis(path)
    for i in range(250):
        damaged = bytearray(raw)
        if i < 200:
            damaged[rng.randrange(len(raw))] ^= 1 << rng.randrange(8)
        else:
            damaged = damaged[: rng.randrange(len(raw) - 2)]
        path.write_bytes(damaged)
        try:
            assert read_diagnosis(path) == whole
        except DiagnosisError as error:
            refused.append(str(error))
    assert len(refused) >= 240
    assert all(e.startswith(str(path)) and "make it again" in e and "\n" not in e for e in refused)
    content = json.loads(raw)
    path.write_text(json.dumps(content, indent=3, sort_keys=True), "utf-8")
    assert read_diagnosis(path) == whole  # how it is set does not matter
    content["components"][0]["probability"] = 0.999
    path.write_text(json.dumps(content), "utf-8")
    with pytest.raises(DiagnosisError, match="damaged, its content does not fit its digest"):
        read_diagnosis(path)
    for deep in ("[" * 100_000, '{"a":' * 100_000, '{"format": ' + "1" * 5000 + "}"):
        path.write_text(deep, "utf-8")
        with pytest.raises(DiagnosisError, match="make it again"):
            read_diagnosis(path)


def fields(model: type[BaseModel]) -> set[str]:
    """Names of a model's fields and of those inside it, as the file of a study with pressures has them."""
    found = set()
    amounts = getattr(model, "amounts", ())
    for name, field in model.model_fields.items():
        if field.exclude:
            continue
        found.add("vessel" if name == "part" else name + "_mmHg" * (name in amounts))
        kinds = [field.annotation]
        while kinds:
            kind = kinds.pop()
            kinds += get_args(kind)
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                found |= fields(kind)
    return found


def test_readers_read_the_times_that_are_written(one: Diagnosis, sampled: Diagnosis, tmp_path: Path) -> None:
    before, after = one.file.record, sampled.file.record
    [written] = set(after) - set(before)
    own = before["seconds"]
    assert report.diagnosis_page.total_seconds(before) == own
    assert report.diagnosis_page.total_seconds(after) == own + after[written] > own
    record = after | {written: 1000.0, "states_seconds": 200.0}
    d = sampled.with_file(record=record)
    assert report.diagnosis_page.total_seconds(record) == own + 1200
    assert screen_of(d.file).strip().endswith(f", {own + 1200:.0f} s in all")
    report.write_diagnosis(d, tmp_path / "x")
    [facts] = read(tmp_path / "x" / "report.html").of_class("facts")
    shown = dict(zip(*([e.text for e in facts.all(tag)] for tag in ("dt", "dd")), strict=True))
    assert shown["seconds"] == f"{own:.1f}"
    assert shown["posterior seconds"] == "1000.0"
    assert shown["total seconds"] == f"{own + 1200:.1f}"


def test_the_document_has_every_field(one: Diagnosis, sampled: Diagnosis) -> None:
    text = DOC.read_text("utf-8")
    words = set(re.findall(r"`([\w.]+)`", text))
    words |= {word.removesuffix("_mmHg") for word in words}  # amounts carry their unit in the file
    assert "vessel" in words  # what a part is called in a tree of vessels
    assert fields(DiagnosisFile) - {"low", "high", "mean", "part", "noun"} <= words
    assert set(sampled.file.record) | set(POSTERIORS["nothing"]) <= words
    settings = re.findall(r"^\| `([a-z_]+)` \| ([\d., ]+) \| ", text, flags=re.M)
    assert len(settings) == 4
    for name, value in settings:
        expected = np.atleast_1d(getattr(Harmonics(), name))
        assert [float(x) for x in value.split(",")] == pytest.approx(list(expected)), name


@pytest.fixture(scope="module")
def page(three: Diagnosis, tmp_path_factory: pytest.TempPathFactory) -> Element:
    out = tmp_path_factory.mktemp("page") / "gap"
    written = report.write_diagnosis(as_if_sampled(three), out, command="zoo diagnose <x>")
    assert [p.name for p in written] == FILES
    assert all(p.stat().st_size > 10_000 for p in written if p.suffix == ".png")
    return read(out / "report.html")


def test_the_page_is_whole_and_loads_nothing(page: Element) -> None:
    assert [i.attributes["src"].startswith("data:image/png;base64,") for i in page.all("img")] == [True] * 5
    assert page.all("script") == []
    assert "url(" not in page.all("style")[0].text
    assert ".summary" in page.all("style")[0].text
    check_tables(page)
    inner = {a.attributes["href"][1:] for a in page.all("a")}
    assert inner == {h.attributes["id"] for h in page.all("h2")}


def test_the_page_has_the_numbers(page: Element, three: Diagnosis) -> None:
    file = three.file
    text = page.text
    assert file.verdict in text
    for words in ("zoo diagnose <x>", file.study_checksum, *(f"{x} " for x in file.record["versions"])):
        assert words in text
    rows = table_of(page, "Model error in each observed series")
    assert [row[:2] for row in rows] == [[s.series, s.unit] for s in file.gap.per_series]
    assert rows[0][2].startswith(f"{file.gap.per_series[0].before.mean:.2g} (")
    rows = table_of(page, "Probability that a component is wrong")
    assert [row[0] for row in rows] == [c.name for c in file.components if c.probability >= 0.01]
    assert len(rows) < len(file.components)  # the rest is folded
    for cell in (file.components[-1].name, "1 more below 1 %"):
        assert any(cell in one.text for one in page.all("details"))
    rows = table_of(page, "Listed effects and free functions")
    assert [row[0] for row in rows] == [c.name for c in file.causes if c.probability >= 0.01]
    assert "Kelvin-Voigt" in rows[0][-1]
    tau = file.causes[0].estimates[0]
    assert tau.interval is not None
    assert rows[0][4] == f"tau {tau.mean:.2g} ({tau.interval[0]:.2g} to {tau.interval[1]:.2g}) s"
    rows = table_of(page, "Parameters of the baseline")
    assert [row[0] for row in rows] == ["f3", "psi1", "psi2", "c"]
    shift = file.base_parameters["over all sets"]["c"].mean - file.base_parameters["base"]["c"].mean
    assert float(rows[3][5]) == pytest.approx(shift, rel=0.01)
    [failed] = page.of_class("failed")
    assert failed.text == "viscoelastic-wall: not converged: R-hat of tau is 1.2"
    rows = table_of(page, "The baseline and the leading sets of listed effects sampled")
    assert [row[0] for row in rows] == ["nothing", "viscoelastic-wall"]
    assert rows[1][1:] == ["no", "60.0 ± 0.1", "65.0", "0.0", "–", "f3 43000 ± 300"]


def test_the_table_of_sets_is_that_of_the_file(page: Element, three: Diagnosis) -> None:
    """Prior times evidence is the probability, by what the page says alone."""
    rows = table_of(page, "Sets of causes")
    nothing = next(row for row in three.file.sets if not row.causes)
    told = [row for row in three.file.sets if row.probability >= 0.005 or row is nothing]
    assert [row[0] for row in rows] == [" + ".join(one.causes) or "no cause" for one in told]
    worth = [math.log(float(row[2].removesuffix(" %"))) + float(row[3].split(" ± ")[0]) for row in rows]
    for row, one, log_odds in zip(rows, told, worth, strict=True):
        expected = math.log(one.probability / told[0].probability)
        assert log_odds - worth[0] == pytest.approx(expected, abs=0.15)
        assert row[6] == ("yes" if one.solved else "no")
        assert row[5] == ("" if one.gap_after is None else f"{one.gap_after:.2g}")


def test_what_the_answer_depends_on_comes_first(one: Diagnosis, tmp_path: Path) -> None:
    first = one.file.components[0].model_copy(update={"confounded": ["inflow"], "group_probability": 0.97})
    changes = {
        "warnings": ["the answer depends on the prior"],
        "missed": 0.25,
        "linear_error": 1.0,
    }
    d = one.with_file(components=[first, *one.file.components[1:]], decided=False, **changes)
    report.write_diagnosis(d, tmp_path / "x")
    assert plt.get_fignums() == []  # nothing is left open
    page = read(tmp_path / "x" / "report.html")
    [summary] = page.of_class("summary")
    verdict, *told = (p.text for p in summary.all("p"))
    assert verdict == f"{d.file.verdict}."
    assert told[-1] == "Warning: the answer depends on the prior."
    for shown in (summary.text, " ".join(screen_of(d.file).split())):
        assert f"These data hardly distinguish {first.name} from inflow: at" in shown
        assert "at least one of them is wrong with a probability of 97 %" in shown
        assert "Up to 25 % of the probability may belong to combinations" in shown
    assert table_of(page, "Probability that a component is wrong")[0][5:] == ["inflow", "97 %"]


def test_sensitivity_is_told_beside_each_component_and_whole(one: Diagnosis, tmp_path: Path) -> None:
    stated, *others = one.file.sensitivity
    name = one.file.components[0].name
    others[-1] = others[-1].model_copy(update={"components": stated.components | {name: 0.1234}})
    report.write_diagnosis(one.with_file(sensitivity=[stated, *others]), tmp_path / "x")
    page = read(tmp_path / "x" / "report.html")
    assert table_of(page, "Probability that a component is wrong")[0][3].startswith("12 % to ")
    rows = table_of(page, "Probability of no cause")
    assert [row[0] for row in rows] == [stated.prior, *(row.prior for row in others)]
    assert rows[-1][2] == "12 %"


def test_a_page_needs_a_folder(one: Diagnosis, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for write in (one.save, lambda path: report.write_diagnosis(one, path)):
        with pytest.raises(OutputFileError, match="is a file; give a folder"):
            write(tmp_path / "file")
    with pytest.raises(OutputFileError, match="does not exist; create it"):
        report.write_diagnosis(one, tmp_path / "no" / "gap")
