"""Model D: linear wall, stiffness by radius (eq. 3.5), independent errors.

Paun et al. 2020, doi 10.1098/rsif.2020.0886.
"""

from __future__ import annotations

from zoo.blood.baseline import Baseline, study_model
from zoo.blood.blood_flow import radius_dependent_stiffness
from zoo.blood.errors import by_prior_set
from zoo.core.errors.independent import Independent
from zoo.core.parameters import InverseGamma, Parameter, Uniform

# starts are published posterior medians; sigma2's is the published sum of squared errors over 512 samples
BASELINE = Baseline(
    "linear-radius",
    wall="linear",
    stiffness=radius_dependent_stiffness,
    parameters=(
        # stiffness f1 exp(f2 r0/u) + f3, u the conventions' stiffness_radius_unit_cm
        Parameter("f1", Uniform(1e3, 1e7), "g cm-1 s-2", start=52.6e5, log=True),
        Parameter("f2", Uniform(-300, -50), "1/stiffness_radius_unit_cm", start=-162.0),
        Parameter("f3", Uniform(3e4, 6e4), "g cm-1 s-2", start=5.17e4, log=True),
        # factors on the nominal R1, R2 and C of every outlet
        Parameter("psi1", Uniform(0.05, 2.5), start=0.21, log=True),
        Parameter("psi2", Uniform(0.05, 2.5), start=0.89, log=True),
        Parameter("c", Uniform(0.05, 2.5), start=1.45, log=True),
    ),
    prior_set="paun2020",  # for mouse-c6; other studies have their own, zoo.blood.study_priors
)
ERRORS = Independent(sigma2=InverseGamma(0.001, 0.001), start=0.125)  # variance, mmHg2

model_D = study_model("D", BASELINE, by_prior_set(ERRORS))
