"""Have the chains converged: R-hat, effective sample sizes, and the verdict on them in words."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from zoo.core.arviz_lines import dataset, effective, split_rhat
from zoo.core.inference.elements import arrays, scalars
from zoo.core.inference.prior_check import PriorCheck, model_check
from zoo.core.inference.record import ResultsError, RunRecord, plain

RHAT_LIMIT = 1.01
"""Largest rank-normalised R-hat of a converged parameter (Vehtari et al. 2021)."""
ESS_TARGET = 400.0
"""Smallest bulk and tail effective sample size of a converged parameter (Vehtari et al. 2021)."""
FIRST_CHECK = 500
"""Draws of each chain after which convergence is first judged, where no number of draws is given."""
MIN_CHAINS = 4
"""Fewest chains from which R-hat is trusted."""

DIAGNOSTICS_ATTR = "diagnostics_of_the_whole_run"
"""Attribute of a posterior with fewer draws than were made: the checks of all of them."""


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

    @property
    def worst_rhat(self) -> float:
        """R-hat, infinite where it is not a number."""
        return float(np.inf) if np.isnan(self.rhat) else self.rhat

    @property
    def least_ess(self) -> float:
        """The smaller effective sample size, 0 where one is not a number."""
        return float(np.nan_to_num([self.ess_bulk, self.ess_tail]).min())


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
        Every parameter that the data inform passes and there are at least `MIN_CHAINS` chains.
    text : str
        A few sentences: bounds that the posterior leans on first, then what failed and what to do.
    bounds : tuple of str
        One warning for each bound of a prior that the posterior leans on, without a full stop.
    uninformed : tuple of str
        Scalars whose posterior is like their prior: their R-hat and effective sample sizes are told, but
        do not make a run unconverged.
    """

    parameters: tuple[ParameterVerdict, ...]
    chains: int
    draws: int
    passes: bool
    text: str
    bounds: tuple[str, ...] = ()
    uninformed: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> ParameterVerdict:
        return {parameter.name: parameter for parameter in self.parameters}[name]

    @property
    def max_rhat(self) -> float:
        """Largest R-hat (NaN counts as infinite)."""
        return max((p.worst_rhat for p in self.parameters), default=float("nan"))

    @property
    def min_ess(self) -> float:
        """Smallest effective sample size, bulk or tail (NaN counts as 0)."""
        return min((p.least_ess for p in self.parameters), default=float("nan"))


def ess_to_count(goal: float | None) -> float:
    """Effective sample size that a verdict asks for: a run's own goal, but never less than `ESS_TARGET`."""
    return max(goal or 0.0, ESS_TARGET)


def check_convergence(
    draws: Mapping[str, np.ndarray], *, ess: float = ESS_TARGET, priors: PriorCheck | None = None
) -> Verdict:
    """Judge convergence of plain arrays of draws.

    A parameter passes if R-hat <= 1.01 and both the bulk and the tail effective sample size reach `ess`.

    Parameters
    ----------
    draws : mapping
        Variable -> array (n_chains, n_draws, ...). Elements that never vary are left out.
    ess : float
        Effective sample size asked for.
    priors : PriorCheck, optional
        What the draws say of their prior.

    Returns
    -------
    Verdict

    References
    ----------
    Vehtari, Gelman, Simpson, Carpenter, Bürkner (2021), doi 10.1214/20-BA1221.
    """
    found: list[ParameterVerdict] = []
    shape = (0, 0)
    for name, values in scalars(draws):
        shape = (values.shape[0], values.shape[1])
        if values.size and np.all(values == values.flat[0]):
            continue
        if shape[1] < 4:
            rhat = bulk = tail = float("nan")
        else:
            rhat = split_rhat(values) if shape[0] > 1 else float("nan")
            bulk = effective(values)
            tail = effective(values, "tail")
        good = bool(rhat <= RHAT_LIMIT and bulk >= ess and tail >= ess)
        found.append(ParameterVerdict(name, rhat, bulk, tail, good))
    return _judgement(tuple(found), *shape, ess, priors or PriorCheck())


def _judgement(
    found: tuple[ParameterVerdict, ...], chains: int, draws: int, ess: float, priors: PriorCheck
) -> Verdict:
    """A verdict on parameters, those that the data do not inform set apart."""
    informed = [p for p in found if p.name not in priors.uninformed] or list(found)
    aside = [p for p in found if p not in informed]
    passes = bool(informed) and all(p.passes for p in informed) and chains >= MIN_CHAINS
    text = _verdict_text(informed, chains, draws, ess)
    warned = "".join(f"{warning}. " for warning in [*priors.warnings, priors.numerical] if warning)
    text = text[:1].upper() + text[1:] if warned else text
    if aside:
        rhat, least = max(aside, key=lambda p: p.worst_rhat), min(aside, key=lambda p: p.least_ess)
        text += (
            f" Not informed by the data, posterior like prior: {', '.join(p.name for p in aside)} (R-hat at "
            f"most {rhat.rhat:.3f}, ESS at least {min(least.ess_bulk, least.ess_tail):.0f})."
        )
    names = tuple(p.name for p in aside)
    return Verdict(found, chains, draws, passes, warned + text, tuple(priors.warnings), names)


def prior_check(idata: Any, model: Any = None) -> PriorCheck | None:
    """What a posterior says of its prior: as its record has it, or else from its draws and its model.

    Parameters
    ----------
    idata : arviz.InferenceData
        With a posterior group.
    model : pymc.Model, optional
        That the draws are of, for posteriors whose record does not say.

    Returns
    -------
    PriorCheck or None
        None where neither is there.
    """
    try:
        stored = RunRecord.of(idata).prior_check
    except ResultsError:
        stored = None
    if stored is not None:
        return PriorCheck.from_dict(stored)
    return model_check(model, arrays(idata))


def verdict(
    idata: Any, *, ess: float = ESS_TARGET, var_names: list[str] | None = None, model: Any = None
) -> Verdict:
    """Judge convergence of an InferenceData.

    Parameters
    ----------
    idata : arviz.InferenceData
        With a posterior group.
    ess : float
        Effective sample size asked for.
    var_names : list of str, optional
        Variables to judge; all of the posterior's if absent.
    model : pymc.Model, optional
        That the draws are of: its priors are taken where the record says nothing of them.

    Returns
    -------
    Verdict

    Raises
    ------
    ResultsError
        If there is no posterior or a variable is not in it.
    """
    if "posterior" not in idata:
        raise ResultsError("no group 'posterior' in this InferenceData; sample first")
    posterior = dataset(idata)
    names = [str(name) for name in posterior.data_vars] if var_names is None else var_names
    for name in names:
        if name not in posterior:
            raise ResultsError(
                f"no parameter {name!r} in the posterior; it has {', '.join(map(str, posterior.data_vars))}"
            )
    return check_convergence(arrays(idata, names), ess=ess, priors=prior_check(idata, model))


@dataclass(frozen=True)
class Diagnostics:
    """What the checks of a whole run say.

    Parameters
    ----------
    verdict : Verdict
        R-hat and effective sample sizes of every scalar.
    acceptance : tuple of float
        Share of accepted steps of each chain, tuning left out; empty when it was not recorded.
    """

    verdict: Verdict
    acceptance: tuple[float, ...]

    def to_json(self) -> str:
        """All of it as one JSON object."""
        return json.dumps(asdict(self), default=plain)

    @classmethod
    def from_json(cls, text: str) -> Diagnostics:
        """Read back from `to_json`.

        Raises
        ------
        ResultsError
            If the text is not what `to_json` writes.
        """
        try:
            return TypeAdapter(cls).validate_python(json.loads(text))
        except ValueError as error:  # no JSON, or other fields
            raise ResultsError(
                f"diagnostics of a run: not readable ({error}); slim the posterior again"
            ) from None


def diagnostics(idata: Any, *, var_names: list[str] | None = None, model: Any = None) -> Diagnostics:
    """Checks of a run: those that `slim` stored of the whole run, or else of the draws that are here.

    Parameters
    ----------
    idata : arviz.InferenceData
        With a posterior group.
    var_names : list of str, optional
        Variables to judge where nothing is stored; all if absent.
    model : pymc.Model, optional
        As in `verdict`.

    Returns
    -------
    Diagnostics

    Raises
    ------
    ResultsError
        If there is no posterior, or stored diagnostics are not readable.
    """
    stored = idata.attrs.get(DIAGNOSTICS_ATTR)
    if stored is not None:
        found = Diagnostics.from_json(str(stored))
        return replace(found, verdict=_told(found.verdict, prior_check(idata, model)))
    judged = verdict(idata, var_names=var_names, model=model)
    acceptance: tuple[float, ...] = ()
    if "sample_stats" in idata and "accepted" in idata["sample_stats"]:
        accepted = idata["sample_stats"]["accepted"]
        acceptance = tuple(
            accepted.mean([d for d in accepted.dims if d != "chain"]).to_numpy().astype(float).tolist()
        )
    return Diagnostics(judged, acceptance)


def _told(stored: Verdict, priors: PriorCheck | None) -> Verdict:
    """A stored verdict with what the posterior says of its prior, if it was stored without."""
    if priors is None or stored.bounds or stored.uninformed or not (priors.bounds or priors.uninformed):
        return stored
    return _judgement(stored.parameters, stored.chains, stored.draws, ESS_TARGET, priors)


def _verdict_text(found: list[ParameterVerdict], chains: int, draws: int, ess: float) -> str:
    if not found:
        return "not converged: no parameter varies; check that the chains moved at all."
    rhat = max(found, key=lambda p: p.worst_rhat)
    bulk = min(found, key=lambda p: np.nan_to_num(p.ess_bulk))
    tail = min(found, key=lambda p: np.nan_to_num(p.ess_tail))
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
        faults = [f"R-hat {p.rhat:.3f} > {RHAT_LIMIT}"] if not p.rhat <= RHAT_LIMIT else []
        sizes = {"bulk": p.ess_bulk, "tail": p.ess_tail}
        faults += [f"{n} ESS {size:.0f} < {ess:.0f}" for n, size in sizes.items() if not size >= ess]
        reasons.append(f"{p.name}: {', '.join(faults)}")
    if len(failing) > 4:
        reasons.append(f"and {len(failing) - 4} more")
    return f"not converged: {'; '.join(reasons)}.{few} {_advice(failing, draws, ess)}"


def _advice(failing: list[ParameterVerdict], draws: int, ess: float) -> str:
    least = min(p.least_ess for p in failing)
    factor = ess / least if least > 0 else np.inf
    if max(p.worst_rhat for p in failing) > 1.2:
        return "The chains have not met: tune for longer, and look at the trace for several modes."
    if not np.isfinite(factor) or factor > 20:
        return "Too few draws to say more: draw many more."
    # R-hat alone can fail with enough draws; half as many again settles most of those
    factor = max(factor, 1.5)
    return (
        f"Draw about {factor:.1f} times as many (some {int(np.ceil(draws * factor / 100) * 100)} per chain)."
    )
