"""Model A: linear wall, the same stiffness in every vessel, independent errors.

Paun et al. 2020, doi 10.1098/rsif.2020.0886.
"""

from __future__ import annotations

from zoo.blood.baseline import Baseline, study_model
from zoo.blood.blood_flow import constant_stiffness
from zoo.blood.errors import by_prior_set
from zoo.core.errors.independent import Independent
from zoo.core.parameters import InverseGamma, Parameter, Uniform

# starts are published posterior medians; sigma2's is the published sum of squared errors over 512 samples
BASELINE = Baseline(
    "linear-constant",
    wall="linear",
    stiffness=constant_stiffness,
    parameters=(
        Parameter("f3", Uniform(2e4, 1e5), "g cm-1 s-2", start=5.17e4, log=True),  # stiffness of every vessel
        # factors on the nominal R1, R2 and C of every outlet
        Parameter("psi1", Uniform(0.05, 2.5), start=0.21, log=True),
        Parameter("psi2", Uniform(0.05, 2.5), start=0.88, log=True),
        Parameter("c", Uniform(0.05, 2.5), start=1.44, log=True),
    ),
    prior_set="paun2020",  # for mouse-c6; other studies have their own, zoo.blood.study_priors
)
ERRORS = Independent(sigma2=InverseGamma(0.001, 0.001), start=0.13)  # variance, mmHg2

model_A = study_model("A", BASELINE, by_prior_set(ERRORS))
