"""Model I: tangent wall, stiffness by radius, correlated errors.

Paun et al. 2020, doi 10.1098/rsif.2020.0886.
"""

from __future__ import annotations

import numpy as np
import pymc as pm

from zoo.blood.conventions import Conventions
from zoo.blood.op import blood_flow, radius_dependent_stiffness
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Study
from zoo.core.errors.likelihood import gp_errors, study_model

# published posterior medians
SUGGESTED = {
    "f1": 0.58e5,
    "f2": -6.0,
    "f3": 2.00e4,
    "gamma": 5.09,
    "psi1": 0.34,
    "psi2": 0.97,
    "c": 1.58,
    "w": 4.45e4,
    "b": 196.0,
}


def model_I(
    study: Study, *, options: SolverOptions | None = None, conventions: Conventions | None = None
) -> pm.Model:
    """Tangent wall, stiffness by radius (eq. 3.5), a Gaussian process for the errors.

    Unless conventions are given, `wall_factor` is 1, the printed one, also in a study of the published
    code's conventions: only so do the published medians fit the measured beat.
    """
    conventions = conventions or study.conventions.replace(wall_factor=1.0)
    with study_model("I", study, SUGGESTED) as model:
        f1 = pm.Uniform("f1", 5e3, 1e5)  # stiffness f1 exp(f2 r0) + f3, g cm-1 s-2
        f2 = pm.Uniform("f2", -200, 0)  # per stiffness_radius_unit_cm of the conventions
        f3 = pm.Uniform("f3", 1e4, 5e5)
        stiffness = radius_dependent_stiffness(study, f1, f2, f3, conventions=conventions)
        gamma = pm.Uniform("gamma", 1, 2 * np.pi)  # largest area of the wall: A0 (1 + gamma/2)
        psi1 = pm.Uniform("psi1", 0.05, 2.5)  # factors on the nominal R1, R2 and C of every outlet
        psi2 = pm.Uniform("psi2", 0.05, 2.5)
        c = pm.Uniform("c", 0.05, 2.5)

        mean, ok = blood_flow(
            study, "tangent", stiffness, psi1, psi2, c, gamma, options=options, conventions=conventions
        )

        gp_errors(mean, ok, study, w_range=(1e4, 9e4), b_range=(1, 500))  # w, b log-uniform
    return model
