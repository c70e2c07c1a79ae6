"""Model G: linear wall, a stiffness for each vessel, correlated errors.

Paun et al. 2020, doi 10.1098/rsif.2020.0886.
"""

from __future__ import annotations

import pymc as pm

from zoo.blood.conventions import Conventions
from zoo.blood.op import blood_flow
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Study
from zoo.core.errors.likelihood import gp_errors, study_model

# published posterior medians, but for the stiffnesses and their population: all vessels are equal
SUGGESTED = {
    "m_chi": 5e4,
    "v_chi": 2.0,
    "chi": 5e4,
    "psi1": 0.46,
    "psi2": 0.86,
    "c": 1.12,
    "w": 4.65e4,
    "b": 161.0,
}


def model_G(
    study: Study, *, options: SolverOptions | None = None, conventions: Conventions | None = None
) -> pm.Model:
    """Linear wall, a stiffness for each vessel from one normal population, a Gaussian process for the errors.

    With these hyperpriors 90 % of the prior of each stiffness lies in (2e4, 1e5), as Table 2 asks; how the
    paper divides that between the population's mean and its variance is only in its supplement, as are the
    parameters of its beta priors of psi1, psi2 and c, here uniform.
    """
    with study_model("G", study, SUGGESTED) as model:
        m_chi = pm.Normal("m_chi", 6e4, 1.5e4)  # population mean of the stiffness, g cm-1 s-2
        v_chi = pm.InverseGamma("v_chi", 3, 7.78)  # its variance, (1e4 g cm-1 s-2)^2
        chi = pm.Normal(  # each vessel's own; sampled as its logarithm, no wall has a negative one
            "chi", m_chi, 1e4 * pm.math.sqrt(v_chi), dims="vessel", transform=pm.distributions.transforms.log
        )
        psi1 = pm.Uniform("psi1", 0.05, 2.5)  # factors on the nominal R1, R2 and C of every outlet
        psi2 = pm.Uniform("psi2", 0.05, 2.5)
        c = pm.Uniform("c", 0.05, 2.5)

        mean, ok = blood_flow(study, "linear", chi, psi1, psi2, c, options=options, conventions=conventions)

        gp_errors(mean, ok, study, w_range=(1e4, 9e4), b_range=(1, 500))  # w, b log-uniform
    return model
