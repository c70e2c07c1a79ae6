"""Model C: linear wall, one stiffness, a Gaussian process for the errors: the density of model B.

The paper keeps the two apart to show that its emulator of B adds no bias.

Paun et al. 2020, doi 10.1098/rsif.2020.0886.
"""

from __future__ import annotations

from zoo.blood.baseline import Baseline, study_model
from zoo.blood.blood_flow import constant_stiffness
from zoo.blood.errors import by_prior_set
from zoo.core.errors.gaussian_process import GaussianProcess
from zoo.core.parameters import LogUniform, Parameter, Uniform

# starts are published posterior medians
BASELINE = Baseline(
    "linear-constant",
    wall="linear",
    stiffness=constant_stiffness,
    parameters=(
        Parameter("f3", Uniform(2e4, 1e5), "g cm-1 s-2", start=4.31e4, log=True),  # stiffness of every vessel
        # factors on the nominal R1, R2 and C of every outlet
        Parameter("psi1", Uniform(0.05, 2.5), start=0.29, log=True),
        Parameter("psi2", Uniform(0.05, 2.5), start=0.87, log=True),
        Parameter("c", Uniform(0.05, 2.5), start=1.34, log=True),
    ),
    prior_set="paun2020",  # for mouse-c6; other studies have their own, zoo.blood.study_priors
)
ERRORS = GaussianProcess(  # variances of the kernel's weights, s-2, and bias; its amplitude is in mmHg2
    w=LogUniform(1e4, 9e4), w_start=5.41e4, b=LogUniform(1, 500), b_start=138.0, unit="mmHg"
)

model_C = study_model("C", BASELINE, by_prior_set(ERRORS))
