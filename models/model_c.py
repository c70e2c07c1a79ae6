"""Model C: model B sampled without an emulator.

Paun et al. 2020, doi 10.1098/rsif.2020.0886.
"""

from __future__ import annotations

import pymc as pm

from zoo.blood.conventions import Conventions
from zoo.blood.op import blood_flow
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Study
from zoo.core.errors.likelihood import gp_errors, study_model

# published posterior medians
SUGGESTED = {"f3": 4.31e4, "psi1": 0.29, "psi2": 0.87, "c": 1.34, "w": 5.41e4, "b": 138.0}


def model_C(
    study: Study, *, options: SolverOptions | None = None, conventions: Conventions | None = None
) -> pm.Model:
    """Linear wall, one stiffness, a Gaussian process for the errors: the density of model B.

    The paper keeps the two apart to show that its emulator of B adds no bias.
    """
    with study_model("C", study, SUGGESTED) as model:
        f3 = pm.Uniform("f3", 2e4, 1e5)  # stiffness, g cm-1 s-2
        psi1 = pm.Uniform("psi1", 0.05, 2.5)  # factors on the nominal R1, R2 and C of every outlet
        psi2 = pm.Uniform("psi2", 0.05, 2.5)
        c = pm.Uniform("c", 0.05, 2.5)

        mean, ok = blood_flow(study, "linear", f3, psi1, psi2, c, options=options, conventions=conventions)

        gp_errors(mean, ok, study, w_range=(1e4, 9e4), b_range=(1, 500))  # w, b log-uniform
    return model
