"""What posteriors of several models say of a study, in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from zoo.core.inference.convergence import ESS_TARGET, RHAT_LIMIT, Diagnostics
from zoo.core.inference.record import RunRecord
from zoo.core.words import listed
from zoo.report.filters import with_error

if TYPE_CHECKING:
    import pandas as pd

CRITERION = {"waic": "WAIC", "loo": "PSIS-LOO"}


def summary(
    table: pd.DataFrame | None, checks: Mapping[str, Diagnostics], records: Mapping[str, RunRecord]
) -> list[str]:
    """What was found, in sentences.

    Parameters
    ----------
    table : DataFrame or None
        From `zoo.compare`.
    checks : mapping of model to Diagnostics
    records : mapping of model to RunRecord

    Returns
    -------
    list of str
    """
    failing = [name for name, found in checks.items() if not found.verdict.passes]
    lines = [
        f"Warning: model {name}: {warning}."
        for name, found in checks.items()
        for warning in found.verdict.bounds
    ]
    lines.append(_convergence(checks, failing))
    lines += [
        f"Not informed by the data, with a posterior like the prior, in model {name}: "
        f"{listed(found.verdict.uninformed)}."
        for name, found in checks.items()
        if found.verdict.uninformed
    ]
    if table is not None:
        lines += _standing(table, provisional=str(table.index[0]) in failing)
    solves = sum(record.solves for record in records.values())
    failures = sum(sum(record.failures.values()) for record in records.values())
    lines.append(
        f"Sampling took {solves} solves of the flow equations; "
        + ("none failed." if not failures else f"{failures} of them failed, and those points were refused.")
    )
    return lines


def _convergence(checks: Mapping[str, Diagnostics], failing: Sequence[str]) -> str:
    if not failing and len(checks) == 1:
        return f"The posterior of model {next(iter(checks))} converged."
    if not failing:
        return f"{'Both' if len(checks) == 2 else f'All {len(checks)}'} posteriors converged."
    rhat, worst = max((checks[name].verdict.max_rhat, name) for name in failing)
    ess, least = min((checks[name].verdict.min_ess, name) for name in failing)
    return (
        f"Not converged: {listed(failing)}. The largest R-hat is {rhat:.3f} (model {worst}, "
        f"limit {RHAT_LIMIT}), the smallest effective sample size {ess:.0f} "
        f"(model {least}, {ESS_TARGET:.0f} wanted)."
    )


def _standing(table: pd.DataFrame, provisional: bool) -> list[str]:
    ic = table.attrs.get("ic", "waic")
    name = CRITERION[ic]
    best = table.iloc[0]
    start = "For what such draws are worth, model" if provisional else "Model"
    lines = []
    if len(table) == 1:
        lines.append(f"Model {table.index[0]} has {name} {best[ic]:.1f}, with nothing to compare it to.")
    else:
        lines.append(
            f"{start} {table.index[0]} predicts the observations best of {len(table)} models by {name}: "
            f"{best[ic]:.1f} (lower is better)."
        )
        others = table.iloc[1:]
        near = others[others["difference"] <= others["difference_se"]]
        if len(near):
            lines.append(
                f"{listed(near.index)} {'is' if len(near) == 1 else 'are'} within the standard error of the "
                f"difference ({_differences(near)}): these data do not tell "
                f"{'it' if len(near) == 1 else 'them'} from {table.index[0]}."
            )
        behind = others[others["difference"] > others["difference_se"]]
        if len(behind):
            lines.append(f"Behind by more than the standard error of the difference: {_differences(behind)}.")
    bad = table[table["pareto_k_bad"] > 0]
    if len(bad):
        where = ", ".join(f"{model} {int(row['pareto_k_bad'])}" for model, row in bad.iterrows())
        lines.append(f"PSIS-LOO is not to be trusted at some points (large Pareto k): {where}.")
    warned = table[table["waic_warning"]]
    if len(warned):
        lines.append(
            f"WAIC of {listed(warned.index)} has terms that vary by more than 0.4 over the posterior: its "
            "estimate may be too low."
        )
    return lines


def _differences(rows: pd.DataFrame) -> str:
    return ", ".join(
        f"{model} by {with_error(row['difference'], row['difference_se'])}" for model, row in rows.iterrows()
    )
