"""Stored posteriors: the record of how a run was made, NetCDF files, and the verdict on convergence."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

RHAT_LIMIT = 1.01
"""Largest rank-normalised R-hat of a converged parameter (Vehtari et al. 2021)."""
ESS_TARGET = 400.0
"""Smallest bulk and tail effective sample size of a converged parameter (Vehtari et al. 2021)."""
MIN_CHAINS = 4
"""Fewest chains from which R-hat is trusted."""

_RECORD_ATTR = "run_record"
_DIAGNOSTICS_ATTR = "diagnostics_of_the_whole_run"
_VERSIONED = ("zoo", "pymc", "pytensor", "arviz", "numpy")


class ResultsError(ValueError):
    """A result file or an InferenceData cannot be used: one line with the file, the fault and the remedy."""


def versions() -> dict[str, str]:
    """Versions of this package, of Python and of the libraries that shape the draws.

    Returns
    -------
    dict
        Name -> version; a package that is not installed as a distribution is "unknown".
    """
    found = {"python": platform.python_version()}
    for name in _VERSIONED:
        found[name] = _version(name)
    return found


def _version(name: str) -> str:
    if name == "zoo":
        import zoo

        if hasattr(zoo, "__version__"):
            return str(zoo.__version__)
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "unknown"


@dataclass(frozen=True)
class RunRecord:
    """How a posterior was made: enough to make it again and to know what it cost.

    Parameters
    ----------
    model, study : str
        Names; `study` is empty for a model without a study.
    study_checksum : str
        Checksum of the study's data.
    conventions : dict
        The switches of the equations in force.
    solver : dict
        Options of the solver (dx in cm, tolerance in mmHg, ...).
    settings : dict
        Step method and its options, draws, tune, thin, chains, cores, target.
    seed : int
        Seed of the run; chain k draws from the k-th child of its seed sequence.
    solves, steps : int
        Solves of the flow model and steps of all chains, tuning included, mode search excluded.
    mode_evaluations : int
        Evaluations of the log-posterior spent on the search for the mode.
    failures : dict
        Failed solves by the name of their status.
    solves_per_draw, solves_per_step : float
        Solves over the stored draws of all chains, and over their steps.
    wall_seconds : float
        Duration in s, all sittings of a resumed run together.
    sittings : int
        How many times the run was started (1: never resumed).
    started : str
        Start of the first sitting, ISO 8601, UTC.
    versions : dict
        Versions of zoo, python, pymc, pytensor, arviz, numpy.
    """

    model: str
    study: str
    study_checksum: str
    conventions: dict[str, Any]
    solver: dict[str, Any]
    settings: dict[str, Any]
    seed: int
    solves: int
    steps: int
    mode_evaluations: int
    failures: dict[str, int]
    solves_per_draw: float
    solves_per_step: float
    wall_seconds: float
    sittings: int
    started: str
    versions: dict[str, str] = field(default_factory=versions)

    def to_json(self) -> str:
        """The record as one JSON object with sorted keys."""
        return json.dumps(asdict(self), sort_keys=True, default=_plain)

    @classmethod
    def from_json(cls, text: str) -> RunRecord:
        """Read a record back from `to_json`; unknown fields of a later version are dropped.

        Raises
        ------
        ResultsError
            If the text is not JSON or a field is missing.
        """
        try:
            raw = json.loads(text)
        except json.JSONDecodeError as error:
            raise ResultsError(f"run record: not JSON ({error}); sample again to get a record") from None
        if not isinstance(raw, dict):
            raise ResultsError("run record: not a JSON object; sample again to get a record")
        names = [f.name for f in fields(cls)]
        missing = [name for name in names if name not in raw]
        if missing:
            raise ResultsError(f"run record: field {missing[0]!r} is missing; sample again to get a record")
        return cls(**{name: raw[name] for name in names})

    @classmethod
    def of(cls, idata: Any) -> RunRecord:
        """The record stored in an InferenceData.

        Raises
        ------
        ResultsError
            If there is none (the draws were not made by `zoo.core.inference.sampling.sample`).
        """
        text = idata.attrs.get(_RECORD_ATTR)
        if text is None and "posterior" in idata.groups():
            text = idata.posterior.attrs.get(_RECORD_ATTR)
        if text is None:
            raise ResultsError(
                "no run record in this InferenceData; only zoo.core.inference.sampling.sample writes one"
            )
        return cls.from_json(str(text))

    def attach(self, idata: Any) -> None:
        """Store the record in an InferenceData, at the root and in the posterior group."""
        idata.attrs[_RECORD_ATTR] = self.to_json()
        if "posterior" in idata.groups():
            idata.posterior.attrs[_RECORD_ATTR] = self.to_json()


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Path):
        return value.name
    return str(value)


def save(idata: Any, path: str | Path) -> Path:
    """Write an InferenceData as one NetCDF file, through a temporary file so that a kill leaves no half file.

    Parameters
    ----------
    idata : arviz.InferenceData
        Draws, sample statistics, attributes.
    path : str or Path
        Target, by custom ending in `.nc`.

    Returns
    -------
    Path
        The written file.

    Raises
    ------
    ResultsError
        If the folder does not exist or cannot be written to.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise ResultsError(f"{path}: folder {path.parent} does not exist; create it or choose another path")
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        idata.to_netcdf(str(temporary), engine="h5netcdf")
        os.replace(temporary, path)
    except PermissionError:
        raise ResultsError(f"{path}: not writable; choose another path") from None
    finally:
        temporary.unlink(missing_ok=True)
    return path


def load(path: str | Path) -> Any:
    """Read an InferenceData from a NetCDF file into memory.

    Parameters
    ----------
    path : str or Path
        A file written by `save` or by `arviz.InferenceData.to_netcdf`.

    Returns
    -------
    arviz.InferenceData
        With a posterior group; the file is closed.

    Raises
    ------
    ResultsError
        If the file is missing, is not NetCDF, or has no posterior.
    """
    import arviz as az

    path = Path(path)
    if not path.is_file():
        raise ResultsError(f"{path}: no such file; `zoo sample MODEL STUDY -o {path.name}` writes one")
    try:
        with az.rc_context({"data.load": "eager"}):
            idata = az.from_netcdf(str(path), engine="h5netcdf")
    except (OSError, ValueError, KeyError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ResultsError(f"{path}: not a readable NetCDF file ({reason}); sample again") from None
    if "posterior" not in idata.groups():
        raise ResultsError(
            f"{path}: no group 'posterior'; `zoo sample MODEL STUDY -o {path.name}` writes one"
        )
    return idata


@dataclass(frozen=True)
class ParameterVerdict:
    """Convergence of one scalar parameter.

    Parameters
    ----------
    name : str
        Such as `c` or `chi[3]`.
    rhat, ess_bulk, ess_tail : float
        Rank-normalised split R-hat and effective sample sizes.
    passes : bool
        All three within their limits.
    """

    name: str
    rhat: float
    ess_bulk: float
    ess_tail: float
    passes: bool


@dataclass(frozen=True)
class Verdict:
    """Convergence of a posterior.

    Parameters
    ----------
    parameters : tuple of ParameterVerdict
        One for every scalar that varies.
    chains, draws : int
        Chains, and stored draws of each.
    passes : bool
        Every parameter passes and there are at least `MIN_CHAINS` chains.
    text : str
        One to three sentences: what failed and what to do.
    """

    parameters: tuple[ParameterVerdict, ...]
    chains: int
    draws: int
    passes: bool
    text: str

    def __getitem__(self, name: str) -> ParameterVerdict:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def max_rhat(self) -> float:
        """Largest R-hat (NaN counts as infinite)."""
        return max((_or(p.rhat, np.inf) for p in self.parameters), default=float("nan"))

    @property
    def min_ess(self) -> float:
        """Smallest effective sample size, bulk or tail (NaN counts as 0)."""
        return min(
            (min(_or(p.ess_bulk, 0), _or(p.ess_tail, 0)) for p in self.parameters), default=float("nan")
        )


def _or(value: float, otherwise: float) -> float:
    return float(otherwise) if np.isnan(value) else float(value)


def scalars(draws: Mapping[str, np.ndarray]) -> Iterator[tuple[str, np.ndarray]]:
    """Name and draws of every scalar element of the variables.

    Parameters
    ----------
    draws : mapping
        Variable -> array (n_chains, n_draws, ...).

    Yields
    ------
    tuple
        `name` or `name[i, j]`, and an array (n_chains, n_draws).
    """
    for name, values in draws.items():
        values = np.asarray(values)
        if values.ndim == 2:
            yield name, values
            continue
        for index in np.ndindex(values.shape[2:]):
            yield f"{name}[{', '.join(str(i) for i in index)}]", values[(slice(None), slice(None), *index)]


def ess_to_count(goal: float | None) -> float:
    """Effective sample size that a verdict asks for: a run's own goal, but never less than `ESS_TARGET`."""
    return max(goal or 0.0, ESS_TARGET)


def diagnose(draws: Mapping[str, np.ndarray], *, ess: float = ESS_TARGET) -> Verdict:
    """Judge convergence of plain arrays of draws.

    A parameter passes if R-hat <= 1.01 and both the bulk and the tail effective sample size reach `ess`.

    Parameters
    ----------
    draws : mapping
        Variable -> array (n_chains, n_draws, ...). Elements that never vary are left out.
    ess : float
        Effective sample size asked for.

    Returns
    -------
    Verdict

    References
    ----------
    Vehtari, Gelman, Simpson, Carpenter, Bürkner (2021), doi 10.1214/20-BA1221.
    """
    import arviz as az

    found: list[ParameterVerdict] = []
    shape = (0, 0)
    for name, values in scalars(draws):
        shape = (values.shape[0], values.shape[1])
        if values.size and np.all(values == values.flat[0]):
            continue
        if shape[1] < 4:
            rhat = bulk = tail = float("nan")
        else:
            rhat = float(az.rhat(values)) if shape[0] > 1 else float("nan")
            bulk = float(az.ess(values, method="bulk"))
            tail = float(az.ess(values, method="tail"))
        good = bool(rhat <= RHAT_LIMIT and bulk >= ess and tail >= ess)
        found.append(ParameterVerdict(name, rhat, bulk, tail, good))
    passes = bool(found) and all(p.passes for p in found) and shape[0] >= MIN_CHAINS
    return Verdict(tuple(found), shape[0], shape[1], passes, _verdict_text(found, *shape, ess))


def geweke(values: ArrayLike) -> Array:
    """P-values of Geweke's test: do the first 10 % and the last 50 % of a chain have one mean?

    z = (mean_a - mean_b)/sqrt(var_a/ess_a + var_b/ess_b), p = 2 (1 - Phi(|z|)).

    Parameters
    ----------
    values : array (n_chains, n_draws)
        Draws of one scalar, at least 40 of each chain.

    Returns
    -------
    array (n_chains,)
        NaN for a chain that does not vary.

    Raises
    ------
    ResultsError
        If there are too few draws.

    References
    ----------
    Geweke 1992, in Bayesian Statistics 4, pp. 169-193; the paper asks for p > 0.05.
    """
    import arviz as az
    from scipy.stats import norm

    draws = np.asarray(values, dtype=np.float64)
    n = draws.shape[1]
    if n < 40:
        raise ResultsError(f"{n} draws are too few for Geweke's test; it needs 40")
    p = np.full(len(draws), np.nan)
    for i, chain in enumerate(draws):
        if np.ptp(chain) == 0:
            continue
        parts = chain[: n // 10], chain[n - n // 2 :]
        variance = sum(part.var(ddof=1) / float(az.ess(part[None], method="mean")) for part in parts)
        p[i] = 2 * norm.sf(abs(parts[0].mean() - parts[1].mean()) / np.sqrt(variance))
    return p


def mpsrf(draws: Mapping[str, np.ndarray]) -> float:
    """Multivariate potential scale reduction factor of Brooks and Gelman.

    (n - 1)/n + (m + 1)/m lambda, lambda the largest eigenvalue of W^-1 B/n, with W the covariance within
    and B/n the covariance between m chains of n draws. It is on the scale of variances.

    Parameters
    ----------
    draws : mapping
        Variable -> array (n_chains, n_draws, ...). Elements that never vary are left out.

    Returns
    -------
    float
        1 when the chains agree; NaN for a single chain.

    References
    ----------
    Brooks and Gelman 1998, eq. (4.1), doi 10.1080/10618600.1998.10474787; the paper asks for <= 1.1.
    """
    from scipy.linalg import eigh

    columns = [v for _, v in scalars(draws) if v.size and np.ptp(v) > 0]
    if not columns or len(columns[0]) < 2:
        return float("nan")
    x = np.stack(columns, axis=-1).astype(np.float64)
    x /= x.std(axis=(0, 1))
    m, n, d = x.shape
    within = np.mean([np.cov(chain.T).reshape(d, d) for chain in x], axis=0)
    between = np.cov(x.mean(axis=1).T).reshape(d, d)
    return float((n - 1) / n + (m + 1) / m * eigh(between, within, eigvals_only=True)[-1])


def verdict(idata: Any, *, ess: float = ESS_TARGET, var_names: list[str] | None = None) -> Verdict:
    """Judge convergence of an InferenceData.

    Parameters
    ----------
    idata : arviz.InferenceData
        With a posterior group.
    ess : float
        Effective sample size asked for.
    var_names : list of str, optional
        Variables to judge; all of the posterior's if absent.

    Returns
    -------
    Verdict

    Raises
    ------
    ResultsError
        If there is no posterior or a variable is not in it.
    """
    if "posterior" not in idata.groups():
        raise ResultsError("no group 'posterior' in this InferenceData; sample first")
    posterior = idata.posterior
    names = list(posterior.data_vars) if var_names is None else var_names
    for name in names:
        if name not in posterior:
            raise ResultsError(
                f"no parameter {name!r} in the posterior; it has {', '.join(posterior.data_vars)}"
            )
    return diagnose({str(n): posterior[n].transpose("chain", "draw", ...).to_numpy() for n in names}, ess=ess)


@dataclass(frozen=True)
class Diagnostics:
    """What the checks of a whole run say.

    Parameters
    ----------
    verdict : Verdict
        R-hat and effective sample sizes of every scalar.
    mpsrf : float
        Multivariate scale reduction factor, see `mpsrf`.
    geweke : dict
        Scalar -> p-value of Geweke's test for each chain; empty with fewer than 40 draws a chain.
    acceptance : tuple of float
        Share of accepted steps of each chain, tuning left out; empty when it was not recorded.
    """

    verdict: Verdict
    mpsrf: float
    geweke: dict[str, tuple[float, ...]]
    acceptance: tuple[float, ...]

    def to_json(self) -> str:
        """All of it as one JSON object."""
        return json.dumps(asdict(self), default=_plain)

    @classmethod
    def from_json(cls, text: str) -> Diagnostics:
        """Read back from `to_json`.

        Raises
        ------
        ResultsError
            If the text is not what `to_json` writes.
        """
        try:
            raw = json.loads(text)
            judged = raw["verdict"]
            parameters = tuple(ParameterVerdict(**p) for p in judged.pop("parameters"))
            p_values = {name: tuple(p) for name, p in raw["geweke"].items()}
            return cls(Verdict(parameters, **judged), raw["mpsrf"], p_values, tuple(raw["acceptance"]))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ResultsError(
                f"diagnostics of a run: not readable ({error}); slim the posterior again"
            ) from None


def diagnostics(idata: Any) -> Diagnostics:
    """Checks of a run: those that `slim` stored of the whole run, or else of the draws that are here.

    Parameters
    ----------
    idata : arviz.InferenceData
        With a posterior group.

    Returns
    -------
    Diagnostics

    Raises
    ------
    ResultsError
        If there is no posterior, or stored diagnostics are not readable.
    """
    stored = idata.attrs.get(_DIAGNOSTICS_ATTR)
    if stored is not None:
        return Diagnostics.from_json(str(stored))
    judged = verdict(idata)
    posterior = idata.posterior
    draws = {str(n): posterior[n].transpose("chain", "draw", ...).to_numpy() for n in posterior.data_vars}
    varying = {p.name for p in judged.parameters}
    p_values = {}
    if judged.draws >= 40:
        p_values = {
            name: tuple(geweke(values).tolist()) for name, values in scalars(draws) if name in varying
        }
    acceptance: tuple[float, ...] = ()
    if "sample_stats" in idata.groups() and "accepted" in idata.sample_stats:
        accepted = idata.sample_stats["accepted"]
        acceptance = tuple(
            accepted.mean([d for d in accepted.dims if d != "chain"]).to_numpy().astype(float).tolist()
        )
    return Diagnostics(judged, mpsrf(draws), p_values, acceptance)


def judged(idata: Any, *, var_names: list[str] | None = None) -> Verdict:
    """Verdict of the whole run if `slim` stored it, or else on the draws that are here.

    Parameters
    ----------
    idata : arviz.InferenceData
        With a posterior group.
    var_names : list of str, optional
        Variables to judge where nothing is stored; all if absent.

    Returns
    -------
    Verdict
    """
    stored = idata.attrs.get(_DIAGNOSTICS_ATTR)
    if stored is not None:
        return Diagnostics.from_json(str(stored)).verdict
    return verdict(idata, var_names=var_names)


def slim(idata: Any, n_draws: int = 1000) -> Any:
    """A posterior small enough to keep beside the code: evenly spaced draws in single precision.

    Only parameters, their coordinates, the run record and the diagnostics of the whole run stay. Observed
    data, sample statistics and waveforms (variables over time) do not.

    Parameters
    ----------
    idata : arviz.InferenceData
        From `zoo.core.inference.sampling.sample`; left as it is.
    n_draws : int
        Draws of all chains together, rounded up to the same number in each.

    Returns
    -------
    arviz.InferenceData
        With the group posterior.

    Raises
    ------
    ResultsError
        If there is no posterior, no run record, or fewer than one draw is asked for.
    """
    import arviz as az

    if n_draws < 1:
        raise ResultsError(f"n_draws = {n_draws}: keep at least one draw")
    found, record = diagnostics(idata), RunRecord.of(idata)
    posterior = idata.posterior
    available = posterior.sizes["draw"]
    wanted = min(available, -(-n_draws // posterior.sizes["chain"]))
    kept = np.linspace(0, available - 1, wanted).round().astype(int)
    names = [name for name in posterior.data_vars if "time" not in posterior[name].dims]
    few = posterior[names].isel(draw=kept).drop_vars("time", errors="ignore").astype(np.float32)
    created = posterior.attrs.get("created_at")
    few.attrs = {} if created is None else {"created_at": created}
    small = az.InferenceData(posterior=few, attrs={_DIAGNOSTICS_ATTR: found.to_json()})
    record.attach(small)
    return small


def _verdict_text(found: list[ParameterVerdict], chains: int, draws: int, ess: float) -> str:
    if not found:
        return "not converged: no parameter varies; check that the chains moved at all."
    rhat = max(found, key=lambda p: _or(p.rhat, np.inf))
    bulk = min(found, key=lambda p: _or(p.ess_bulk, 0))
    tail = min(found, key=lambda p: _or(p.ess_tail, 0))
    worst = (
        f"R-hat at most {rhat.rhat:.3f} ({rhat.name}), bulk ESS at least {bulk.ess_bulk:.0f} ({bulk.name}), "
        f"tail ESS at least {tail.ess_tail:.0f} ({tail.name})"
    )
    failing = [p for p in found if not p.passes]
    few = f" {chains} chains: at least {MIN_CHAINS} are needed to trust R-hat." if chains < MIN_CHAINS else ""
    if not failing:
        return f"{'not ' if few else ''}converged: {worst}.{few}"
    reasons = []
    for p in failing[:4]:
        faults = []
        if not p.rhat <= RHAT_LIMIT:
            faults.append(f"R-hat {p.rhat:.3f} > {RHAT_LIMIT}")
        if not p.ess_bulk >= ess:
            faults.append(f"bulk ESS {p.ess_bulk:.0f} < {ess:.0f}")
        if not p.ess_tail >= ess:
            faults.append(f"tail ESS {p.ess_tail:.0f} < {ess:.0f}")
        reasons.append(f"{p.name}: {', '.join(faults)}")
    if len(failing) > 4:
        reasons.append(f"and {len(failing) - 4} more")
    return f"not converged: {'; '.join(reasons)}.{few} {_advice(failing, draws, ess)}"


def _advice(failing: list[ParameterVerdict], draws: int, ess: float) -> str:
    least = min(min(_or(p.ess_bulk, 0), _or(p.ess_tail, 0)) for p in failing)
    factor = ess / least if least > 0 else np.inf
    if max(_or(p.rhat, np.inf) for p in failing) > 1.2:
        return "The chains have not met: tune for longer, and look at the trace for several modes."
    if not np.isfinite(factor) or factor > 20:
        return "Too few draws to say more: draw many more."
    factor = max(
        factor, 1.5
    )  # R-hat alone can fail with enough draws; half as many again settles most of those
    return (
        f"Draw about {factor:.1f} times as many (some {int(np.ceil(draws * factor / 100) * 100)} per chain)."
    )
