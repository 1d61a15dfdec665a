"""The long run: ``python -m tests.fuzz --count 100000 --seed 0``; exits with 1 where a reader broke.

``--mutator grammar`` draws documents by the grammar of their format instead of changing files. With ``--state FILE``
the counts are kept there, and the same command goes on where an earlier one was stopped; ``--seconds`` stops it, and
``--sum`` adds several files up. The table is printed after every 20,000 inputs. ``--coverage`` prints instead which
share of the readers' lines the inputs reach, ``--bytes SECONDS`` lets atheris change bytes by what it sees executed,
``--minimise`` keeps of the corpus and of new inputs the fewest files that reach all their lines.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

from tests.fuzz.campaign import campaign, run_child
from tests.fuzz.run import BATCH, CHANGES, MUTATORS, keep, turns
from tests.fuzz.tried import Tried


def main() -> int:
    """Run what the command line asks for."""
    args = _parser().parse_args()
    if args.coverage:
        from tests.fuzz.reader_coverage import coverage_table

        sys.stdout.write(coverage_table(args.only, args.count, args.seed) + "\n")
        return 0
    if args.sum:
        return _sum(args.sum)
    if args.bytes is not None:
        return _bytes(args)
    from tests.fuzz.targets import chosen

    targets = chosen(args.only)
    if args.child is not None:
        run_child(targets, args.count, args.seed, args.first, args.child, args.mutator)
        return 0
    if args.keep is not None:
        order = turns(targets)
        sys.stdout.write(f"{keep(order[args.first % len(order)], args.seed, args.first, args.keep, args.mutator)}\n")
        return 0
    if args.minimise:
        from tests.fuzz.minimise import minimise

        for kept in minimise(targets, args.count, args.seed, args.mutator):
            sys.stdout.write(f"{kept.reader:<32}{kept.sound:>6} lines, {kept.added} more by {len(kept.files)} files\n")
        return 0
    return _long_run(args)


def _bytes(args: argparse.Namespace) -> int:
    """Let atheris run, in a process that has imported none of the readers."""
    if find_spec("atheris") is None:
        sys.stderr.write("skipped: atheris is not installed in this Python\n")
        return 0
    words = [args.only, str(args.bytes), *([str(args.state)] if args.state else [])]
    return subprocess.run([sys.executable, "-m", "tests.fuzz.instrumented", *words], check=False).returncode


def _sum(states: list[Path]) -> int:
    """Print the counts of several runs as one table."""
    whole = Tried()
    for state in states:
        whole.add(Tried.load(state)[0])
    sys.stdout.write(whole.table() + "\n")
    return int(whole.broke)


def _long_run(args: argparse.Namespace) -> int:
    tried, seed, first = Tried(), args.seed, args.first
    if args.state is not None and args.state.exists():
        tried, seed, first = Tried.load(args.state)

    def after(whole: Tried, following: int) -> None:
        sys.stdout.write(whole.table() + "\n\n")
        sys.stdout.flush()
        if args.state is not None:
            whole.save(args.state, seed, following)

    until = time.monotonic() + args.seconds
    tried = campaign(
        tried, args.first + args.count - first, seed, first, args.only, after, mutator=args.mutator,
        until=lambda: time.monotonic() > until, batch=args.batch,
    )  # fmt: skip
    return int(tried.broke)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=10_000, help="inputs in all, those of earlier runs with them")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--only", default="", help="names that begin so; 'readers': all but verbs")
    parser.add_argument("--state", type=Path, metavar="FILE", help="keep counts here, and go on from them")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin no more inputs after so long")
    parser.add_argument("--batch", type=int, default=BATCH, help="inputs a process; the table is printed after each")
    parser.add_argument("--sum", type=Path, nargs="+", metavar="FILE", help="print the counts of several runs as one")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="write the files of input --first here")
    parser.add_argument("--mutator", choices=MUTATORS, default=CHANGES, help="what makes the inputs")
    parser.add_argument("--coverage", action="store_true", help="share of the readers' lines that are reached")
    parser.add_argument("--bytes", type=float, metavar="SECONDS", help="atheris, for so long in all")
    parser.add_argument(
        "--minimise", action="store_true",
        help="of the corpus and of --count new inputs a reader, keep the fewest files that reach all their lines",
    )  # fmt: skip
    parser.add_argument("--child", type=Path, metavar="DIR", help=argparse.SUPPRESS)
    return parser


if __name__ == "__main__":
    sys.exit(main())
