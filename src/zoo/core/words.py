"""Words of errors: one line each, and what comes near a name that is not known."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Sequence

LONGEST = 500
"""Characters of an error's text."""


def one_line(text: str, longest: int = LONGEST) -> str:
    r"""A text without control characters, and without its middle where it is too long.

    What a file holds may end in an error's text: escape sequences would change the terminal that shows it.

    Parameters
    ----------
    text : str
    longest : int
        Characters to keep; two fifths of them are from the end, where an error says what to change.

    Returns
    -------
    str

    Examples
    --------
    >>> one_line("vessel \x1b[31m: is missing")
    'vessel \\x1b[31m: is missing'
    >>> one_line("abcdefghijklmnopqrstuvwxyz", 15)
    'abcd ... uvwxyz'
    """
    if len(text) > longest:
        end = 2 * longest // 5
        text = f"{text[: longest - end - 5]} ... {text[-end:]}"
    if not text.isprintable():
        text = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text.replace("\n", " "))
        text = text if len(text) <= longest else one_line(text, longest)
    return text


class OneLineError(Exception):
    """An error whose text is one line of at most 500 characters, whatever the values that it shows."""

    def __init__(self, text: object = "") -> None:
        super().__init__(one_line(str(text)))


def short(value: object, longest: int = 60) -> str:
    """How a value of unknown size is shown in an error."""
    try:
        shown = repr(value[: longest + 1] if isinstance(value, str) else value)
    except (RecursionError, ValueError):  # tables in tables, numbers of thousands of digits
        return f"a {type(value).__name__} too large to show"
    return shown if len(shown) <= longest else f"{shown[: longest - 3]}..."


def meant(word: object, known: Sequence[str], alike: float = 0.5, what: str = "") -> str:
    """A question for the known name that is nearest, with a blank at its end; empty if none is near."""
    close = difflib.get_close_matches(short(word, 100).strip("'"), known[:1000], 1, alike)
    return f"did you mean {what}{close[0]!r}? " if close else ""


def choices(word: object, known: Sequence[str]) -> str:
    """The nearest known name, and all."""
    return f"{meant(word, known)}use one of {', '.join(known)}"


def nearest(word: object, known: Sequence[str]) -> str:
    """Words for an unknown name: the nearest known one, and all."""
    return f"unknown; {choices(word, known)}"


def refuse_unknown(what: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Refuse settings that a function does not have.

    Parameters
    ----------
    what : str
        The function's name, for the error.
    given, known : iterable of str
        Names of settings.

    Raises
    ------
    TypeError
        Naming the first unknown setting and the known one that is nearest.

    Examples
    --------
    >>> refuse_unknown("sample", ["drws"], ["draws", "tune"])
    Traceback (most recent call last):
        ...
    TypeError: sample: setting 'drws': unknown; did you mean 'draws'? use one of draws, tune
    """
    names = list(known)
    for name in given:
        if name not in names:
            raise TypeError(f"{what}: setting {name!r}: {nearest(name, names)}")


def listed(names: Iterable[object]) -> str:
    """Such as "A, B and C"."""
    words = [str(name) for name in names]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def percent(share: float, digits: int = 0) -> str:
    """A share in percent; "<1 %" for what is little but not nothing, ">99 %" for what is not all.

    Examples
    --------
    >>> percent(0.5), percent(0.004), percent(0.9999), percent(0.9857, 1)
    ('50 %', '<1 %', '>99 %', '98.6 %')
    """
    text, step = f"{100 * share:.{digits}f}", 10.0**-digits
    if float(text) == 0.0:
        return f"<{step:g} %" if share > 0.0 else "0 %"
    return f">{100 - step:g} %" if float(text) == 100.0 and share < 1.0 else f"{text} %"


def chance(p: float, digits: int = 0) -> str:
    """A probability in percent, which data never make certain.

    Examples
    --------
    >>> chance(1.0), chance(0.9857, 1)
    ('>99 %', '98.6 %')
    """
    return percent(min(p, 1.0 - 1e-12), digits)


def unit_words(unit: str) -> str:
    """A unit after a number: " mmHg"; nothing for a pure number."""
    return "" if unit == "1" else f" {unit}"


def size_words(size: float, unit: str) -> str:
    """A size with its unit, that of a logarithm as what it changes.

    Examples
    --------
    >>> size_words(0.05, "mmHg"), size_words(0.2, "log radius"), size_words(1.1, "log load")
    ('0.05 mmHg', '22.1 %', 'a factor of 3')
    """
    if unit.startswith("log "):
        factor = math.exp(size)
        return f"{100 * (factor - 1):.3g} %" if factor < 2 else f"a factor of {factor:.3g}"
    return f"{size:.3g}{unit_words(unit)}"


def span(value: float, interval: Sequence[float]) -> str:
    """An estimate with its interval."""
    return f"{value:.2g} ({interval[0]:.2g} to {interval[1]:.2g})"


def digits(value: float, most: int) -> str:
    """A number with so many significant digits, in full up to 1e6.

    Examples
    --------
    >>> digits(50407.8, 3), digits(0.72253, 3), digits(2.3e7, 3)
    ('50400', '0.723', '2.3e+07')
    """
    text = f"{value:.{most}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e6 else text


def estimate(mean: float, sd: float, unit: str = "1") -> str:
    """A mean with its standard deviation and unit; the unit 1 is left out."""
    return f"{digits(mean, 3)} ± {digits(sd, 2)}{unit_words(unit)}"
