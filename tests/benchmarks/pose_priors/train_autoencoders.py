"""Train the autoencoders of tables 4.5 and 6.5 with other seeds than the shipped ones, for `bench autoencoders`.

    python -m tests.benchmarks.pose_priors.train_autoencoders --data DATA [--rows ROW ...] [--seeds 1 2]

An interrupted training continues from its checkpoint. A training takes two to four minutes on two cores, SPoser eight.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from training.engine.loop import TrainingSettings
from training.train import train

ROOT = Path(__file__).resolve().parents[3] / "build" / "autoencoder_rows"
STEPS = {"sposer": 6000}
"""Steps of the shipped trainings. The others have 3,000."""
HIDDEN = 256  # Width of the shipped SPoser's decoder.
ROWS = ("vposer", "rvposer", "sposer", "vposer_worded", "svae", "lie_vae", "rvposer_second_norm")
"""Trained rows. The last one has no shipped weights, so its seeds are 0, 1 and 2."""


def folder_of(root: Path, row: str, seed: int) -> Path:
    """Return the folder of a training."""
    return root / f"{row}_{seed}"


def trained(root: Path) -> dict[tuple[str, int], Path]:
    """Return the weights of complete trainings by row and seed."""
    paths = {(row, seed): folder_of(root, row, seed) / f"{row}.npz" for row in ROWS for seed in range(10)}
    return {key: path for key, path in paths.items() if path.is_file()}


def main(argv: list[str] | None = None) -> int:
    """Train missing rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder that holds motion_cmu")
    parser.add_argument("--rows", nargs="+", default=ROWS, choices=ROWS, metavar="ROW")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--steps", type=int, default=0, help="instead of those of the trainings that ship")
    parser.add_argument("--out", type=Path, default=ROOT)
    args = parser.parse_args(argv)
    for row in args.rows:
        for seed in [*([0] if row == "rvposer_second_norm" else []), *args.seeds]:
            if (row, seed) in trained(args.out):
                continue
            begin = time.monotonic()
            settings = TrainingSettings(steps=args.steps or STEPS.get(row, 3000))
            train(row, args.data, folder_of(args.out, row, seed), seed=seed, settings=settings, hidden=HIDDEN)
            sys.stdout.write(f"{row}, seed {seed}: {time.monotonic() - begin:.0f} s\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
