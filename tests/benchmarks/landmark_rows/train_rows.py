"""Train the rows of chapter 4 that build/landmark_rows lacks, for `bench landmark_rows`.

    python -m tests.benchmarks.landmark_rows.train_rows --data DATA [--device cuda] [--rows ROW ...] [--seeds 1 2 3]

An interrupted row continues from its checkpoint. On an H100, a row of 2,000 steps takes 35 to 75 s, with two at a time.
A network with one view instead of two (``democap``) has twice as many steps.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from solver_backend.body.body import load_body
from solver_backend.priors.gaussian_vae import VaeName
from tests.benchmarks.landmark_rows.row_folders import ROOT, folder_of, trained
from training.engine.loop import check_device
from training.landmarks.loop import LandmarkTraining
from training.landmarks.rows import named_rows, train_row
from training.landmarks.train import table_of

BY_VPOSER = "ortho by vposer"  # ``ortho`` with rare poses selected and blended by VPoser: table 4.6.
ROWS = (
    "base", "ortho", "bmse", "squad", "slerp", "lerp", "bezier", "bspline", "random", "σ(D)", "e(D)", "σ(R)", "e(R)",
    "e(D)+squad", "ortho fading", BY_VPOSER, "democap", "democap bmse", "democap ortho", "coordinates", "e(R)+slerp",
    "base thesis", "ortho thesis", "e(R)+slerp thesis", "squad thesis",
)  # fmt: skip
WIDTH, RESOLUTION, STEPS, BATCH, RATE = 8, 48, 2000, 64, 3e-3
"""Width, resolution, steps, batch size and learning rate: a quarter of the paper's width and a third of its pixels,
which a GPU trains in a minute per row.
"""
LONGER = 2  # Factor of the steps for networks with one view.


def main(argv: list[str] | None = None) -> int:
    """Train missing rows, the first seed of all rows first."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder that holds motion_cmu")
    parser.add_argument("--rows", nargs="+", default=ROWS, choices=ROWS, metavar="ROW")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--batch", type=int, default=BATCH)
    parser.add_argument("--out", type=Path, default=ROOT)
    args = parser.parse_args(argv)
    check_device(args.device)
    args.out.mkdir(parents=True, exist_ok=True)
    for seed in args.seeds:
        for row in args.rows:
            if (row, seed) not in trained(args.out):
                train(row, seed, args)
    return 0


def train(row: str, seed: int, args: argparse.Namespace) -> None:
    """Train a row into its folder. Its figures are written at the end."""
    balanced_by: VaeName = "vposer" if row == BY_VPOSER else "rvposer"
    chosen = named_rows(WIDTH, resolution=RESOLUTION)["ortho" if row == BY_VPOSER else row]
    steps = args.steps * (LONGER if chosen.network == "democap" else 1)
    settings = LandmarkTraining(
        steps=steps, batch=args.batch, learning_rate=RATE, seed=seed, device=args.device, graph=args.device == "cuda",
        judged=1,
    )  # fmt: skip
    begin = time.monotonic()
    table = table_of(args.data, args.out, balanced_by)
    best = train_row(chosen, table, load_body(), settings, folder_of(args.out, row, seed))
    errors = ", ".join(f"{where} {best[f'fixed {where}']['rmse_mm']:.1f} mm" for where in ("ordinary", "tail", "floor"))
    sys.stdout.write(f"{row}, seed {seed}: {errors}, {time.monotonic() - begin:.0f} s\n")
    sys.stdout.flush()


if __name__ == "__main__":
    raise SystemExit(main())
