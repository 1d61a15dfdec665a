"""The long run: ``python -m tests.fuzz --count 1000000 --state counts.json``; exits with 1 where a target broke.

The targets get equal shares of time, and the mutators take turns. With ``--state FILE`` the counts are kept there after
every worker, and the same command goes on where an earlier one was stopped; ``--seconds`` stops it. ``--keep DIR``
writes the files of one input for a look. ``--guided`` lets atheris change bytes by what it sees executed, and with
``--grow`` what reaches new lines is added to the corpus.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

_LINE_S = 5.0  # Seconds between two lines that say how far the run is.


def main() -> int:
    """Run what the command line asks for."""
    args = _parser().parse_args()
    if args.guided is not None:
        return _guided(args)
    from tests.fuzz.driver import campaign, keep
    from tests.fuzz.targets import chosen
    from tests.fuzz.tried import Tried

    targets = chosen(args.only)
    if args.keep is not None:
        sys.stdout.write(f"{keep(targets[0], args.seed, args.first, args.keep)}\n")
        return 0
    said = time.monotonic()

    def after(whole: Tried) -> None:
        nonlocal said
        if args.state is not None:
            whole.save(args.state)
        if time.monotonic() - said > _LINE_S:
            said = time.monotonic()
            sys.stdout.write(whole.line() + "\n")
            sys.stdout.flush()

    tried = Tried() if args.state is None else Tried.load(args.state)
    campaign(targets, tried, args.count, args.seed, after, args.seconds)
    sys.stdout.write(tried.table() + "\n")
    return int(tried.broke)


def _guided(args: argparse.Namespace) -> int:
    """Let atheris run, in a process that has imported none of the readers."""
    if find_spec("atheris") is None:
        sys.stderr.write("skipped: atheris is not installed in this Python\n")
        return 0
    words = [args.only, str(args.guided), str(args.state or ""), "grow" * args.grow]
    return subprocess.run([sys.executable, "-m", "tests.fuzz.guided", *words], check=False).returncode


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=10_000, help="inputs in all, those of earlier runs with them")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="names that begin so; 'readers': all but verbs")
    parser.add_argument("--state", type=Path, metavar="FILE", help="keep counts here, and go on from them")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin no more workers after so long")
    parser.add_argument("--guided", type=float, metavar="SECONDS", help="atheris, for so long in all")
    parser.add_argument("--grow", action="store_true", help="add what atheris finds to the corpus")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="write the files of input --first of one target here")
    parser.add_argument("--first", type=int, default=0, help="number of the input to keep")
    return parser


if __name__ == "__main__":
    sys.exit(main())
