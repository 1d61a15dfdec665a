"""Train a network on a narrow and on a varied source with equal numbers of poses, for `bench landmark_sources`.

    python -m tests.benchmarks.landmark_rows.train_sources --data DATA [--device cuda] [--seeds 1 2 3] [--steps 500]

Tables 1 and 7 of the paper compare recordings of two people (CNRS) with recordings of many. Here, the walks, runs and
jumps of CMU's subjects 16 and 35 are compared with as many distinct poses of all its subjects. The network on
coordinates trains in a minute of processor time. An interrupted training continues from its checkpoint.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.priors.gaussian_vae import load_vae
from tests.benchmarks.landmark_rows.row_folders import ROOT, folder_of, trained
from training.data.corpus import HELD_OUT
from training.data.sources.clips import Clip, load_clips, load_far_clips
from training.engine.loop import check_device
from training.landmarks.loop import LandmarkTraining
from training.landmarks.poses import HELD_TAKES, PoseTable, pose_table
from training.landmarks.rows import named_rows, train_row

OUT = ROOT.with_name("landmark_sources")
NARROW = frozenset({"16", "35"})
"""Subjects who only walk, run and jump in the corpus."""
SOURCES = ("many people", "two people")
STEPS, BATCH, RATE = 500, 64, 3e-3


def main(argv: list[str] | None = None) -> int:
    """Train missing sources, the first seed of both sources first."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder that holds motion_cmu")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--out", type=Path, default=OUT)
    args = parser.parse_args(argv)
    check_device(args.device)
    args.out.mkdir(parents=True, exist_ok=True)
    for seed in args.seeds:
        for source in SOURCES:
            if (source, seed) not in trained(args.out):
                best = train(source, seed, args)
                errors = ", ".join(
                    f"{where} {best[f'fixed {where}']['rmse_mm']:.1f} mm" for where in ("ordinary", "tail")
                )
                sys.stdout.write(f"{source}, seed {seed}: {errors}\n")
                sys.stdout.flush()
    return 0


def train(source: str, seed: int, args: argparse.Namespace) -> dict[str, Any]:
    """Train on a source into its folder, and return the figures."""
    settings = LandmarkTraining(
        steps=args.steps, batch=BATCH, learning_rate=RATE, seed=seed, device=args.device,
        graph=args.device == "cuda", judged=1,
    )  # fmt: skip
    row = replace(named_rows(1)["coordinates"], name=source)
    return train_row(
        row, source_tables(args.data, args.out)[source], load_body(), settings, folder_of(args.out, source, seed)
    )


def source_tables(data: Path, out: Path) -> dict[str, PoseTable]:
    """Return each source's table, with equal numbers of training poses and the same evaluation poses."""
    paths = {source: out / f"{source.replace(' ', '_')}.npz" for source in SOURCES}
    if not all(path.is_file() for path in paths.values()):
        for source, table in evened(load_clips(data, fitted=False), load_far_clips(data)).items():
            table.write(paths[source])
    return {source: PoseTable.read(path) for source, path in paths.items()}


def evened(clips: list[Clip], far: list[Clip], narrow: frozenset[str] = NARROW) -> dict[str, PoseTable]:
    """Return the tables of all clips and of some subjects' clips, with equal numbers of training poses."""
    prior = load_vae("rvposer")
    whole = pose_table(clips, far, prior)
    held = [clip for clip in clips if clip.subject in HELD_OUT or clip.name.startswith(HELD_TAKES)]
    few = pose_table([*held, *(clip for clip in clips if clip.subject in narrow)], far, prior)
    count = min(len(table.arrays["training"]) for table in (whole, few))
    rng, found = np.random.default_rng(0), {}
    for source, table in zip(SOURCES, (whole, few), strict=True):
        chosen = np.sort(rng.permutation(len(table.arrays["training"]))[:count])
        own = {name: table.arrays[name][chosen] for name in ("training", "mahalanobis", "reconstruction")}
        found[source] = PoseTable(dict(whole.arrays) | own)
    return found


if __name__ == "__main__":
    raise SystemExit(main())
