"""Simple laws that a learned function may be, each fitted to the data in its place."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, softmax

from zoo.core.causes.evidence import SIZE_PRIORS, SetEvidence
from zoo.core.components import FreeFunction
from zoo.core.diagnosis.discrepancies import INTERVAL
from zoo.core.diagnosis.file import Law

Array = NDArray[np.float64]
SHAPES = 120
"""Values of a law's shape that are tried."""
EXPONENTS, MOST = (0.1, 5.0), 3
"""Range of a power's exponent; most parameters of a law, those of a sine."""


@dataclass(frozen=True)
class _Kind:
    """A law linear in its amplitudes: columns (n, q) at points x (n,), given its shape."""

    name: str
    shape: str
    columns: Callable[[Array, float], Array]
    shapes: Callable[[Array], Array]


def _inside(x: Array) -> Array:
    return np.linspace(x.min(), x.max(), SHAPES + 2)[1:-1]


def _scales(x: Array) -> Array:
    """From a tenth of the largest argument to three times it."""
    return np.asarray(np.geomspace(0.1, 3.0, SHAPES) * np.abs(x).max())


def _periods(x: Array) -> Array:
    """From four of the points' steps to twice the range."""
    return np.geomspace(4.0 * np.ptp(x) / (len(x) - 1), 2.0 * np.ptp(x), SHAPES)


KINDS = (
    _Kind("sign", "", lambda x, _: np.sign(x)[:, None], lambda x: np.zeros(1)),
    _Kind(
        "power",
        "exponent",
        lambda x, n: (np.sign(x) * np.abs(x / np.abs(x).max()) ** n)[:, None],
        lambda x: np.geomspace(*EXPONENTS, SHAPES),
    ),
    _Kind("threshold", "threshold", lambda x, at: np.maximum(x - at, 0.0)[:, None], _inside),
    _Kind("saturation", "scale", lambda x, scale: np.tanh(x / scale)[:, None], _scales),
    _Kind(
        "sine",
        "period",
        lambda x, T: np.stack([np.sin(2 * np.pi * x / T), np.cos(2 * np.pi * x / T)], axis=1),
        _periods,
    ),
)


def simple_laws(function: FreeFunction, length: float | None, evidence: SetEvidence, at: int) -> list[Law]:
    """Fit each simple law in the place of a learned function, the most probable first.

    Laws are a sign(x), a sign(x) |x|^n, a max(x - b, 0), a tanh(x / b) and a sine of period T with its
    phase, equally probable beforehand and in any shape, of rms 1 at the function's points times amplitudes
    of the function's prior size s. With errors V, Y what each amplitude does to the series, W = (V + J P^-1
    J')^-1 for all else that is free, and M = Y'W Y, the log evidence of a law of one shape is, up to a
    constant,

        b'(M + 1/s^2)^-1 b / 2 - log|1 + s^2 M| / 2,    b = Y'W r,

    and what it leaves is 1 - b'M^-1 b / h in squares, h the same of the function itself. Values of the
    function that the series do not show do not count.

    Parameters
    ----------
    function : FreeFunction
        Of numbers, at more points than a sine has parameters; of places there is no law.
    length : float or None
        Its correlation length.
    evidence : SetEvidence
        Of the set that holds it, around its mode.
    at : int
        Which of that evidence's causes it is.

    Returns
    -------
    list of Law
    """
    x = function.at
    if function.labels or len(x) <= MOST:
        return []
    own = evidence.causes[at].columns
    rest = [c.columns for i, c in enumerate(evidence.causes) if i != at]
    problem, V = evidence.problem, evidence.variances(evidence.best(SIZE_PRIORS))[:, None]
    A = np.concatenate([problem.jacobian, *rest], axis=1)
    k, p = problem.jacobian.shape[1], A.shape[1]
    P, pull = np.eye(p), np.zeros(p)
    P[:k, :k], pull[:k] = problem.P, problem.pull
    H = (A / V).T @ A + P

    def without_rest(y: Array, pull: Array | float = 0.0) -> Array:
        """W y, of a residual with the prior's pull."""
        return np.asarray((y - A @ np.linalg.solve(H, (A / V).T @ y - pull)) / V)

    gram, right = own.T @ without_rest(own), own.T @ without_rest(problem.residual[:, None], pull[:, None])

    def fitted(z: Array) -> tuple[float, float]:
        """What amplitudes of weights z (m, q) take of the squares, and the log evidence."""
        M, b = z.T @ gram @ z, z.T @ right
        taken = (b.T @ np.linalg.lstsq(M, b, rcond=None)[0]).item()
        gain = (b.T @ np.linalg.solve(M + np.eye(len(M)), b)).item()
        return taken, 0.5 * (gain - np.linalg.slogdet(M + np.eye(len(M)))[1])

    whole, _ = fitted(np.eye(len(gram)))
    weights = np.linalg.pinv(function.root(length))  # of values in prior sizes
    logs, told = [], list[dict[str, Any]]()
    for kind in KINDS:
        shapes = kind.shapes(x)
        columns = [kind.columns(x, float(shape)) for shape in shapes]
        taken, log = np.array([fitted(weights @ one / np.sqrt(np.mean(one**2, axis=0))) for one in columns]).T
        best = int(np.argmax(log))
        logs.append(logsumexp(log) - math.log(len(log)))
        told.append({"name": kind.name, "left": math.sqrt(max(0.0, 1.0 - taken[best] / whole))})
        if kind.shape:
            mass = np.cumsum(np.exp(log - log[best]))
            low, high = np.interp(INTERVAL, mass / mass[-1], shapes)
            told[-1] |= {"shape": kind.shape, "value": float(shapes[best]), "interval": (low, high)}
    laws = [Law(probability=float(p), **one) for p, one in zip(softmax(logs), told, strict=True)]
    return sorted(laws, key=lambda law: -law.probability)
