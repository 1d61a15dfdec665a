"""What may stand on the command line of the verbs that use Pose-NDF."""

from __future__ import annotations

import argparse
from pathlib import Path


def prior_options(options: argparse.ArgumentParser) -> None:
    """Add what the verbs that use Pose-NDF share."""
    options.add_argument("--prior", type=Path, metavar="WEIGHTS.npz", help="Pose-NDF's weights, if not those that ship")


def denoise_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of denoise."""
    _motion_in_and_out(verb)
    verb.add_argument("--smoothness", type=float, metavar="λ", help="weight of smoothness against the data's 1")
    verb.add_argument("--manifold", type=float, metavar="λ", help="weight of plausibility against the data's 1")
    verb.add_argument("--keep-root", action="store_true", help="keep the body's place and heading as they are")


def complete_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of complete."""
    _motion_in_and_out(verb)
    verb.add_argument(
        "--missing", nargs="+", required=True, metavar="JOINT", help="joints, or limbs such as left_arm, right_leg"
    )
    verb.add_argument("--seed", type=int, default=0, help="seed of the start poses")


def sample_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of sample."""
    verb.add_argument("out", type=Path, metavar="OUT.npz", help="motion file to write")
    verb.add_argument("--count", type=int, default=20, metavar="N", help="number of poses (default 20)")
    verb.add_argument("--seed", type=int, default=0, help="the same seed gives the same poses")


def interpolate_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of interpolate."""
    _motion_in_and_out(verb)
    verb.add_argument(
        "--frames", type=int, nargs=2, required=True, metavar=("A", "B"), help="the two frames, counted from 0"
    )
    verb.add_argument("--count", type=int, required=True, metavar="N", help="number of frames to make between them")


def fit_keypoints_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of fit-keypoints."""
    verb.add_argument("capture", type=Path, metavar="CAPTURE", help="calibrated views of one person, one or several")
    _motion_in_and_out(verb)
    verb.add_argument(
        "--noise-px",
        type=float,
        default=5.0,
        metavar="PX",
        help="standard deviation of a detection in pixels (default 5)",
    )
    verb.add_argument("--manifold", type=float, default=100.0, metavar="λ", help="weight of plausibility (default 100)")
    verb.add_argument(
        "--constant", action="store_true", help="keep the weight constant, not growing with the distance (eq. 11)"
    )


def _motion_in_and_out(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("motion", type=Path, metavar="MOTION.npz", help="motion file to read")
    parser.add_argument("out", type=Path, metavar="OUT.npz", help="motion file to write")
