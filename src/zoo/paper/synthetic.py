"""Synthetic studies: model E's family with correlated errors (section 2.2 of Paun et al. 2020).

`python -m zoo.paper.synthetic FOLDER` makes the embedded study `demo` again; with `demo-gap` after it the
one for the diagnosis, whose wall does what no baseline has.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from zoo.blood.ejection import PERIOD_S, ejection
from zoo.blood.network import Network, stiffness_profile
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import Series, Study, read_network, save_study
from zoo.core.errors.gaussian_process import NOISE, neural_network_kernel

Array = NDArray[np.float64]

WHOLE_DRAWS = 100
"""Draws of whole error series before only their means are drawn until they keep the order (the same law)."""


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


def correlated_errors(
    rng: np.random.Generator,
    time_s: Array,
    w: float,
    b: float,
    n_series: int,
    means: ArrayLike | None = None,
) -> Array:
    """Independent draws of the paper's error process (neural-network kernel), given their means if these are.

    Parameters
    ----------
    rng : numpy.random.Generator
    time_s : array (n_times,)
    w, b : float
        Of the kernel.
    n_series : int
    means : array (n_series,), optional
        Mean over the beat of each series, mmHg.

    Returns
    -------
    array (n_series, n_times)
        mmHg.
    """
    covariance = _error_covariance(time_s, w, b)
    errors: Array = rng.standard_normal((n_series, len(time_s))) @ np.linalg.cholesky(covariance).T
    if means is None:
        return errors
    # conditioning on the mean: move each draw along the covariance with the mean
    along = covariance.mean(axis=1)
    shift = np.asarray(means) - errors.mean(axis=1)
    return np.asarray(errors + shift[:, None] * along / along.mean())


def whitened(residuals: Array, time_s: Array, truth: Truth) -> Array:
    """Residuals (n_series, n_times) in units of a truth's errors: z = L^-1 r, L L' the errors' covariance."""
    lower = np.linalg.cholesky(_error_covariance(time_s, truth.w, truth.b))
    return np.asarray(solve_triangular(lower, residuals.T, lower=True).T)


def _error_covariance(time_s: Array, w: float, b: float) -> Array:
    return neural_network_kernel(time_s, w, b) + NOISE * np.eye(len(time_s))


def ordered_error_means(
    rng: np.random.Generator,
    network: Network,
    vessels: Sequence[int],
    pressure: ArrayLike,
    sd: float,
    max_draws: int = 100_000_000,
) -> Array:
    """Means of independent errors that keep the mean pressure falling towards the periphery.

    Normal draws of all vessels' means together are rejected until every observed vessel lies below its
    nearest observed ancestor. A rejection of whole error series would accept the same means, since the
    condition sees nothing else, but could not be afforded for many vessels.

    Parameters
    ----------
    rng : numpy.random.Generator
    network : Network
    vessels : sequence of int
        Observed vessels.
    pressure : array (n_series,)
        Mean pressure without errors, mmHg.
    sd : float
        Standard deviation of an error's mean over the beat, mmHg.
    max_draws : int
        Draws after which to give up.

    Returns
    -------
    array (n_series,)
        mmHg.

    Raises
    ------
    RuntimeError
        If none of the draws keeps the order.

    References
    ----------
    Paun et al. 2020, section 2.2, doi 10.1098/rsif.2020.0886.
    """
    clean = np.asarray(pressure, dtype=float)
    above = _observed_ancestors(network, vessels)
    below = np.array([i for i, k in enumerate(above) if k is not None], dtype=int)
    parents = np.array([k for k in above if k is not None], dtype=int)
    block = 1 if len(below) == 0 else 200_000
    drawn = 0
    while drawn < max_draws:
        means = sd * rng.standard_normal((min(block, max_draws - drawn), len(clean)))
        drawn += len(means)
        noisy = clean + means
        kept = np.flatnonzero(np.all(noisy[:, below] < noisy[:, parents], axis=1))
        if len(kept):
            return np.asarray(means[kept[0]])
    raise RuntimeError(
        f"{max_draws} draws of the errors all broke the fall of pressure towards the periphery; "
        "observe fewer vessels, or lower b"
    )


def _observed_ancestors(network: Network, vessels: Sequence[int]) -> list[int | None]:
    """For each observed vessel the place in `vessels` of its nearest observed ancestor."""
    place = {int(vessel): i for i, vessel in enumerate(vessels)}
    found: list[int | None] = []
    for vessel in vessels:
        k = network.parent[network.index(vessel)]
        while k >= 0 and int(network.ids[k]) not in place:
            k = network.parent[k]
        found.append(place[int(network.ids[k])] if k >= 0 else None)
    return found


def falls_towards_periphery(network: Network, vessels: Sequence[int], pressure: Array) -> bool:
    """Whether the mean pressure of every observed vessel lies below that of its nearest observed ancestor."""
    mean = np.asarray(pressure).mean(axis=1)
    return all(k is None or mean[i] < mean[k] for i, k in enumerate(_observed_ancestors(network, vessels)))


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
    for _ in range(WHOLE_DRAWS):
        noisy = clean + correlated_errors(rng, times, truth.w, truth.b, len(sites))
        if not ordered or falls_towards_periphery(network, vessels, noisy):
            break
    else:
        sd = float(np.sqrt(_error_covariance(times, truth.w, truth.b).mean()))
        means = ordered_error_means(rng, network, vessels, clean.mean(axis=1), sd)
        noisy = clean + correlated_errors(rng, times, truth.w, truth.b, len(sites), means)
    series = tuple(
        Series(vessel, position, "pressure_mmHg", np.round(row, 4))
        for (vessel, position), row in zip(sites, noisy, strict=True)
    )
    return replace(base, name=name, time_s=times, series=series)


def signal_to_noise(study: Study, truth: Truth | None = None) -> float:
    """Mean square of the observed pressure over the variance of the errors at mid-beat."""
    truth = truth or Truth()
    variance = neural_network_kernel(np.array([0.5 * study.period_s]), truth.w, truth.b)[0, 0]
    return float(np.mean(study.values**2) / variance)


DEMO_SITES = ((1, 0.0), (2, 0.5), (3, 0.5))
DEMO_SEED = 2020
DEMO_TIMES = 256


def demo_study() -> Study:
    """The embedded study: the mouse's vessels, our own inflow, pressure in the MPA and its daughters."""
    blood, vessels = read_network(Path(str(files("zoo") / "data" / "mouse-c6" / "network.toml")))
    time, flow = ejection()
    base = Study("demo", PERIOD_S, blood, vessels, time, np.round(flow, 6), np.array([]), ())
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
        sys.exit(f"usage: python -m zoo.paper.synthetic FOLDER [{'|'.join(EMBEDDED)}]")
    made = EMBEDDED[chosen]()
    save_study(made, sys.argv[1])
    print(f"{sys.argv[1]}: {len(made.series)} series of {len(made.time_s)} samples")
