"""Model I: tangent wall, stiffness by radius (eq. 3.5), a Gaussian process for the errors.

Unless conventions are given, `wall_factor` is 1, the printed one, also in a study of the published
code's conventions: only so do the published medians fit the measured pressures.

Paun et al. 2020, doi 10.1098/rsif.2020.0886.
"""

from __future__ import annotations

import math

from zoo.blood.baseline import Baseline, study_model
from zoo.blood.blood_flow import radius_dependent_stiffness
from zoo.blood.errors import by_prior_set
from zoo.core.errors.gaussian_process import GaussianProcess
from zoo.core.parameters import LogUniform, Parameter, Uniform

# starts are published posterior medians
BASELINE = Baseline(
    "tangent-radius",
    wall="tangent",
    stiffness=radius_dependent_stiffness,
    parameters=(
        # stiffness f1 exp(f2 r0/u) + f3, u the conventions' stiffness_radius_unit_cm
        Parameter("f1", Uniform(5e3, 1e5), "g cm-1 s-2", start=0.58e5, log=True),
        Parameter("f2", Uniform(-200, 0), "1/stiffness_radius_unit_cm", start=-6.0),
        Parameter("f3", Uniform(1e4, 5e5), "g cm-1 s-2", start=2.00e4, log=True),
        # largest area of the wall: A0 (1 + gamma/2)
        Parameter("gamma", Uniform(1, 2 * math.pi), start=5.09, log=True),
        # factors on the nominal R1, R2 and C of every outlet
        Parameter("psi1", Uniform(0.05, 2.5), start=0.34, log=True),
        Parameter("psi2", Uniform(0.05, 2.5), start=0.97, log=True),
        Parameter("c", Uniform(0.05, 2.5), start=1.58, log=True),
    ),
    wall_factor=1.0,
    prior_set="paun2020",  # for mouse-c6; other studies have their own, zoo.blood.study_priors
)
ERRORS = GaussianProcess(  # variances of the kernel's weights, s-2, and bias; its amplitude is in mmHg2
    w=LogUniform(1e4, 9e4), w_start=4.45e4, b=LogUniform(1, 500), b_start=196.0, unit="mmHg"
)

model_I = study_model("I", BASELINE, by_prior_set(ERRORS))
