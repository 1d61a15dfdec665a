"""What may stand on the command line of the verbs that solve, look at captures and train."""

from __future__ import annotations

import argparse
from pathlib import Path

from solver_backend.cli.setting_options import ROWS, add_settings

CAPTURE_HELP = "capture: a folder or file of keypoints or markers"


def solve_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of solve."""
    verb.add_argument("capture", nargs="?", type=Path, metavar="CAPTURE", help="capture, or session of trials")
    verb.add_argument("--out", type=Path, metavar="MOTION.npz", help="motion file to write; a folder for a session")
    verb.add_argument(
        "--strict", action="store_true", default=None, help="treat warnings as errors: exit code 3, nothing is written"
    )
    verb.add_argument("--report", type=Path, metavar="PAGE.html", help="also write a page about the solve")
    verb.add_argument("--subject", type=Path, metavar="SUBJECT.npz", help="person of the markers, see calibrate")
    add_labels(verb)
    verb.add_argument(
        "--start", type=Path, metavar="MOTION.npz",
        help="earlier motion of these frames to start from, such as that of one camera",
    )  # fmt: skip
    verb.add_argument("--resolve", type=Path, metavar="MOTION.npz", help="solve --frames of an earlier motion again")
    verb.add_argument("--scheduler", metavar="ADDRESS", help="spread a long solve over the workers of a Dask scheduler")
    verb.add_argument("--tls", type=Path, metavar="FOLDER", help="certificates of a scheduler on another host")
    verb.add_argument(
        "--job", type=Path, action="append", metavar="JOB.json",
        help="read the arguments from a job file; may be repeated",
    )  # fmt: skip
    add_settings(verb, [name for name in ROWS if name != "sync"])


def add_labels(verb: argparse.ArgumentParser) -> None:
    """Add the file of labels that a user assigned."""
    help = "user-assigned labels; the solver never overrides them"
    verb.add_argument("--labels", type=Path, metavar="LABELS.json", help=help)


def info_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of info."""
    verb.add_argument("capture", type=Path, metavar="CAPTURE", help=CAPTURE_HELP)
    verb.add_argument("--report", type=Path, metavar="PAGE.html", help="also write a page about the capture")


def people_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of people."""
    verb.add_argument("capture", type=Path, metavar="CAPTURE", help=CAPTURE_HELP)


def calibrate_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of calibrate."""
    verb.add_argument("captures", nargs="+", type=Path, metavar="TAKE", help="one or several takes of one person")
    verb.add_argument("--out", type=Path, required=True, metavar="SUBJECT.npz", help="calibrated person to write")
    add_settings(verb, ("body", "layout"))


def layout_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of layout."""
    verb.add_argument("capture", type=Path, metavar="TAKE", help="recording of markers")
    verb.add_argument("--out", type=Path, required=True, metavar="LAYOUT.json", help="file to write, to be edited")


def convert_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of convert."""
    verb.add_argument("capture", type=Path, metavar="CAPTURE", help="capture, or session of trials")
    verb.add_argument(
        "--out", type=Path, required=True, metavar="CAPTURE.npz", help="capture to write; a folder for a session"
    )


def refine_cameras_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of refine-cameras."""
    verb.add_argument("capture", type=Path, metavar="CAPTURE", help=CAPTURE_HELP)
    verb.add_argument("--out", type=Path, required=True, metavar="CAPTURE.npz", help="capture with corrected cameras")


def demo_capture_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of demo-capture."""
    verb.add_argument("--out", type=Path, required=True, metavar="CAPTURE.npz", help="capture to write")
    verb.add_argument("--markers", action="store_true", help="optical markers instead of keypoints in four views")


def evaluate_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of evaluate."""
    verb.add_argument("capture", type=Path, metavar="CAPTURE", help=CAPTURE_HELP)
    verb.add_argument("motion", type=Path, metavar="MOTION.npz", help="motion that was solved from it")


def train_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of train."""
    verb.add_argument(
        "prior", metavar="PRIOR", help="what to train: sposer, rvposer, vposer, svae, lie_vae, gmm, ..., landmarks"
    )
    verb.add_argument("--row", default="ours", help="landmark network to train: ours, base, ortho, bmse, democap, ...")
    verb.add_argument(
        "--width", type=int, default=0, help="width of the landmark network's layers; its own if left out"
    )
    verb.add_argument(
        "--resolution", type=int, default=0, help="pixels of the maps that published rows draw; 160 if left out"
    )
    verb.add_argument(
        "--balanced-by", choices=("rvposer", "vposer"), default="rvposer",
        help="prior that finds a landmark network's rare poses, where DIR is a folder of recordings",
    )  # fmt: skip
    verb.add_argument("--seconds", type=float, help="how long to train a landmark network, instead of --steps")
    verb.add_argument("--processor", action="store_true", help="count CPU time, not wall-clock time, for --seconds")
    verb.add_argument("--data", type=Path, required=True, metavar="DIR", help="folder that holds motion_cmu")
    verb.add_argument(
        "--out", type=Path, default=Path("trained"), metavar="DIR", help="folder for the weights and the model card"
    )
    verb.add_argument(
        "--work", type=Path, metavar="DIR", help="folder for checkpoint and log; OUT/PRIOR_run if left out"
    )
    verb.add_argument("--seed", type=int, default=0, help="seed of the first weights and of every draw")
    verb.add_argument("--steps", type=int, help="gradient steps in all")
    verb.add_argument("--batch", type=int, help="windows in a step")
    verb.add_argument("--learning-rate", type=float, help="largest learning rate")
    verb.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="where the network is trained")
    verb.add_argument("--workers", type=int, help="processes that draw batches ahead of the network")
    verb.add_argument("--hidden", type=int, default=512, help="width of SPoser's decoder layers")
    verb.add_argument(
        "--from",
        dest="start",
        type=Path,
        metavar="WEIGHTS",
        help="weights to start from (sposer, lifter), or a checkpoint (landmarks)",
    )
    verb.add_argument("--part", choices=("encoder",), help="train this part of SPoser alone, for --from's decoder")
