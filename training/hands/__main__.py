"""The command that trains the hand prior."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from training.hands.train import train_hands


def main(arguments: list[str] | None = None) -> int:
    """Train the hand prior, write it and its model card, and print the figures."""
    parser = argparse.ArgumentParser(prog="python -m training.hands", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of recorded and keyed hands")
    parser.add_argument("--out", type=Path, required=True, help="folder of the weights and their model card")
    options = parser.parse_args(arguments)
    for name, value in train_hands(options.data, options.out).items():
        sys.stdout.write(f"{name} {value:.4g}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
