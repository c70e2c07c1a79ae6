"""Draw mutants: one small change each, by seeded operators, over Python's syntax tree and C's tokens.

    python tests/mutants/draw.py [ROOM ...] [--first N]

prints the first N changes of each room in the order of its seed, in the form of mutants.toml.  That list was
drawn so from commit 9e8d8bc, before a test was changed.  A change that cannot run, or that changes nothing
that is computed, was passed over there with its reason (`again`), and the next one taken.  Places where any
change fails at once (an index, an axis, a type) are left out, as they ask nothing of a test.
"""

from __future__ import annotations

import argparse
import ast
import random
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SEED = 15
ROOMS = {
    "wall": ["native/src/wall_linear.h", "native/src/wall_tangent.h", "native/src/wall.h"],
    "scheme": ["native/src/scheme.h", "native/src/friction.c", "native/src/time_step.c", "native/src/step.c"],
    "junctions": ["native/src/junction.h", "native/src/junction_total_pressure.h"],
    "outlets": ["native/src/outlet_windkessel.h", "native/src/outlet_circuit.h", "native/src/outlet.h"],
    "likelihood": [
        f"src/zoo/core/errors/{name}.py" for name in ("independent", "gaussian_process", "spectral", "base")
    ],
    "waic": ["src/zoo/core/posterior/comparison.py"],
    "samplers": [f"src/zoo/core/inference/{name}.py" for name in ("steps", "spaces")],
    "evidence": [f"src/zoo/core/diagnosis/{name}.py" for name in ("evidence", "screening", "hypothesis")],
    "grouping": [f"src/zoo/core/diagnosis/{name}.py" for name in ("scoring", "discrepancy")],
    "blind": [f"src/zoo/core/blindcheck/{name}.py" for name in ("folders", "scoring")],
    "resume": [f"src/zoo/core/inference/{name}.py" for name in ("checkpoint", "chain", "processes")],
}
SWAPS = {
    "+": "-", "*": "/", "<": "<=", ">": ">=", "==": "!=", "+=": "-=", "&&": "||",
}  # fmt: skip
SWAPS |= {new: old for old, new in SWAPS.items()}
PYTHON = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">",
    ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
}  # fmt: skip
SYMMETRIC = {"min", "max", "np.maximum", "np.minimum", "isinstance", "getattr", "zip", "np.outer"}


@dataclass(frozen=True)
class Change:
    """Characters start to stop of a file are replaced."""

    operator: str
    start: int
    stop: int
    new: str


def constants(text: str, start: int, rng: random.Random) -> Change:
    """A number times 1.01 or 2, or 0; a whole one may be one more."""
    value = float(text)
    whole = text.isdigit()
    options = {"times 2": 2 * value, "to 0": 0.0}
    options |= {"one more": value + 1} if whole or value == 0.0 else {"times 1.01": 1.01 * value}
    name = rng.choice([n for n, x in options.items() if x != value])
    new = f"{options[name]:g}" if whole else repr(float(f"{options[name]:.6g}"))
    return Change(f"constant {name}", start, start + len(text), new)


def of_python(text: str, rng: random.Random) -> Iterator[Change]:
    """All changes of a module's functions; none in messages and annotations."""
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line.encode()))
    raw = text.encode()

    def span(node: ast.AST) -> tuple[int, int]:
        a = starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]
        b = starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]
        return len(raw[:a].decode()), len(raw[:b].decode())

    def between(one: ast.AST, other: ast.AST, sign: str) -> Iterator[Change]:
        a, b = span(one)[1], span(other)[0]
        at = text.find(sign, a, b)
        if at >= 0:
            yield Change(f"{sign} to {SWAPS[sign]}", at, at + len(sign), SWAPS[sign])

    def walk(node: ast.AST) -> Iterator[Change]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Raise | ast.JoinedStr | ast.arguments | ast.Slice | ast.AnnAssign):
                continue
            if isinstance(node, ast.Subscript) and child is node.slice:
                continue
            if isinstance(node, ast.Call) and isinstance(child, ast.keyword):
                continue
            if isinstance(node, ast.UnaryOp) and isinstance(child, ast.Constant):
                continue
            if child is getattr(node, "returns", None) or child is getattr(node, "annotation", None):
                continue
            if child in getattr(node, "decorator_list", ()):
                continue
            yield from own(child)
            yield from walk(child)

    def own(node: ast.AST) -> Iterator[Change]:
        match node:
            case ast.BinOp(left, op, right) if type(op) in PYTHON:
                yield from between(left, right, PYTHON[type(op)])
            case ast.Compare(left, [op], [right]) if type(op) in PYTHON:
                yield from between(left, right, PYTHON[type(op)])
            case ast.Constant(value) if type(value) in (int, float):
                a, b = span(node)
                if re.fullmatch(r"[\d.]+(e-?\d+)?", text[a:b]):
                    yield constants(text[a:b], a, rng)
            case ast.If(test) | ast.IfExp(test) | ast.While(test):
                a, b = span(test)
                yield Change("condition negated", a, b, f"not ({text[a:b]})")
            case ast.AugAssign() | ast.Expr(ast.Call()):
                yield Change("statement deleted", *span(node), "pass")
        if isinstance(node, ast.Call) and len(node.args) > 1 and ast.unparse(node.func) not in SYMMETRIC:
            one, other = node.args[-2:]
            if type(one) is type(other) and isinstance(one, ast.Name | ast.BinOp | ast.Call | ast.Constant):
                (a, b), (c, d) = span(one), span(other)
                yield Change("arguments swapped", a, d, text[c:d] + text[b:c] + text[a:b])

    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Assign):
            yield from own(node)
            yield from walk(node)


def of_c(text: str, rng: random.Random) -> Iterator[Change]:
    """All changes of a C file; none in comments, directives, indices, heads of loops and argument checks."""

    def blank(match: re.Match[str]) -> str:
        return re.sub(r"[^\n]", " ", match.group())

    bare = re.sub(r'/\*.*?\*/|//[^\n]*|"(\\.|[^"\\])*"', blank, text, flags=re.S)
    bare = re.sub(r"^[ \t]*#(.*\\\n)*.*$", blank, bare, flags=re.M)
    bare = re.sub(r"^[^\n]*_(bad|rows|adds)\(const[^\n]*\n\{.*?^\}", blank, bare, flags=re.S | re.M)
    bare = re.sub(
        r"\b(for|ZOO_LOOP) ?\([^\n;]*(;[^\n]*)?|ptrdiff_t[^\n]*|\bint [^\n]*|enum \{[^}]*\}|case [^\n]*",
        blank,
        bare,
    )
    while (inner := re.sub(r"\[[^\[\]]*[^\[\] ][^\[\]]*\]", blank, bare)) != bare:
        bare = inner
    for match in re.finditer(r"(?<=[\w\]) ] )(\+=|-=|[<>=!]=|&&|\|\||[-+*/<>])(?= )", bare):
        sign = match.group()
        yield Change(f"{sign} to {SWAPS[sign]}", *match.span(), SWAPS[sign])
    for match in re.finditer(r"(?<![\w.])\d+(\.\d+)?(e-?\d+)?(?![\w.])", bare):
        yield constants(match.group(), match.start(), rng)
    for match in re.finditer(r"(?<=[;{}]\n)[ \t]*([*\w>.\[\]()+-]+ [-+*/|]?= [^;{}?]*;)(?=\n)", bare):
        yield Change("statement deleted", *match.span(1), ";")
    for match in re.finditer(r"(?<=[=(,] )([\w> .\[\]()-]+)(?= \? )", bare):
        yield Change("condition negated", *match.span(1), f"!({match.group(1)})")


def context(text: str, change: Change) -> tuple[str, str]:
    """Old and new text in whole lines, as many as occur once in the file."""
    first = text.rfind("\n", 0, change.start) + 1
    last = text.find("\n", change.stop)
    last = len(text) if last < 0 else last
    while True:
        begin = first + len(text[first:last]) - len(text[first:last].lstrip())
        if text.count(text[begin:last]) == 1:
            old = text[begin:last]
            return old, text[begin : change.start] + change.new + text[change.stop : last]
        first = text.rfind("\n", 0, first - 1) + 1


def drawn(room: str) -> Iterator[tuple[str, str, str, str]]:
    """File, operator, old and new text of a room's changes, in the order of its seed."""
    rng = random.Random(f"{SEED} {room}")
    found = []
    for name in ROOMS[room]:
        text = (ROOT / name).read_text(encoding="utf-8")
        changes = of_python(text, rng) if name.endswith(".py") else of_c(text, rng)
        found += [(name, c.operator, *context(text, c)) for c in changes]
    rng.shuffle(found)
    yield from found


def main() -> None:
    """Print the first ones of each room."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("rooms", nargs="*", default=list(ROOMS))
    parser.add_argument("--first", type=int, default=8)
    given = parser.parse_args()
    for room in given.rooms:
        for i, (name, operator, old, new) in zip(range(1, given.first + 1), drawn(room), strict=False):
            print(f'[[mutant]]\nname = "{room}-{i}"\nfile = "{name}"\noperator = "{operator}"')
            print(f"old = '''\n{old}'''\nnew = '''\n{new}'''\n")


if __name__ == "__main__":
    main()
