"""What can go wrong in a solve, one error for each status of the compiled solver."""

from __future__ import annotations

from zoo.blood.study import StudyError
from zoo.core.forward import SolveError


class SolverError(SolveError):
    """A solve that did not reach a periodic state; its text says why and what to change.

    Its `kind` is the name of its status, such as "collapse".
    """

    status = "failed"

    def __init__(self, reason: str) -> None:
        super().__init__(reason, self.status)


class SolverArgumentError(SolverError, ValueError):
    """An input of the solver is out of range."""

    status = "bad-argument"


class ArgumentError(SolverArgumentError, StudyError):
    """The same for a value of a network, which effects may have changed."""


class CFLError(SolverError):
    """The time step is too long for the wave speed."""

    status = "cfl"


class CollapseError(SolverError):
    """A vessel's cross-section fell to zero."""

    status = "collapse"


class WallLimitError(SolverError):
    """A vessel's cross-section passed the largest one of its wall law."""

    status = "wall-limit"


class WallFallsError(SolverError):
    """With a function added to its wall a vessel's pressure does not rise with its area."""

    status = "wall-falls"


class RootError(SolverError):
    """A junction or an outlet has no pressure that satisfies its equations."""

    status = "no-root"


class NotPeriodicError(SolverError):
    """The beats did not repeat themselves within the limit."""

    status = "not-periodic"


class InletAreaError(SolverError):
    """The wall at the root's inlet has no area at the pressure that is given there."""

    status = "inlet-area"


class NoDerivativeError(SolverError):
    """A solve has no derivative in a direction that was asked for."""

    status = "no-derivative"
