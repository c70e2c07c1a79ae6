"""What these series cannot tell apart: what a component could draw of another explanation's signal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from zoo.core.diagnosis.components.refining import Component, Explained, Kind
from zoo.core.diagnosis.components.response import Linearised
from zoo.core.diagnosis.evidence import Fit

Array = NDArray[np.float64]

SEEN = 1.0
"""Response to one prior sd, in units of the noise, from which on a direction is in a response space."""
NEAREST = 5
"""Listed effects that are told beside a learned function."""
LEAST_SHARE = 0.02
"""Part of a learned signal's energy below which an effect is not told."""


def _absorbed(linearised: Linearised, S: Array) -> Array:
    """An orthonormal basis of what the baseline's parameters absorb, in units of the noise."""
    basis, _ = np.linalg.qr(linearised.jacobian / np.sqrt(S)[:, None])
    return np.asarray(basis)


def _response(kind: Kind, S: Array) -> Array:
    """Responses in units of the noise to one prior sd along each direction of a function's best length."""
    w = kind.learned
    size = max(w.best.sd, w.function.size)
    return np.asarray(w.block.columns @ (size * w.function.root(w.best.length)) / np.sqrt(S)[:, None])


def left_of(signal: Array, component: Component, linearised: Linearised, S: Array) -> float:
    """Half the squared size, in units of the noise, of what a component leaves of a signal that is true.

    Each of its functions is fitted with its prior beside the baseline's parameters; the best one counts.

    Parameters
    ----------
    signal : array (n,)
        Flat coefficients.
    component : Component
    linearised : Linearised
    S : array (n,)
        Variances of the noise.
    """
    J = linearised.jacobian / np.sqrt(S)[:, None]
    z = signal / np.sqrt(S)
    found = []
    for kind in component.kinds:
        X = _response(kind, S)
        A = np.concatenate([J, X], axis=1)
        prior = np.concatenate([np.zeros((X.shape[1], J.shape[1])), np.eye(X.shape[1])], axis=1)
        weights, *_ = np.linalg.lstsq(
            np.concatenate([A, prior]), np.concatenate([z, np.zeros(len(prior))]), rcond=None
        )
        found.append(0.5 * float(np.sum((z - A @ weights) ** 2)))
    return min(found)


def space(component: Component, linearised: Linearised, S: Array) -> Array:
    """Orthonormal basis (n, m) of a component's signals that are seen, without what the baseline absorbs."""
    Q = _absorbed(linearised, S)
    X = np.concatenate([_response(kind, S) for kind in component.kinds], axis=1)
    left, values, _ = np.linalg.svd(X - Q @ (Q.T @ X), full_matrices=False)
    return np.asarray(left[:, values > SEEN])


def principal_angles(explained: Explained, S: Array) -> dict[str, dict[str, tuple[float, float]]]:
    """Smallest and largest principal angle, in degrees, between the spaces of each two components."""
    spaces = {n: space(c, explained.linearised, S) for n, c in explained.components.items()}
    found: dict[str, dict[str, tuple[float, float]]] = {name: {} for name in spaces}
    for a, A in spaces.items():
        for b, B in spaces.items():
            if a != b and A.shape[1] and B.shape[1]:
                cosines = np.linalg.svd(A.T @ B, compute_uv=False)
                angles = np.degrees(np.arccos(np.clip(cosines, 0.0, 1.0)))
                found[a][b] = float(angles.min()), float(angles.max())
    return found


def nearest_effects(
    kind: Kind, effects: Mapping[str, Sequence[Fit]], linearised: Linearised, S: Array
) -> list[tuple[str, float, bool]]:
    """Listed effects whose signals explain most of the energy of a learned one.

    Both without what the baseline's parameters absorb. An effect whose amplitude would have a sign that its
    prior does not allow is told as such.

    Parameters
    ----------
    kind : Kind
    effects : mapping of name to sequence of Fit
        At each location that was searched.
    linearised : Linearised
    S : array (n,)
        Variances of the noise.

    Returns
    -------
    list of (name, share, whether of the opposite sign)
        The largest share first.
    """
    Q = _absorbed(linearised, S)

    def apart(signal: Array) -> Array:
        z = signal / np.sqrt(S)
        return np.asarray(z - Q @ (Q.T @ z))

    learned = apart(kind.learned.block.columns @ kind.learned.mean)
    energy = float(learned @ learned)
    found = []
    for name, fits in effects.items():
        best = (0.0, False)
        for fit in fits:
            column = apart(fit.jacobian[:, fit.forward.asked])
            size = float(column @ column)
            if size <= 0.0 or energy <= 0.0:
                continue
            along = float(column @ learned)
            parameter = fit.hypothesis.effect.parameters[0]
            amplitude = along / size
            forbidden = amplitude > 0.0 >= parameter.high or amplitude < 0.0 <= parameter.low
            best = max(best, (along**2 / (size * energy), forbidden))
        if best[0] >= LEAST_SHARE:
            found.append((name, *best))
    return sorted(found, key=lambda x: -x[1])[:NEAREST]
