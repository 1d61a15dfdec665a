"""``python -m supply licences`` prints licences and terms, ``... lock`` writes ``requirements-ci.lock``."""

from __future__ import annotations

import argparse
import sys

from supply.licences import licence_table
from supply.lock import write_lock


def main(arguments: list[str] | None = None) -> int:
    """Run one of the verbs ``licences`` and ``lock``, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m supply", description=__doc__)
    parser.add_argument("verb", choices=("licences", "lock"))
    if parser.parse_args(arguments).verb == "licences":
        sys.stdout.write(licence_table() + "\n")
    else:
        sys.stdout.write(f"{write_lock()}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
