"""Changes to files: of bytes, of lines, and of the values that their formats have."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

NUMBERS = [
    *"0 -0.0 1 -1 2 0.5 1e-9 5e-324 2.2e-308 1e-30 1e30 1e300 1e308 1e400 -1e308 1e-1000".split(),
    *"nan -nan inf -inf NaN Infinity 1_000 1,5 0x10 0o7 1e .5 5. ٣ 0.1+0.2 --1 +1".split(),
    *"2147483647 2147483648 -2147483649 9223372036854775808".split(),
    *("9" * 40, "9" * 5000, "0x" + "f" * 3000),
]
TEXTS = [
    *r"../secret.csv /etc/passwd \u0000 \u001b[2J \ud800 . .. network.toml study.toml inflow.csv".split(),
    *"printed published-code nominal paun2020 total x".split(),
    *("x" * 300, "a/" * 50, "é" * 70),
]
OTHERS = [
    *"true false null ~ 1979-05-27 07:32:00 [] [[]] [1,2] {} {a=1} {base={}} {a:1}".split(),
    *"*a &a !!x | > # %s {0} $x$ <b>".split(),
    *('""', "''", '"""', "'''", "[" * 50 + "]" * 50, "- - - x", "&a b", "!!x y"),
    *("\x1b[31m", "\x00", "\ufeff", "\u202e"),
]
Mutation = Callable[[random.Random, bytes], bytes]


def flip(rng: random.Random, raw: bytes) -> bytes:
    """One bit is another."""
    at = rng.randrange(len(raw))
    return raw[:at] + bytes([raw[at] ^ 1 << rng.randrange(8)]) + raw[at + 1 :]


def cut(rng: random.Random, raw: bytes) -> bytes:
    """The end is missing."""
    return raw[: rng.randrange(len(raw))]


def remove(rng: random.Random, raw: bytes) -> bytes:
    """A part is missing."""
    at = rng.randrange(len(raw))
    return raw[:at] + raw[at + rng.randrange(1, 64) :]


def repeat(rng: random.Random, raw: bytes) -> bytes:
    """A part is there twice."""
    at, n = rng.randrange(len(raw)), rng.randrange(1, 64)
    return raw[: at + n] + raw[at:]


def insert(rng: random.Random, raw: bytes) -> bytes:
    """Bytes that were not there."""
    at = rng.randrange(len(raw) + 1)
    return raw[:at] + rng.randbytes(rng.choice([1, 2, 8, 64])) + raw[at:]


def zero(rng: random.Random, raw: bytes) -> bytes:
    """A part of zeros, as a crashed file system leaves."""
    at = rng.randrange(len(raw))
    n = min(rng.choice([1, 8, 64, 512]), len(raw) - at)
    return raw[:at] + bytes(n) + raw[at + n :]


def swap(rng: random.Random, raw: bytes) -> bytes:
    """Two parts have changed places."""
    n = rng.choice([1, 4, 16, 64])
    if len(raw) < 2 * n + 1:
        return flip(rng, raw)
    a = rng.randrange(len(raw) - 2 * n)
    b = rng.randrange(a + n, len(raw) - n + 1)
    return raw[:a] + raw[b : b + n] + raw[a + n : b] + raw[a : a + n] + raw[b + n :]


def _lines(change: Callable[[random.Random, list[bytes]], None]) -> Mutation:
    def mutation(rng: random.Random, raw: bytes) -> bytes:
        lines = raw.split(b"\n")
        change(rng, lines)
        return b"\n".join(lines)

    mutation.__name__ = change.__name__.lstrip("_")
    return mutation


def _line_lost(rng: random.Random, lines: list[bytes]) -> None:
    lines.pop(rng.randrange(len(lines)))


def _line_twice(rng: random.Random, lines: list[bytes]) -> None:
    at = rng.randrange(len(lines))
    lines[at:at] = [lines[at]] * rng.choice([1, 1, 2, 100])


def _lines_swapped(rng: random.Random, lines: list[bytes]) -> None:
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[a], lines[b] = lines[b], lines[a]


def _indented(rng: random.Random, lines: list[bytes]) -> None:
    at = rng.randrange(len(lines))
    lines[at] = rng.choice([b" ", b"  ", b"\t", b"    "]) + lines[at]


def _hostile(rng: random.Random) -> bytes:
    kind = rng.choice([NUMBERS, NUMBERS, TEXTS, OTHERS])
    quote = rng.choice(['"', '"', "'", ""]) if kind is TEXTS else ""
    return f"{quote}{rng.choice(kind)}{quote}".encode()


def value(rng: random.Random, raw: bytes) -> bytes:
    """A value of "key = value", "key: value" or a cell is another, or that of another place."""
    found = list(re.finditer(rb"(?<=[=:,\[\s])[^\s=:,\[\]{}#]+", raw)) or list(re.finditer(rb"\S+", raw))
    if not found:
        return raw + _hostile(rng)
    at = rng.choice(found)
    other = rng.choice(found)[0] if rng.random() < 0.3 else _hostile(rng)
    return raw[: at.start()] + other + raw[at.end() :]


def key(rng: random.Random, raw: bytes) -> bytes:
    """A key is another, of the file or of nowhere."""
    found = list(re.finditer(rb"[A-Za-z_][A-Za-z_0-9]*(?=\s*[=:,])", raw))
    if not found:
        return insert(rng, raw)
    at = rng.choice(found)
    other = rng.choice(found)[0] if rng.random() < 0.6 else _hostile(rng)
    return raw[: at.start()] + other + raw[at.end() :]


def scaled(rng: random.Random, raw: bytes) -> bytes:
    """A number is a power of ten of itself, or a little off."""
    found = list(re.finditer(rb"(?<![A-Za-z_0-9])\d+(\.\d+)?([eE][+-]?\d+)?", raw))
    if not found:
        return insert(rng, raw)
    at = rng.choice(found)
    try:
        number = float(at[0]) * rng.choice([1e-12, 1e-3, 0.9, 1.0000001, 2, 10, 1e3, 1e6, 1e12])
    except ValueError:
        return raw
    return raw[: at.start()] + f"{number:.6g}".encode() + raw[at.end() :]


VALUES: list[Mutation] = [value, value, scaled, scaled, scaled, key]
BYTES: list[Mutation] = [flip, cut, remove, repeat, insert, zero, swap]
TEXT: list[Mutation] = [
    *(value, value, value, value, key, scaled, scaled),
    *map(_lines, (_line_lost, _line_twice, _lines_swapped, _indented)),
    *BYTES,
]


def mutated(rng: random.Random, raw: bytes, mutations: list[Mutation], most: int = 3) -> bytes:
    """A file with one to `most` changes."""
    for _ in range(min(rng.randint(1, most), rng.randint(1, most))):
        if raw:
            raw = rng.choice(mutations)(rng, raw)
    return raw
