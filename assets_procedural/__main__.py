"""Rebuild the body from the committed numbers.

``python -m assets_procedural [--out FILE] [--hands FILE] [--shown FILE]``
"""

from __future__ import annotations

import logging
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one thread adds numbers in a fixed order, so every run is identical


def main() -> None:
    """Build and write the body file, the hands file, and Blender's file of looks, facial shapes and correctives."""
    from assets_procedural.build import BODY_FILE, build_body, write_body
    from assets_procedural.hand.build import HANDS_FILE, build_hands
    from assets_procedural.shown import SHOWN_FILE, build_shown
    from solver_backend.exchange.verb import option, output, parse_script

    hands = option("path", "hands", "HANDS.npz", "File of the hands", HANDS_FILE)
    shown = option("path", "shown", "SHOWN.npz", "File of the looks, face and correctives for Blender", SHOWN_FILE)
    arguments = parse_script(__doc__, output("BODY.npz", "Body file", BODY_FILE), hands, shown)
    logging.basicConfig(level=logging.INFO, format="%(message)s", force=True)
    built = build_body()
    write_body(arguments.out, built.arrays)
    write_body(arguments.hands, build_hands(built))
    write_body(arguments.shown, build_shown(built.arrays))


if __name__ == "__main__":
    main()
