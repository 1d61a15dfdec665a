"""What may stand on the command line of the verbs that use Pose-NDF."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

POSE_VERBS = ("denoise", "complete", "sample", "interpolate")


def add_pose_verbs(verbs: Any, writing: argparse.ArgumentParser, common: argparse.ArgumentParser) -> None:
    """Add denoise, complete, sample and interpolate to the parser's verbs.

    Args:
        verbs: what ``add_subparsers`` returned.
        writing: options of verbs that write.
        common: options of all verbs.
    """
    using = argparse.ArgumentParser(add_help=False)
    using.add_argument("--prior", type=Path, metavar="WEIGHTS.npz", help="Pose-NDF's weights, if not those that ship")
    parents = [using, writing, common]

    denoise = verbs.add_parser("denoise", parents=parents, help="denoise a motion with Pose-NDF")
    _motion_in_and_out(denoise)
    denoise.add_argument("--smoothness", type=float, metavar="λ", help="weight of smoothness against the data's 1")
    denoise.add_argument("--manifold", type=float, metavar="λ", help="weight of plausibility against the data's 1")
    denoise.add_argument("--keep-root", action="store_true", help="leave where the body stands and faces as it is")

    complete = verbs.add_parser("complete", parents=parents, help="fill in unknown joint rotations with Pose-NDF")
    _motion_in_and_out(complete)
    complete.add_argument(
        "--missing", nargs="+", required=True, metavar="JOINT", help="joints, or limbs such as left_arm, right_leg"
    )
    complete.add_argument("--seed", type=int, default=0, help="of the start poses")

    sample = verbs.add_parser("sample", parents=parents, help="draw random plausible poses with Pose-NDF")
    sample.add_argument("out", type=Path, metavar="OUT.npz", help="motion file to write")
    sample.add_argument("--count", type=int, default=20, metavar="N", help="how many (default 20)")
    sample.add_argument("--seed", type=int, default=0, help="the same seed gives the same poses")

    between = verbs.add_parser(
        "interpolate", parents=parents, help="generate the transition between two frames with Pose-NDF"
    )
    _motion_in_and_out(between)
    between.add_argument("--frames", type=int, nargs=2, required=True, metavar=("A", "B"), help="frames, from 0")
    between.add_argument("--count", type=int, required=True, metavar="N", help="how many frames lie between")


def _motion_in_and_out(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("motion", type=Path, metavar="MOTION.npz", help="motion file to read")
    parser.add_argument("out", type=Path, metavar="OUT.npz", help="motion file to write")
