"""Packs what `freeze.py` made: cases, keys and answers of commit c4fb767, in that commit's formats."""

from __future__ import annotations

import argparse
import io
import json
import lzma
import math
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.blind.other_keys import COUNTS, NO_SIZE, right_of

from zoo.blood.components import component_of
from zoo.blood.effects import CATALOGUE
from zoo.core.blindcheck import CaseKey, as_answer
from zoo.core.blindcheck.folders import case_files, digest_of
from zoo.core.diagnosis import read_diagnosis

HERE = Path(__file__).parent
PARTS = {"active-tone": "wall", "leaking-valve": "inflow", "valve-click": "inflow"}


def rounded(value: Any) -> Any:
    """With six digits; a probability near 1 keeps what it lacks."""
    if isinstance(value, float):
        return float(f"{value:.6g}") if value < 0.99 or value > 1 else float(f"{value:.12g}")
    if isinstance(value, dict):
        return {k: rounded(v) for k, v in value.items()}
    return [rounded(v) for v in value] if isinstance(value, list | tuple) else value


def key_of(name: str, entry: dict[str, Any], files: str) -> CaseKey:
    kind, label = entry["kind"], entry["effect"]
    names = [e["effect"] for e in entry["effects"]]
    parts = entry.get("components") or [PARTS.get(n) or component_of(CATALOGUE[n]) for n in names]
    components = tuple(dict.fromkeys(p for p in parts if p))
    noise = entry["noise"]
    accepted = right_of(kind, label, components, noise["correlated_mmHg"] > 0)
    if label == "second-effect":
        accepted = (*names, "unlisted")
    truth = [[float(x) for x in row.split()] for row in entry.pop("truth").values()]
    sized = kind == "listed" and label not in NO_SIZE
    first = entry["effects"][0] if kind == "listed" else {}
    words = COUNTS.get(len(truth), "three or more")
    what = name.rsplit("-", 1)[0]
    return CaseKey(
        case=f"{name}/{entry['case']}", kind=kind, label=label, accepted=accepted, components=components,
        place=first.get("vessel"), subtree=first.get("subtree", False),
        parameter=next(iter(first["amplitudes"].values())) if sized else None,
        prior_95=next(iter(first["priors_95"].values())) if sized else None,
        noise=math.hypot(noise["white"].get("mmHg", 0.0), noise["correlated_mmHg"]),
        gap=entry["gap_mmHg"]["before"], truth=truth,
        tags={"set": what, "series": words, "set, series": f"{what}, {words}",
              "layout": entry["layout"], "network": entry["network"]["kind"]},
        drawn={k: v for k, v in entry.items() if k not in ("files", "digest", "case", "kind")}, files=files,
    )  # fmt: skip


def answer_line(name: str, folder: Path, key: CaseKey | None) -> dict[str, Any]:
    if not (folder / "diagnosis.json").is_file():
        return {
            "case": f"{name}/{folder.name}",
            "failed": (folder / "failed.txt").read_text().splitlines()[0],
        }
    file = read_diagnosis(folder)
    answer = as_answer(file).model_dump(mode="json", exclude_defaults=True)
    if key is not None and (folder / "fitted.json").is_file():
        fitted = json.loads((folder / "fitted.json").read_text())
        rows, truth = fitted["about"], np.array(key.truth)
        for what, series in (("gap", "base"), ("left", "leader")):
            if what in answer:
                rms = np.sqrt(np.mean((truth - np.array(fitted[series]))[rows] ** 2))
                answer[what]["true"] = float(rms)
    line = {
        "case": f"{name}/{folder.name}",
        "verdict": file.verdict,
        "cause": list(file.cause),
        "answer": answer,
    }
    lead = next((h for h in file.hypotheses if h.name in file.cause), None)
    if lead is not None and lead.amplitude is not None:
        line["leading"] = {
            "name": lead.name,
            "parameters": [
                {"name": e.name, "unit": e.unit, "mean": e.mean, "sd": e.sd, "interval": e.interval}
                for e in (lead.amplitude, *lead.other_amplitudes)
            ],
        }
    line["shares"] = {c.name: c.share.mean for c in file.components if c.share}
    line["several"] = [c.name for c in file.components if c.one_of_several]
    seconds = folder / "seconds.json"
    line["seconds"] = json.loads(seconds.read_text()) if seconds.is_file() else {}
    return rounded(line)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("freeze", type=Path, help="folder with cases/, keys/ and answers/")
    root = parser.parse_args().freeze
    keys, answers = [], []
    (HERE / "cases").mkdir(exist_ok=True)
    for path in sorted((root / "keys").glob("*.json")):
        name = path.stem
        content = json.loads(path.read_text())
        found, folders = [], {}
        for entry in content["cases"]:
            files = case_files(root / "cases" / name / entry["case"])
            folders[entry["case"]] = files
            found.append(key_of(name, entry, digest_of(files)))
        keys += found
        with (
            lzma.open(HERE / "cases" / f"{name}.tar.xz", "wb", preset=9 | lzma.PRESET_EXTREME) as out,
            tarfile.open(fileobj=out, mode="w") as archive,
        ):
            # one kind of file after the other: alike compresses well
            for file in ("study.toml", "network.toml", "inflow.csv", "observations.csv"):
                for case, files in folders.items():
                    info = tarfile.TarInfo(f"{case}/{file}")
                    info.size, info.mode = len(files[file]), 0o644
                    archive.addfile(info, io.BytesIO(files[file]))
        for key in found:
            folder = root / "answers" / name / key.case.split("/")[1]
            if ((folder / "diagnosis.json").is_file() and (folder / "seconds.json").is_file()) or (
                folder / "failed.txt"
            ).is_file():
                answers.append(answer_line(name, folder, key))
    for other in ("blind", "blind2"):
        for folder in sorted((root / "answers" / other).glob("case-*")):
            if (folder / "seconds.json").is_file():
                answers.append(answer_line(other, folder, None))
    lines = "".join(json.dumps(k.model_dump(mode="json", exclude_defaults=True)) + "\n" for k in keys)
    (HERE / "keys.jsonl.xz").write_bytes(lzma.compress(lines.encode(), preset=9 | lzma.PRESET_EXTREME))
    (HERE / "answers.jsonl").write_text("".join(json.dumps(one) + "\n" for one in answers))
    print(len(keys), "keys,", len(answers), "answers")


if __name__ == "__main__":
    main()
