"""`zoo import`: what it prints, and what it asks for."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import fails, run

from zoo.blood.study import load_study

NETWORK = """project_name: tube
blood:
  rho: 1060.0
  mu: 4.0e-3
solver:
  Ccfl: 0.9
network:
  - label: trunk
    sn: 1
    tn: 2
    L: 0.126
    E: 7.0e5
    R0: 3.0e-3
    h0: 0.3e-3
    M: 126
    gamma_profile: 2
    R1: 2.5e8
    R2: 1.9e9
    Cc: 1.8e-10
"""


@pytest.fixture
def yaml(tmp_path: Path) -> Path:
    flow = [6.5e-6, 9e-6, 12e-6, 9e-6, 6.5e-6, 4e-6, 2e-6, 4e-6]
    rows = [f"{i / 16} {flow[i % 8]}" for i in range(17)]
    (tmp_path / "tube_inlet.dat").write_text("\n".join(rows))
    path = tmp_path / "model.yaml"
    path.write_text(NETWORK)
    return path


def test_it_says_what_it_read_and_the_next_command(yaml: Path, tmp_path: Path) -> None:
    said = run("import", yaml, "-o", tmp_path / "study")
    assert "read: 1 vessels, 0 tapered; outlets: 1 x Windkessel" in said
    assert "velocity profile of order 2" in said
    assert "converted: SI to cgs" in said
    assert "left out: solver settings Ccfl" in said
    assert "left out: M of 1 vessels" in said
    assert said.strip().endswith(f"next: zoo simulate {tmp_path / 'study'}")
    assert load_study(tmp_path / "study").name == "tube"
    assert run("import", yaml, "-o", tmp_path / "study") == said
    (tmp_path / "study" / "study.toml").write_text("mine")
    assert "study.toml: is there, and not as zoo wrote it" in fails("import", yaml, "-o", tmp_path / "study")


def test_a_table_needs_its_inflow(tmp_path: Path) -> None:
    table = tmp_path / "vessels.csv"
    table.write_text("id,parent,length_cm,radius_cm,R1,R2,C\n1,,5,0.6,900,8000,4e-5\n")
    inflow = tmp_path / "q.csv"
    inflow.write_text("time_s,flow_ml_s\n" + "".join(f"{i * 0.05:.2f},{15 + i % 4}\n" for i in range(16)))
    out = "-o", tmp_path / "study"
    assert "add --inflow inflow.csv" in fails("import", table, *out)
    assert "add --period" in fails("import", table, *out, "--inflow", inflow)
    said = run("import", table, *out, "--inflow", inflow, "--period", 0.8, "--name", "mine")
    assert "1 vessels; outlets: 1 x Windkessel" in said
    assert "density 1.06 g/cm3" in said
    assert "--stiffness" in said.splitlines()[-1]
    assert load_study(tmp_path / "study").name == "mine"


def test_wrong_files_and_options(yaml: Path, tmp_path: Path) -> None:
    out = "-o", tmp_path / "study"
    assert "belongs to a .csv" in fails("import", yaml, *out, "--period", 1.0)
    assert "unknown ending '.dat'" in fails("import", tmp_path / "tube_inlet.dat", *out)
    assert "no such file" in fails("import", tmp_path / "absent.yaml", *out)
    yaml.write_text(NETWORK.replace("gamma_profile", "gama_profile"))
    assert "row 16: vessel trunk: gama_profile: unknown field; did you mean 'gamma_profile'?" in fails(
        "import", yaml, *out
    )
    assert not (tmp_path / "study").exists()
