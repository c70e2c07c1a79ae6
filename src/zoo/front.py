"""The front door of the diagnosis: a study or any other data go in, and what comes out can draw itself."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any

from zoo.core import diagnosis
from zoo.core.data import Data
from zoo.core.words import refuse_unknown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from zoo.blood.study import Study


def _plot(found: Any) -> Figure:
    from zoo.plots import plot_diagnosis

    return plot_diagnosis(found)


diagnosis.Diagnosis.plotter = staticmethod(_plot)  # the core draws nothing itself


def diagnose(data: Study | Data, *arguments: Any, **settings: Any) -> Any:
    """Find where a baseline model misses data, which unmodelled causes explain it, and how well.

    Parameters
    ----------
    data : Study or Data
        What was measured: a study of blood flow (`zoo.load_study`), or series of anything else.
    *arguments, **settings
        For a study those of `zoo.blood.diagnosis.diagnose`: the baseline's name or the letter of a
        model with that structure, `effects`, `states` and so on. For other data those of
        `zoo.core.diagnosis.diagnose`: the forward model, the effects, `errors`, `hooks` and so on.

    Returns
    -------
    Diagnosis
        `print` shows the verdict; `table`, `components`, `causes`, `where` and `shrinkage` say more, `plot()`
        draws it on one page, `with_posteriors()` samples the posteriors of the leading sets of effects.

    Raises
    ------
    DiagnosisError
        If an argument is out of range, a series does not vary, or the baseline cannot be fitted.
    TypeError
        For a setting that does not exist.

    Examples
    --------
    >>> import zoo
    >>> found = zoo.diagnose(zoo.load_study("demo"), base="B")  # doctest: +SKIP
    >>> found.plot().savefig("gap.png")  # doctest: +SKIP

    References
    ----------
    Kennedy and O'Hagan 2001, doi 10.1111/1467-9868.00294.
    """
    from zoo.blood.diagnosis import diagnose as diagnose_study
    from zoo.blood.study import Study

    if not isinstance(data, Study | Data):
        raise diagnosis.DiagnosisError(
            f"data = {data!r:.60}: give a study, such as zoo.load_study('demo'), or a zoo.core.data.Data "
            "(times, values, labels, units)"
        )

    function: Any = diagnosis.diagnose if isinstance(data, Data) else diagnose_study
    refuse_unknown("diagnose", settings, inspect.signature(function).parameters)
    return function(data, *arguments, **settings)
