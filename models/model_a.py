"""Model A: linear wall, one stiffness, independent errors.

Paun et al. 2020, doi 10.1098/rsif.2020.0886.
"""

from __future__ import annotations

import pymc as pm

from zoo.blood.conventions import Conventions
from zoo.blood.op import blood_flow
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Study
from zoo.core.errors.likelihood import iid_errors, study_model

# published posterior medians; sigma2 is the published sum of squared errors over 512 samples
SUGGESTED = {"f3": 5.17e4, "psi1": 0.21, "psi2": 0.88, "c": 1.44, "sigma2": 0.13}


def model_A(
    study: Study, *, options: SolverOptions | None = None, conventions: Conventions | None = None
) -> pm.Model:
    """Linear wall, the same stiffness in every vessel, independent errors."""
    with study_model("A", study, SUGGESTED) as model:
        f3 = pm.Uniform("f3", 2e4, 1e5)  # stiffness, g cm-1 s-2
        psi1 = pm.Uniform("psi1", 0.05, 2.5)  # factors on the nominal R1, R2 and C of every outlet
        psi2 = pm.Uniform("psi2", 0.05, 2.5)
        c = pm.Uniform("c", 0.05, 2.5)

        mean, ok = blood_flow(study, "linear", f3, psi1, psi2, c, options=options, conventions=conventions)

        iid_errors(mean, ok, study)  # sigma2 ~ InverseGamma(0.001, 0.001)
    return model
