"""Effects inside a PyMC model: is the truth in its intervals as often as they say?

Draws studies from model C with two effects (a viscoelastic wall, and a stiffness of its own of vessel 2), on
a tree of the main pulmonary artery and its two daughters, all three observed; samples each with the same
model; counts how often the 95 % interval of each parameter holds the value that was drawn. The grid is
coarse in both, which changes nothing that is counted. A killed run goes on where it stopped.

    python benchmarks/effects_in_models.py --studies 20 --seed 1 -o runs/effects-in-models
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from zoo import model_C
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Study
from zoo.core.forward import SolveError
from zoo.core.inference.convergence import verdict
from zoo.core.model import record_of
from zoo.core.parameters import draw_prior, unpack, variable_name
from zoo.core.posterior.files import sample_to
from zoo.paper.cheap import cheap_study

EFFECTS = ["viscoelastic-wall", "local-stiffness@2"]
SITES = ((1, 0.0), (2, 0.5), (3, 0.5))
OPTIONS = SolverOptions(dx_cm=0.2, steps_per_beat=1024, tolerance_mmHg=1e-4)
"""Fixed steps: if they followed the parameters, waves would jump by more than the fixed noise."""


def drawn(study: Study, rng: np.random.Generator) -> tuple[Study, dict[str, float]]:
    """A study drawn from the model, and its parameters; what the solver cannot solve is drawn again."""
    record = record_of(model_C(study, effects=EFFECTS, options=OPTIONS))
    while True:
        theta, eta = draw_prior(record.forward.parameters, rng), draw_prior(record.errors.parameters, rng)
        try:
            mean = record.forward.solve(record.forward.configure(theta))
        except SolveError:
            continue
        values = unpack(record.forward.parameters, theta) | unpack(record.errors.parameters, eta)
        errors = record.errors.draw(rng, values)
        assert errors is not None
        series = tuple(replace(s, value=y) for s, y in zip(study.series, mean + errors, strict=True))
        truth = {variable_name(name): float(value) for name, value in values.items()}
        return replace(study, series=series), truth


def run(n: int, seed: int, folder: Path, cores: int) -> None:
    """Draw, sample, count."""
    folder.mkdir(parents=True, exist_ok=True)
    study, rows = cheap_study(64, SITES), []
    for i in range(n):
        data, truth = drawn(study, np.random.default_rng([seed, i]))
        file = folder / f"study-{i:02d}.json"
        if file.exists():
            rows.append(json.loads(file.read_text()))
            continue
        model = model_C(data, effects=EFFECTS, options=OPTIONS)
        idata = sample_to(
            folder / f"study-{i:02d}.nc", model, seed=seed + i, cores=cores, until_ess=400, progress=False
        )
        found = verdict(idata)
        inside = {}
        for name, value in truth.items():
            low, high = np.quantile(idata.posterior[name].to_numpy(), [0.025, 0.975])
            inside[name] = bool(low <= value <= high)
        row = {"study": i, "truth": truth, "inside": inside, "rhat": found.max_rhat, "ess": found.min_ess}
        row |= {"converged": bool(found.passes)}
        file.write_text(json.dumps(row, indent=1) + "\n")
        rows.append(row)
        print(i, "converged" if found.passes else found.text, inside, flush=True)
    for name in rows[0]["truth"]:
        print(f"{name:32} {sum(r['inside'][name] for r in rows):3d} of {len(rows)}")
    print(
        f"R-hat at most {max(r['rhat'] for r in rows):.4f}, ESS at least {min(r['ess'] for r in rows):.0f}, "
    )
    print(f"converged: {sum(r['converged'] for r in rows)} of {len(rows)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--studies", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("-o", "--output", type=Path, default=Path("runs/effects-in-models"))
    given = parser.parse_args()
    run(given.studies, given.seed, given.output, given.cores)
