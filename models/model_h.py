"""Model H: tangent wall, one stiffness, correlated errors.

Paun et al. 2020, doi 10.1098/rsif.2020.0886.
"""

from __future__ import annotations

import numpy as np
import pymc as pm

from zoo.blood.conventions import Conventions
from zoo.blood.op import blood_flow
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Study
from zoo.core.errors.likelihood import gp_errors, study_model

# published posterior medians
SUGGESTED = {"f3": 9.17e4, "gamma": 5.18, "psi1": 0.37, "psi2": 0.94, "c": 1.60, "w": 4.91e4, "b": 178.0}


def model_H(
    study: Study, *, options: SolverOptions | None = None, conventions: Conventions | None = None
) -> pm.Model:
    """Tangent wall, the same stiffness in every vessel, a Gaussian process for the errors.

    `wall_factor` of the conventions, 1 as printed or 1/pi as in the published code, is the wall's own.
    """
    with study_model("H", study, SUGGESTED) as model:
        f3 = pm.Uniform("f3", 3e4, 5e5)  # stiffness, g cm-1 s-2
        gamma = pm.Uniform("gamma", 1, 2 * np.pi)  # largest area of the wall: A0 (1 + gamma/2)
        psi1 = pm.Uniform("psi1", 0.05, 2.5)  # factors on the nominal R1, R2 and C of every outlet
        psi2 = pm.Uniform("psi2", 0.05, 2.5)
        c = pm.Uniform("c", 0.05, 2.5)

        mean, ok = blood_flow(
            study, "tangent", f3, psi1, psi2, c, gamma, options=options, conventions=conventions
        )

        gp_errors(mean, ok, study, w_range=(1e4, 9e4), b_range=(1, 500))  # w, b log-uniform
    return model
