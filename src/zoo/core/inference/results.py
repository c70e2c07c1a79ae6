"""Former home of records, convergence and files; to be removed when no module imports it."""

from zoo.core.inference.convergence import (  # noqa: F401
    ESS_TARGET,
    MIN_CHAINS,
    RHAT_LIMIT,
    Diagnostics,
    ParameterVerdict,
    Verdict,
    diagnostics,
    ess_to_count,
    judged,
    scalars,
    verdict,
)
from zoo.core.inference.convergence import check_convergence as diagnose  # noqa: F401
from zoo.core.inference.record import ResultsError, RunRecord, versions  # noqa: F401
