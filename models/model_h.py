"""Model H: tangent wall, the same stiffness in every vessel, a Gaussian process for the errors.

`wall_factor` of the conventions, 1 as printed or 1/pi as in the published code, is the wall's own.

Paun et al. 2020, doi 10.1098/rsif.2020.0886.
"""

from __future__ import annotations

import math

from zoo.blood.baseline import Baseline, study_model
from zoo.blood.blood_flow import constant_stiffness
from zoo.blood.errors import by_prior_set
from zoo.core.errors.gaussian_process import GaussianProcess
from zoo.core.parameters import LogUniform, Parameter, Uniform

# starts are published posterior medians
BASELINE = Baseline(
    "tangent-constant",
    wall="tangent",
    stiffness=constant_stiffness,
    parameters=(
        Parameter("f3", Uniform(3e4, 5e5), "g cm-1 s-2", start=9.17e4, log=True),  # stiffness of every vessel
        # largest area of the wall: A0 (1 + gamma/2)
        Parameter("gamma", Uniform(1, 2 * math.pi), start=5.18, log=True),
        # factors on the nominal R1, R2 and C of every outlet
        Parameter("psi1", Uniform(0.05, 2.5), start=0.37, log=True),
        Parameter("psi2", Uniform(0.05, 2.5), start=0.94, log=True),
        Parameter("c", Uniform(0.05, 2.5), start=1.60, log=True),
    ),
    prior_set="paun2020",  # for mouse-c6; other studies have their own, zoo.blood.study_priors
)
ERRORS = GaussianProcess(  # variances of the kernel's weights, s-2, and bias; its amplitude is in mmHg2
    w=LogUniform(1e4, 9e4), w_start=4.91e4, b=LogUniform(1, 500), b_start=178.0, unit="mmHg"
)

model_H = study_model("H", BASELINE, by_prior_set(ERRORS))
