"""The terms of the Gaussian process and their gradient, as functions that numba compiles without Python.

They are `gp_sequential` and `gp_gradient` of `zoo.core.errors.gaussian_process`, with LAPACK by address. It
takes arrays by columns: a matrix here is its transpose there, a lower factor stands in the upper triangle.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numba  # type: ignore[import-untyped]
import numpy as np
from numba.extending import get_cython_function_address  # type: ignore[import-untyped]
from numpy.typing import NDArray

from zoo.core.errors.base import TermsInNumba

njit = numba.njit(error_model="numpy")
_LOG_2PI = math.log(2.0 * math.pi)


def _lapack(name: str, arguments: int) -> Any:
    """A routine of SciPy's LAPACK, which takes all arguments by their addresses."""
    address = get_cython_function_address("scipy.linalg.cython_lapack", name)
    return ctypes.CFUNCTYPE(None, *[ctypes.c_ssize_t] * arguments)(address)


_potrf, _potri, _trtrs = _lapack("dpotrf", 5), _lapack("dpotri", 5), _lapack("dtrtrs", 10)
_LETTERS = np.frombuffer(b"LNT", dtype=np.uint8)
_LOWER, _NOT, _TRANSPOSED = (_LETTERS.ctypes.data + i for i in range(3))


@njit
def _square(routine, matrix, size):  # type: ignore[no-untyped-def]
    """Factor or invert in place; whether there is a result. `size` (2,) is for n and the routine's answer."""
    size[0] = len(matrix)
    at = size.ctypes.data
    routine(_LOWER, at, matrix.ctypes.data, at, at + 4)
    return size[1] == 0


@njit
def _solved(factor, columns, form, size):  # type: ignore[no-untyped-def]
    """Solve L x = b or L' x = b in place, for each row (n,) of `columns`."""
    size[0], size[1] = len(factor), len(columns)
    at = size.ctypes.data
    _trtrs(_LOWER, form, _NOT, at, at + 4, factor.ctypes.data, at, columns.ctypes.data, at, at + 8)


@njit
def _factor(t, w, b, noise):  # type: ignore[no-untyped-def]
    """Cholesky factor of kernel plus noise, and whether there is one."""
    n = len(t)
    covariance = np.zeros((n, n))
    if not (0.0 < w < np.inf and 0.0 < b < np.inf):
        return covariance, False
    scale = np.sqrt(2.0 / (1.0 + 2.0 * (b + w * t * t)))
    u, v = math.sqrt(b) * scale, math.sqrt(w) * scale * t
    for i in range(n):
        for j in range(i, n):
            covariance[i, j] = math.asin(u[i] * u[j] + v[i] * v[j]) * (2.0 / math.pi)
        covariance[i, i] += noise
    size = np.zeros(2, np.int32)
    return covariance, _square(_potrf, covariance, size)


@njit
def sequential(residual, t, w, b, noise):  # type: ignore[no-untyped-def]
    """`gp_sequential`: terms (n_series, n_times), -inf where there is no factor."""
    factor, exists = _factor(t, w, b, noise)
    if not exists:
        return np.full(residual.shape, -np.inf)
    z, size = residual.copy(), np.zeros(3, np.int32)
    _solved(factor, z, _NOT, size)
    return -0.5 * (_LOG_2PI + z * z) - np.log(np.diag(factor))


@njit
def with_gradient(residual, weight, t, w, b, noise):  # type: ignore[no-untyped-def]
    """The terms, and `gp_gradient`: by the residual, by w, by b and by the noise's variance."""
    factor, exists = _factor(t, w, b, noise)
    if not exists:
        return np.full(residual.shape, -np.inf), np.zeros(residual.shape), 0.0, 0.0, 0.0
    z, size = residual.copy(), np.zeros(3, np.int32)
    _solved(factor, z, _NOT, size)
    terms = -0.5 * (_LOG_2PI + z * z) - np.log(np.diag(factor))
    by_residual = -weight * z
    _solved(factor, by_residual, _TRANSPOSED, size)
    by_w = by_b = by_noise = 0.0
    n, total = len(t), np.sum(weight[:, 0])
    if np.all(weight == weight[:, :1]):
        _solved(factor, z, _TRANSPOSED, size)
        _square(_potri, factor, size)
        full = False
    else:
        inner = np.triu(z.T @ (weight * z))  # its transpose by columns
        for i in range(n):
            inner[i, i] = 0.5 * (inner[i, i] - np.sum(weight[:, i]))
        _solved(factor, inner, _TRANSPOSED, size)
        inner = inner.T.copy()
        _solved(factor, inner, _TRANSPOSED, size)
        factor, full = inner, True
    half, size_of = 0.5 + 2.0 * b + 2.0 * w * t * t, 1.0 / (1.0 + 2.0 * (b + w * t * t))
    for i in range(n):
        for j in range(0 if full else i, n):
            by = factor[i, j]
            if not full:
                by *= -total
                for s in range(len(z)):
                    by -= by_residual[s, i] * z[s, j]
            if i == j:
                by = by if full else 0.5 * by
                by_noise += by
            apart = t[i] - t[j]
            by /= math.sqrt(4.0 * b * w * apart * apart + half[i] + half[j])
            c = 2.0 * (b + w * t[i] * t[j])
            by_w += by * (2.0 * t[i] * t[j] - c * (t[i] * t[i] * size_of[i] + t[j] * t[j] * size_of[j]))
            by_b += by * (2.0 - c * (size_of[i] + size_of[j]))
    return terms, by_residual, 2.0 / math.pi * by_w, 2.0 / math.pi * by_b, by_noise


class Part(NamedTuple):
    """Series that share a covariance, a^2 (K(w, b) + v I).

    Parameters
    ----------
    rows : tuple of int
    w, b : int
        Where they are among the parameters.
    amplitude : int
        Where a is; -1 for 1.
    noise : int
        Where the noise's standard deviation a sqrt(v) is; -1 where it is known.
    variance : float
        a^2 v, if it is known.
    """

    rows: tuple[int, ...]
    w: int
    b: int
    amplitude: int = -1
    noise: int = -1
    variance: float = 0.0


def processes(times: NDArray[np.float64], parts: Sequence[Part]) -> TermsInNumba:
    """Terms of Gaussian processes and their gradient.

    Parameters
    ----------
    times : array (n_times,)
    parts : sequence of Part
        All series together.
    """
    n = len(parts)
    part_of = np.empty(sum(len(part.rows) for part in parts), dtype=np.int64)
    for i, part in enumerate(parts):
        part_of[list(part.rows)] = i
    where = np.array([part[1:5] for part in parts])
    known = np.array([part.variance for part in parts])

    @njit
    def law(values, i):  # type: ignore[no-untyped-def]
        """Amplitude, w, b and v of a part."""
        w, b, amplitude, noise = where[i]
        a = values[amplitude] if amplitude >= 0 else 1.0
        sd = values[noise] if noise >= 0 else math.sqrt(known[i])
        ratio = sd / a if a > 0 else np.inf
        return a, values[w], values[b], ratio * ratio

    @njit
    def terms(residual, values):  # type: ignore[no-untyped-def]
        found = np.empty(residual.shape)
        for i in range(n):
            rows = np.flatnonzero(part_of == i)
            a, w, b, v = law(values, i)
            found[rows] = sequential(residual[rows] / a, times, w, b, v) - math.log(a)
        return found

    @njit
    def gradient(residual, values, weight):  # type: ignore[no-untyped-def]
        found, by_residual, by_values = (
            np.empty(residual.shape),
            np.empty(residual.shape),
            np.zeros(len(values)),
        )
        for i in range(n):
            rows = np.flatnonzero(part_of == i)
            a, w, b, v = law(values, i)
            r, g = residual[rows] / a, weight[rows]
            own, scaled, by_w, by_b, by_v = with_gradient(r, g, times, w, b, v)
            found[rows], by_residual[rows] = own - math.log(a), scaled / a
            if own[0, 0] == -np.inf:  # no law, no gradient
                continue
            at_w, at_b, amplitude, noise = where[i]
            by_values[at_w] += by_w
            by_values[at_b] += by_b
            if amplitude >= 0:
                by_values[amplitude] -= (np.sum(scaled * r) + np.sum(g) + 2.0 * v * by_v) / a
            if noise >= 0:
                by_values[noise] += 2.0 * math.sqrt(v) / a * by_v
        return found, by_residual, by_values

    return TermsInNumba(terms, gradient)
