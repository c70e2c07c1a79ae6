"""Model D: linear wall, stiffness by radius, independent errors.

Paun et al. 2020, doi 10.1098/rsif.2020.0886.
"""

from __future__ import annotations

import pymc as pm

from zoo.blood.conventions import Conventions
from zoo.blood.op import blood_flow, radius_dependent_stiffness
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Study
from zoo.core.errors.likelihood import iid_errors, study_model

# published posterior medians; sigma2 is the published sum of squared errors over 512 samples
SUGGESTED = {"f1": 52.6e5, "f2": -162.0, "f3": 5.17e4, "psi1": 0.21, "psi2": 0.89, "c": 1.45, "sigma2": 0.125}


def model_D(
    study: Study, *, options: SolverOptions | None = None, conventions: Conventions | None = None
) -> pm.Model:
    """Linear wall, stiffness by radius (eq. 3.5), independent errors."""
    with study_model("D", study, SUGGESTED) as model:
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

        iid_errors(mean, ok, study)  # sigma2 ~ InverseGamma(0.001, 0.001)
    return model
