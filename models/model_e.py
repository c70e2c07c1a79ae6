"""Model E: linear wall, stiffness by radius (eq. 3.5), a Gaussian process for the errors.

Paun et al. 2020, doi 10.1098/rsif.2020.0886.
"""

from __future__ import annotations

from zoo.blood.baseline import Baseline, study_model
from zoo.blood.blood_flow import radius_dependent_stiffness
from zoo.blood.errors import by_prior_set
from zoo.core.errors.gaussian_process import GaussianProcess
from zoo.core.parameters import LogUniform, Parameter, Uniform

# starts are published posterior medians
BASELINE = Baseline(
    "linear-radius",
    wall="linear",
    stiffness=radius_dependent_stiffness,
    parameters=(
        # stiffness f1 exp(f2 r0/u) + f3, u the conventions' stiffness_radius_unit_cm
        Parameter("f1", Uniform(1e3, 1e7), "g cm-1 s-2", start=51.1e5, log=True),
        Parameter("f2", Uniform(-300, -50), "1/stiffness_radius_unit_cm", start=-171.0),
        Parameter("f3", Uniform(3e4, 6e4), "g cm-1 s-2", start=4.32e4, log=True),
        # factors on the nominal R1, R2 and C of every outlet
        Parameter("psi1", Uniform(0.05, 2.5), start=0.29, log=True),
        Parameter("psi2", Uniform(0.05, 2.5), start=0.87, log=True),
        Parameter("c", Uniform(0.05, 2.5), start=1.34, log=True),
    ),
    prior_set="paun2020",  # for mouse-c6; other studies have their own, zoo.blood.study_priors
)
ERRORS = GaussianProcess(  # variances of the kernel's weights, s-2, and bias; its amplitude is in mmHg2
    w=LogUniform(1e4, 9e4), w_start=5.39e4, b=LogUniform(1, 500), b_start=138.0, unit="mmHg"
)

model_E = study_model("E", BASELINE, by_prior_set(ERRORS))
