"""Rebuild the body from the committed numbers: ``python -m assets_procedural [--out FILE] [--hands FILE]``."""

from __future__ import annotations

import argparse
import logging
import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one thread sums in one order: equal bits on every run


def main() -> None:
    """Build and write the body file and the file of its hands."""
    from assets_procedural.build import BODY_FILE, build_body, write_body
    from assets_procedural.hand.build import HANDS_FILE, build_hands

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=BODY_FILE)
    parser.add_argument("--hands", type=Path, default=HANDS_FILE)
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s", force=True)
    built = build_body()
    write_body(arguments.out, built.arrays)
    write_body(arguments.hands, build_hands(built))


if __name__ == "__main__":
    main()
