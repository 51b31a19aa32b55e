"""As many damaged files as one likes, in this process: `python -m scripts.fuzz --count 5000`.

Prints every file that was answered otherwise than by results or one line, with the seed that makes it again. Exit 1 if
there was one.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.fuzz.mutations import KINDS, Workshop

SHARES = {"camera": 8, "dataset": 5, "picture": 9, "prediction": 6, "weights": 2, "motion": 8}


def main() -> int:
    """Runs the mutations."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=5000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument("--kind", choices=sorted(KINDS), help="one kind only")
    args = parser.parse_args()
    kinds = [args.kind] if args.kind else [kind for kind, share in SHARES.items() for _ in range(share)]
    problems: Counter[str] = Counter()
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        shop = Workshop(Path(folder) / "shop")
        for number in range(args.first, args.first + args.count):
            attempt = shop.attempt(kinds[number % len(kinds)], number)
            if attempt.problem is not None:
                problems[attempt.kind] += 1
                print(f"{attempt.kind} {attempt.name}, seed {attempt.seed}: {attempt.problem}", flush=True)
    seconds = time.monotonic() - started
    print(f"{args.count} damaged files in {seconds:.0f} s; answered wrongly: {dict(problems) or 'none'}")
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
