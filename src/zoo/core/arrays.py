"""Numbers and arrays that callers hand over, looked at before anything computes with them."""

from __future__ import annotations

import math
import reprlib
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

MOST_COUNT = 1 << 28
"""No count may be larger, so that sums of a few of them are whole numbers of 32 bits."""


def shown(value: object) -> str:
    """A value in a message, cut."""
    return " ".join(reprlib.repr(value).split())[:80]


def rms_of(values: Array) -> float:
    """Root mean square of the values that are there."""
    return math.sqrt(float(np.nanmean(values**2)))


def real_array(
    field: str, values: ArrayLike, *, ndim: int | None = None, error: type[Exception] = ValueError
) -> Array:
    """An array of real numbers as float64 in the order of C; of any shape, and not finite, if it was so.

    Nothing else is taken for a number: no string, no bool, no complex number, nothing absent.

    Parameters
    ----------
    field : str
        What it is, for the error.
    values : array
    ndim : int
        Number of axes that it must have.
    error : type
        Of the exception.

    Returns
    -------
    array
        The same object if it was such an array already.

    Raises
    ------
    ValueError
        Or the error given, in one line, if it is not.

    Examples
    --------
    >>> real_array("R2", ["1.5", "2"])
    Traceback (most recent call last):
        ...
    ValueError: R2 = ['1.5', '2']: must be an array of real numbers; convert it to one
    """
    # most are as they must be, and a solve should not wait for more
    if (
        type(values) is np.ndarray
        and values.dtype == np.float64
        and values.flags.c_contiguous
        and (ndim in (None, values.ndim))
    ):
        return values
    try:
        found = np.asarray(values)
    except (ValueError, TypeError, OverflowError):
        found = np.array(None)
    if found.size == 0 and found.dtype.kind in "OUS":
        found = np.zeros(found.shape)
    if found.dtype.kind not in "fiu" or np.ma.is_masked(values):
        raise error(f"{field} = {shown(values)}: must be an array of real numbers; convert it to one")
    if ndim is not None and found.ndim != ndim:
        axes = "one axis" if ndim == 1 else f"{ndim} axes"
        raise error(f"{field} has shape {found.shape}: must have {axes}; reshape it")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(found, dtype=np.float64).reshape(found.shape)


def refuse_where(
    field: str, values: Array, bad: NDArray[np.bool_], words: str, *, error: type[Exception] = ValueError
) -> None:
    """Refuse the first value that is marked as bad.

    Raises
    ------
    ValueError
        Or the error given, that names its place and says what it must be.
    """
    if bad.any():
        at = tuple(int(i) for i in np.argwhere(bad)[0])
        place = f"[{', '.join(map(str, at))}]" if at else ""
        raise error(f"{field}{place} = {float(values[at])!r}: must be {words}; correct it")


def finite_array(field: str, values: ArrayLike, *, error: type[Exception] = ValueError) -> Array:
    """As `real_array` with one axis, and every number finite."""
    found = real_array(field, values, ndim=1, error=error)
    refuse_where(field, found, ~np.isfinite(found), "finite", error=error)
    return found


def whole_array(field: str, values: ArrayLike, *, error: type[Exception] = ValueError) -> NDArray[np.int32]:
    """As `real_array` with one axis, and every number a whole one of 32 bits; as int32."""
    found = real_array(field, values, ndim=1, error=error)
    fits = (found == np.rint(found)) & (np.abs(found) <= np.iinfo(np.int32).max)
    refuse_where(field, found, ~fits, "a whole number of 32 bits", error=error)
    return found.astype(np.int32)


def real_number(
    field: str,
    value: object,
    words: str = "a finite number",
    *,
    above: float = -math.inf,
    error: type[Exception] = ValueError,
) -> float:
    """One finite number larger than `above`.

    Raises
    ------
    ValueError
        Or the error given, in one line, if it is no number, or another one.
    """
    one: Any = value
    if type(value) in (float, int) and above < one < math.inf and abs(one) < 1e300:
        return float(one)
    try:
        one = np.asarray(value)
        good = one.dtype.kind in "fiu" and one.ndim == 0 and above < float(one) < math.inf
    except (ValueError, TypeError, OverflowError):
        good = False
    if not good:
        raise error(f"{field} = {shown(value)}: must be {words}; correct it")
    return float(one)


def whole_number(
    field: str,
    value: object,
    low: int = 0,
    high: int = MOST_COUNT,
    *,
    words: str = "",
    error: type[Exception] = ValueError,
) -> int:
    """One whole number from `low` to `high`; 2.0 is one, 2.5, "2" and True are none.

    Raises
    ------
    ValueError
        Or the error given, in one line, if it is not.
    """
    words = words or f"a whole number from {low} to {high}"
    found = real_number(field, value, words, error=error)
    if found != math.floor(found) or not low <= found <= high:
        raise error(f"{field} = {shown(value)}: must be {words}; correct it")
    return int(found)


class Brief:
    """A dataclass whose `repr` has the shapes of its arrays, and what else is long cut."""

    def __repr__(self) -> str:
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.repr}  # type: ignore[arg-type]
        texts = (
            f"{name}={f'<array {x.shape}>' if isinstance(x, np.ndarray) else shown(x)}"
            for name, x in values.items()
        )
        return f"{type(self).__name__}({', '.join(texts)})"
