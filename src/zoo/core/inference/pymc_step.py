"""The step method for PyMC's own ``pm.sample``: it finds the mode, and gives each chain a start around it.

Importing this module lets ``pm.sample()`` without a step method choose it for models without gradients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import pymc as pm
from numpy.typing import ArrayLike
from pymc.blocking import RaveledVars
from pymc.pytensorf import floatX
from pymc.step_methods import STEP_METHODS
from pymc.step_methods.compound import Competence
from pymc.step_methods.state import dataclass_state
from pymc.util import get_value_vars_from_user_vars

from zoo.core.arrays import Array
from zoo.core.inference.logposterior import LogPosterior, Point
from zoo.core.inference.mode import Mode, search_mode
from zoo.core.inference.spaces import Gaussian
from zoo.core.inference.starts import first_archive, scattered
from zoo.core.inference.steps import DEMETROPOLISZ, DEMetropolisZ, StepResult, _DEState
from zoo.core.model import bayesian_model as bayesian_model  # who makes a model so has this step method too
from zoo.core.op import without_gradient


@dataclass_state
class _FromModeState(_DEState):
    _placed: bool


class DEMetropolisZFromMode(DEMetropolisZ):
    """`DEMetropolisZ` as `zoo.sample` uses it, for ``pm.sample``: the mode is found when it is made.

    The history of its jumps and its Crank-Nicolson walk begin with the Gaussian around the mode. A chain that
    begins at the model's own initial point, as it does without ``initvals``, is moved before its first step
    to a draw of a t distribution twice as wide as that Gaussian, so that R-hat can see chains that disagree.

    Parameters
    ----------
    vars : list of variables, optional
        All continuous ones if absent.
    start : mapping or Mode, optional
        Values to search the mode from, or the result of `zoo.find_mode`.
    seed : int
        Of the search and of the first history.
    model : pm.Model, optional
        That of the context if absent.
    **kwargs
        Of `DEMetropolisZ`.

    Raises
    ------
    SamplingError
        If the model has discrete variables, or no point with a finite log-posterior is found.
    """

    name = "DEMetropolisZ from the mode"
    for_forward_models: ClassVar[bool] = True
    _state_class = _FromModeState

    def __init__(
        self,
        vars: Any = None,
        *,
        start: Mapping[str, ArrayLike] | Mode | None = None,
        seed: int = 0,
        model: Any = None,
        initial_point: Point | None = None,
        **kwargs: Any,
    ) -> None:
        model = pm.modelcontext(model)
        logp = LogPosterior(model)
        chosen = logp.variables if vars is None else get_value_vars_from_user_vars(vars, model)
        mode = start if isinstance(start, Mode) else search_mode(logp, start, seed=seed)
        own = _elements(logp, chosen)
        around = Gaussian(mode.vector[own], mode.covariance[np.ix_(own, own)])
        archive = first_archive(Gaussian(mode.vector, mode.covariance), seed)[:, own]
        self._mode, self._around, self._placed = mode, around, False
        self._initial = logp.vector(logp.initial)[own]
        super().__init__(
            chosen,
            archive=archive,
            reference=around,
            model=model,
            initial_point=logp.point(mode.vector) if initial_point is None else initial_point,
            **{**DEMETROPOLISZ, **kwargs},
        )

    def reset_tuning(self) -> None:
        """Forget all that was tuned, and that the chain was given its start."""
        super().reset_tuning()
        self._placed = False

    def astep(self, q0: RaveledVars) -> StepResult:
        """One step; before the first one the chain may be moved to a start of its own."""
        if not self._placed and np.array_equal(q0.data, self._initial):
            place = scattered(self.logp, self._around, self._mode.logp, self.rng)
            q0 = RaveledVars(floatX(self._around.mean if place is None else place), q0.point_map_info)
        self._placed = True
        return super().astep(q0)

    @staticmethod
    def competence(var: Any, has_grad: bool) -> Competence:
        """Ideal for variables of a forward model without gradients and of its errors, and for no others."""
        return Competence.IDEAL if without_gradient(var) else Competence.INCOMPATIBLE


def step(
    model: Any = None, *, start: Mapping[str, ArrayLike] | Mode | None = None, seed: int = 0, **options: Any
) -> DEMetropolisZFromMode:
    """The step method that ``pm.sample`` needs for a model without gradients.

    Parameters
    ----------
    model : pm.Model, optional
        That of the context if absent.
    start : mapping or Mode, optional
        Values to search the mode from, or the result of `zoo.find_mode`.
    seed : int
        Of the search and of the first history of the jumps.
    **options
        Of `zoo.core.inference.steps.DEMetropolisZ`, such as ``crank_nicolson=0``.

    Returns
    -------
    DEMetropolisZFromMode
        It gives each chain a start of its own, so that ``initvals`` are not needed.

    Raises
    ------
    SamplingError
        If the model has discrete variables, or no point with a finite log-posterior is found.

    Examples
    --------
    >>> import pymc as pm
    >>> from zoo import load_study, model_A, step
    >>> with model_A(load_study("demo")) as model:  # doctest: +SKIP
    ...     idata = pm.sample(draws=2000, tune=1000, chains=4, step=step(model))
    """
    return DEMetropolisZFromMode(model=pm.modelcontext(model), start=start, seed=seed, **options)


def _elements(logp: LogPosterior, chosen: Sequence[Any]) -> Array:
    """Positions of the chosen variables in the vector of all, in the order of `chosen`."""
    ends = np.cumsum([0, *(np.size(logp.initial[v.name]) for v in logp.variables)])
    at = {v.name: np.arange(a, b) for v, a, b in zip(logp.variables, ends[:-1], ends[1:], strict=True)}
    return np.concatenate([at[v.name] for v in chosen])


if DEMetropolisZFromMode not in STEP_METHODS:
    STEP_METHODS.append(DEMetropolisZFromMode)
