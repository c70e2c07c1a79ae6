"""Model G: linear wall, a stiffness for each vessel from one normal population, correlated errors.

With these hyperpriors 90 % of the prior of each stiffness lies in (2e4, 1e5), as Table 2 asks; how the
paper divides that between the population's mean and its variance is only in its supplement, as are the
parameters of its beta priors of psi1, psi2 and c, here uniform.

Paun et al. 2020, doi 10.1098/rsif.2020.0886.
"""

from __future__ import annotations

from zoo.blood.baseline import Baseline, study_model
from zoo.blood.blood_flow import stiffness_of_each_vessel
from zoo.blood.errors import by_prior_set
from zoo.core.errors.gaussian_process import GaussianProcess
from zoo.core.parameters import InverseGamma, LogUniform, Normal, Parameter, Population, Uniform

# starts are published posterior medians, but for the stiffnesses, here alike in all vessels
BASELINE = Baseline(
    "linear-vessels",
    wall="linear",
    stiffness=stiffness_of_each_vessel,
    parameters=(
        # mean of the vessels' population of stiffnesses, and its variance in (1e4 g cm-1 s-2)^2
        Parameter("m_chi", Normal(6e4, 1.5e4), "g cm-1 s-2", start=5e4, hyper=True),
        Parameter("v_chi", InverseGamma(3, 7.78), start=2.0, log=True, hyper=True),
        # each vessel's own; sampled as its logarithm, no wall has a negative one
        Parameter(
            "chi", Population("m_chi", "v_chi", unit=1e4), "g cm-1 s-2", start=5e4, log=True, dims="vessel"
        ),
        # factors on the nominal R1, R2 and C of every outlet
        Parameter("psi1", Uniform(0.05, 2.5), start=0.46, log=True),
        Parameter("psi2", Uniform(0.05, 2.5), start=0.86, log=True),
        Parameter("c", Uniform(0.05, 2.5), start=1.12, log=True),
    ),
    prior_set="paun2020",  # for mouse-c6; other studies have their own, zoo.blood.study_priors
)
ERRORS = GaussianProcess(  # variances of the kernel's weights, s-2, and bias; its amplitude is in mmHg2
    w=LogUniform(1e4, 9e4), w_start=4.65e4, b=LogUniform(1, 500), b_start=161.0, unit="mmHg"
)

model_G = study_model("G", BASELINE, by_prior_set(ERRORS))
