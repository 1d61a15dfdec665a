"""Rebuild the body from the committed numbers: ``python -m assets_procedural [--out FILE]``."""

from __future__ import annotations

import argparse
import logging
import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one thread sums in one order: equal bits on every run


def main() -> None:
    """Build and write the body file."""
    from assets_procedural.build import BODY_FILE, build_body, write_body

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=BODY_FILE)
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s", force=True)
    write_body(arguments.out, build_body())


if __name__ == "__main__":
    main()
