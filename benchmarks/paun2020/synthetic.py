"""Synthetic studies: model E's family with correlated errors (section 2.2 of Paun et al. 2020).

`python -m benchmarks.paun2020.synthetic FOLDER` makes the embedded study `demo` again; with `demo-gap` after
it the one for the diagnosis, whose wall does what no baseline has.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from zoo.blood.ejection import PERIOD_S, ejection
from zoo.blood.network import Network, stiffness_profile
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import Series, Study, save_study
from zoo.blood.study.tree import read_network_file
from zoo.core.errors.gaussian_process import NOISE, neural_network_kernel

Array = NDArray[np.float64]

MOST_DRAWS = 100
"""Draws of the errors of all sites until they keep the order of the pressures."""


@dataclass(frozen=True)
class Truth:
    """Parameters that a synthetic study was made with (units of the paper's Table 2)."""

    f1: float = 2.0e4
    f2: float = -100.0
    f3: float = 4.0e4
    psi1: float = 0.30
    psi2: float = 0.60
    c: float = 1.70
    w: float = 5.4e4
    b: float = 137.0


def correlated_errors(rng: np.random.Generator, time_s: Array, w: float, b: float, n_series: int) -> Array:
    """Independent draws (n_series, n_times) of the paper's error process (neural-network kernel), mmHg."""
    factor = np.linalg.cholesky(_error_covariance(time_s, w, b))
    return np.asarray(rng.standard_normal((n_series, len(time_s))) @ factor.T)


def whitened(residuals: Array, time_s: Array, truth: Truth) -> Array:
    """Residuals (n_series, n_times) in units of a truth's errors: z = L^-1 r, L L' the errors' covariance."""
    lower = np.linalg.cholesky(_error_covariance(time_s, truth.w, truth.b))
    return np.asarray(solve_triangular(lower, residuals.T, lower=True).T)


def _error_covariance(time_s: Array, w: float, b: float) -> Array:
    return neural_network_kernel(time_s, w, b) + NOISE * np.eye(len(time_s))


def falls_towards_periphery(network: Network, vessels: Sequence[int], pressure: Array) -> bool:
    """Whether the mean pressure of every observed vessel lies below that of its nearest observed ancestor."""
    mean = dict(zip(vessels, np.asarray(pressure).mean(axis=1), strict=True))
    for vessel in vessels:
        k = network.parent[network.index(vessel)]
        while k >= 0 and int(network.ids[k]) not in mean:
            k = network.parent[k]
        if k >= 0 and mean[vessel] >= mean[int(network.ids[k])]:
            return False
    return True


def synthetic_study(
    base: Study,
    *,
    name: str,
    truth: Truth | None = None,
    sites: Sequence[tuple[int, float]] = ((1, 0.0),),
    n_times: int = 512,
    seed: int = 0,
    options: SolverOptions | None = None,
    ordered: bool = True,
) -> Study:
    """A study with the vessels and inflow of `base` and pressures made by model E plus correlated errors.

    The errors of all sites are drawn together until the mean pressure falls towards the periphery, unless
    `ordered` is false.  The solver runs on a grid four times finer than its default unless `options` say
    otherwise, so that the data are not its own.

    Raises
    ------
    RuntimeError
        If no draw of the errors keeps the pressure's order.

    References
    ----------
    Paun et al. 2020, section 2.2, doi 10.1098/rsif.2020.0886.
    """
    truth = truth or Truth()
    rng = np.random.default_rng(seed)
    network = Network.from_study(base)
    times = np.arange(n_times) * base.period_s / n_times
    options = options or SolverOptions(refine=4, tolerance_mmHg=1e-6)
    lag = base.conventions.sample_lag_beats * base.period_s
    solver = Solver.for_study(base, series=sites, times_s=times + lag, options=options)
    unit = base.conventions.stiffness_radius_unit_cm
    stiffness = stiffness_profile(network.radius_in_cm, truth.f1, truth.f2, truth.f3, unit)
    clean = solver.solve(stiffness, psi1=truth.psi1, psi2=truth.psi2, c=truth.c).pressure_mmHg
    vessels = [vessel for vessel, _ in sites]
    for _ in range(MOST_DRAWS):
        noisy = clean + correlated_errors(rng, times, truth.w, truth.b, len(sites))
        if not ordered or falls_towards_periphery(network, vessels, noisy):
            break
    else:
        raise RuntimeError(
            f"{MOST_DRAWS} draws of the errors all broke the fall of pressure towards the periphery; "
            "observe fewer vessels, or lower b"
        )
    series = tuple(
        Series(vessel, position, "pressure_mmHg", np.round(row, 4))
        for (vessel, position), row in zip(sites, noisy, strict=True)
    )
    return replace(base, name=name, time_s=times, series=series)


DEMO_SITES = ((1, 0.0), (2, 0.5), (3, 0.5))
DEMO_SEED = 2020
DEMO_TIMES = 256


def demo_study() -> Study:
    """The embedded study: the mouse's vessels, our own inflow, pressure in the MPA and its daughters."""
    tree = read_network_file(Path(str(files("zoo") / "data" / "mouse-c6" / "network.toml")))
    time, flow = ejection()
    base = Study(
        "demo", PERIOD_S, tree.given["blood"], tree.vessels, time, np.round(flow, 6), np.array([]), ()
    )
    return synthetic_study(base, name="demo", sites=DEMO_SITES, n_times=DEMO_TIMES, seed=DEMO_SEED)


GAP_TRUTH: Mapping[str, float] = {"f3": 4.5e4, "psi1": 0.35, "psi2": 0.7, "c": 1.5}
"""Parameters of linear-constant that `demo-gap` was made with."""
GAP_EFFECT, GAP_TAU_S = "viscoelastic-wall", 0.004
"""What `demo-gap` has besides: p = p_e + tau dp_e/dt."""
GAP_TIMES, GAP_NOISE_MMHG, GAP_SEED = 128, 0.1, 7


def demo_gap_study() -> Study:
    """The embedded study for the diagnosis: the tree and inflow of `demo`, a viscoelastic wall, white noise.

    Pressure at the sites of `demo` by linear-constant with `GAP_EFFECT`, on a grid four times finer than the
    default, and independent normal errors of `GAP_NOISE_MMHG`.
    """
    from zoo.blood.baseline import get_baseline
    from zoo.blood.effects import CATALOGUE
    from zoo.core.effects import with_effects
    from zoo.core.forward import Outputs

    bare = demo_study()
    times = np.arange(GAP_TIMES) * bare.period_s / GAP_TIMES
    flow = get_baseline("linear-constant").forward(bare, options=SolverOptions(refine=4, tolerance_mmHg=1e-6))
    model = with_effects(flow, [CATALOGUE[GAP_EFFECT].at()])
    theta = np.array([GAP_TRUTH[p.name] for p in flow.parameters] + [GAP_TAU_S])
    sites = tuple((vessel, position, "pressure_mmHg") for vessel, position in DEMO_SITES)
    clean = model.solve(model.configure(theta), Outputs(sites, times))
    noisy = clean + GAP_NOISE_MMHG * np.random.default_rng(GAP_SEED).standard_normal(clean.shape)
    series = tuple(Series(*site, np.round(row, 4)) for site, row in zip(sites, noisy, strict=True))
    return replace(bare, name="demo-gap", time_s=times, series=series)


EMBEDDED = {"demo": demo_study, "demo-gap": demo_gap_study}

if __name__ == "__main__":
    chosen = sys.argv[2] if len(sys.argv) == 3 else "demo"
    if len(sys.argv) not in (2, 3) or chosen not in EMBEDDED:
        sys.exit(f"usage: python -m benchmarks.paun2020.synthetic FOLDER [{'|'.join(EMBEDDED)}]")
    made = EMBEDDED[chosen]()
    save_study(made, sys.argv[1])
    print(f"{sys.argv[1]}: {len(made.series)} series of {len(made.time_s)} samples")
