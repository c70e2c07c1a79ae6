"""How far the solver's grid moves estimates from synthetic data: `python benchmarks/synthetic_grid.py`.

Data made on a grid four times finer, minus the waves of the default grid, whitened by the error process and
projected on the derivatives: the shift of f3, psi1, psi2 and c in posterior standard deviations.
"""

from __future__ import annotations

import numpy as np

from zoo import load_study
from zoo.blood.network import Network, stiffness_profile
from zoo.blood.solver import Solver, SolverOptions
from zoo.paper.synthetic import whitened
from zoo.paper.truth import PAPER_TRUTH

STEPS = {"f3": 500.0, "psi1": 0.01, "psi2": 0.005, "c": 0.02}


def main() -> None:
    study = load_study("mouse-c6")
    network = Network.from_study(study)
    unit = study.conventions.stiffness_radius_unit_cm
    print("samples  vessels  grid     largest difference, mmHg   shift of " + ", ".join(STEPS) + " in sd")
    for n in (256, 512):
        times = np.arange(n) * study.period_s / n
        for vessels in (1, 3, 21):
            sites = [(v.id, 0.0 if i == 0 else 0.5) for i, v in enumerate(study.vessels[:vessels])]

            def waves(options: SolverOptions, sites=sites, times=times, **changed: float) -> np.ndarray:
                at = {name: changed.get(name, getattr(PAPER_TRUTH, name)) for name in STEPS}
                chi = stiffness_profile(
                    network.radius_in_cm, PAPER_TRUTH.f1, PAPER_TRUTH.f2, at.pop("f3"), unit
                )
                solver = Solver.for_study(study, series=sites, times_s=times, options=options)
                return solver.solve(chi, **at).pressure_mmHg

            def scaled(residual: np.ndarray, times=times) -> np.ndarray:
                return whitened(residual, times, PAPER_TRUTH).ravel()

            fine = waves(SolverOptions(refine=4, tolerance_mmHg=1e-6))
            for name, options in (("default", SolverOptions()), ("halved", SolverOptions(refine=2))):
                columns = []
                for parameter, h in STEPS.items():
                    value = getattr(PAPER_TRUTH, parameter)
                    up, down = (waves(options, **{parameter: value + s}) for s in (h, -h))
                    columns.append(scaled((up - down) / (2 * h)))
                jacobian = np.array(columns).T
                covariance = np.linalg.inv(jacobian.T @ jacobian)
                difference = fine - waves(options)
                shift = covariance @ (jacobian.T @ scaled(difference)) / np.sqrt(np.diag(covariance))
                text = "  ".join(f"{x:+.2f}" for x in shift)
                print(f"{n:7}  {vessels:7}  {name:7}  {np.abs(difference).max():24.4f}   {text}")


if __name__ == "__main__":
    main()
