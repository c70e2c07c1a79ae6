"""Model E: linear wall, stiffness by radius, correlated errors.

Paun et al. 2020, doi 10.1098/rsif.2020.0886.
"""

from __future__ import annotations

import pymc as pm

from zoo.blood.conventions import Conventions
from zoo.blood.op import blood_flow, radius_dependent_stiffness
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Study
from zoo.core.errors.likelihood import gp_errors, study_model

# published posterior medians
SUGGESTED = {
    "f1": 51.1e5,
    "f2": -171.0,
    "f3": 4.32e4,
    "psi1": 0.29,
    "psi2": 0.87,
    "c": 1.34,
    "w": 5.39e4,
    "b": 138.0,
}


def model_E(
    study: Study, *, options: SolverOptions | None = None, conventions: Conventions | None = None
) -> pm.Model:
    """Linear wall, stiffness by radius (eq. 3.5), a Gaussian process for the errors."""
    with study_model("E", study, SUGGESTED) as model:
        f1 = pm.Uniform("f1", 1e3, 1e7)  # stiffness f1 exp(f2 r0) + f3, g cm-1 s-2
        f2 = pm.Uniform("f2", -300, -50)  # per stiffness_radius_unit_cm of the conventions
        f3 = pm.Uniform("f3", 3e4, 6e4)
        stiffness = radius_dependent_stiffness(study, f1, f2, f3, conventions=conventions)
        psi1 = pm.Uniform("psi1", 0.05, 2.5)  # factors on the nominal R1, R2 and C of every outlet
        psi2 = pm.Uniform("psi2", 0.05, 2.5)
        c = pm.Uniform("c", 0.05, 2.5)

        mean, ok = blood_flow(
            study, "linear", stiffness, psi1, psi2, c, options=options, conventions=conventions
        )

        gp_errors(mean, ok, study, w_range=(1e4, 9e4), b_range=(1, 500))  # w, b log-uniform
    return model
