"""A blind check on causes that no catalogue lists: makes a set, diagnoses it and prints its score.

python -m benchmarks.blind pair OUT --n 14              into OUT/cases, OUT/answers and OUT/score
python -m benchmarks.blind component OUT --secret HEX   the cases of an older secret again

What is made and answered already is kept. With --make-only, `zoo blind run` and `zoo blind score` can follow.
"""

from __future__ import annotations

import argparse
import secrets
from pathlib import Path

from benchmarks.blind.sets import KINDS, LAYOUTS, make_set

from zoo.blood.blind import diagnose_cases, score_cases
from zoo.core.blindcheck import score_table


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("out", type=Path)
    parser.add_argument("--n", type=int, default=14)
    parser.add_argument("--secret", default="", help="32 hexadecimal digits; drawn if absent")
    parser.add_argument("--layouts", nargs="+", default=LAYOUTS, choices=LAYOUTS)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--make-only", action="store_true")
    args = parser.parse_args()
    cases, key = args.out / "cases", args.out / "key.json"
    if not key.exists():
        args.out.mkdir(parents=True, exist_ok=True)
        secret = args.secret or secrets.token_hex(16)
        make_set(cases, key, args.kind, args.n, secret, args.layouts, args.cores)
    if not args.make_only:
        diagnose_cases(cases, args.out / "answers", cores=args.cores)
        print(score_table(score_cases(args.out / "answers", key, args.out / "score")))


if __name__ == "__main__":
    main()
