"""What may stand on the command line."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NoReturn

from solver_backend.cli.camera_live_verb import add_camera_live
from solver_backend.cli.camera_verbs import add_camera_verbs
from solver_backend.cli.exit_codes import EPILOG
from solver_backend.cli.marker_verbs import add_marker_verbs
from solver_backend.cli.motion_verbs import add_motion_verbs
from solver_backend.cli.oak_verbs import add_oak_verbs
from solver_backend.cli.pose_arguments import add_pose_verbs
from solver_backend.cli.prop_verbs import add_prop_verbs
from solver_backend.cli.rig_live_verb import add_rig_live
from solver_backend.cli.sensor_verbs import add_sensor_verbs
from solver_backend.cli.setting_options import ROWS, TIME_ROWS, WORLD_ROWS, add_settings
from solver_backend.cli.studio_verbs import add_studio_verbs
from solver_backend.cli.verb_guide import show_guide
from solver_backend.cli.video_arguments import add_video_verbs, detector_options
from solver_backend.cli.wand_verbs import add_wand_verbs
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.version import VERSION


class _Parser(argparse.ArgumentParser):
    """Raises our own error where argparse would end the process."""

    def error(self, message: str) -> NoReturn:
        raise CommandLineInvalid(
            f"{message[:1].upper()}{message[1:]}.",
            where=self.prog,
            hint=" ".join(["Usage:", *self.format_usage().split()[1:]]),
        )


def parse(argv: list[str]) -> argparse.Namespace:
    """Return the parsed command line.

    Raises:
        CommandLineInvalid: it makes no sense; the hint is the usage.
    """
    return build_parser().parse_args(_with_signed_axis(argv))


def _with_signed_axis(argv: list[str]) -> list[str]:
    """Return the arguments with ``--up-axis -y`` in one, for argparse takes an axis with a sign for an option."""
    joined: list[str] = []
    for argument in argv:
        if joined and joined[-1] == "--up-axis" and argument.lower() in ("-x", "-y", "-z"):
            joined[-1] = f"--up-axis={argument}"
        else:
            joined.append(argument)
    return joined


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = _Parser(
        prog="python -m solver_backend",
        description="Turns multi-view keypoints or optical markers into the motion of an SMPL-type body.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"Manifold MoCap {VERSION}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=_Parser)
    common, reading, writing = _common(), _reading(), _writing()
    _add_solve(verbs, [reading, writing, common])
    _add_captures(verbs, common, reading, writing)
    _add_train(verbs, common)
    evaluate = verbs.add_parser(
        "evaluate", parents=[common], help="compare a motion with the ground truth in its capture"
    )
    evaluate.add_argument("capture", type=Path, metavar="CAPTURE")
    evaluate.add_argument("motion", type=Path, metavar="MOTION.npz")
    add_pose_verbs(verbs, writing, common)
    add_marker_verbs(verbs, reading, writing, common)
    add_prop_verbs(verbs, writing, common)
    add_camera_verbs(verbs, reading, writing, common)
    add_wand_verbs(verbs, writing, common)
    add_oak_verbs(verbs, writing, common)
    add_video_verbs(verbs, writing, common)
    add_sensor_verbs(verbs, writing, common)
    add_rig_live(verbs, writing, common)
    add_camera_live(verbs, detector_options(), writing, common)
    add_motion_verbs(verbs, writing, common)
    add_studio_verbs(verbs, writing, common)
    show_guide(parser, verbs)
    return parser


def _common() -> _Parser:
    options = _Parser(add_help=False)
    options.add_argument("--json", action="store_true", help="progress and result as JSON lines on standard output")
    options.add_argument("--parent-pipe", action="store_true", help=argparse.SUPPRESS)
    options.add_argument("-v", "--verbose", action="store_true", help="log details to standard error")
    return options


def _reading() -> _Parser:
    options = _Parser(add_help=False)
    options.add_argument("--fps", type=float, help="frame rate, if the capture has none")
    options.add_argument("--trim", action="store_true", default=None, help="trim all cameras to the shortest")
    options.add_argument(
        "--as-calibrated", action="store_true", default=None,
        help="use calibration and detections exactly as written, without corrections",
    )  # fmt: skip
    options.add_argument("--joint-set", metavar="NAME", help="keypoint set, when the number of keypoints fits several")
    options.add_argument("--unit", help="length unit of the recording, such as m or mm, to override the file's")
    options.add_argument("--up-axis", metavar="AXIS", help="axis that points up in the recording, if not z")
    options.add_argument("--person", metavar="NAME", help="which person to solve, when there are several (see people)")
    options.add_argument(
        "--subject-prefix", metavar="NAME[,NAME…]",
        help="label prefix of the person, when a file holds several; several prefixes are parts of one person",
    )  # fmt: skip
    options.add_argument(
        "--frames", type=int, nargs=2, metavar=("FIRST", "LAST"),
        help="only these frames of the take, from 0; with --resolve the range that is solved again",
    )  # fmt: skip
    add_settings(options, ("sync", *TIME_ROWS, *WORLD_ROWS))
    return options


def _writing() -> _Parser:
    options = _Parser(add_help=False)
    options.add_argument("--overwrite", action="store_true", default=None, help="replace results that are there")
    return options


def _add_solve(verbs: Any, parents: list[_Parser]) -> None:
    solve = verbs.add_parser(
        "solve", parents=parents, help="solve a capture and write the motion (--person all: everybody)"
    )
    solve.add_argument("capture", nargs="?", type=Path, metavar="CAPTURE", help="capture, or session of trials")
    solve.add_argument("--out", type=Path, metavar="MOTION.npz", help="motion file to write; a session's folder")
    solve.add_argument(
        "--strict", action="store_true", default=None, help="treat warnings as errors: exit code 3, nothing is written"
    )
    solve.add_argument("--report", type=Path, metavar="PAGE.html", help="also write a page about the solve")
    solve.add_argument("--subject", type=Path, metavar="SUBJECT.npz", help="person of the markers, see calibrate")
    solve.add_argument(
        "--labels",
        "--told",
        dest="told",
        type=Path,
        metavar="LABELS.json",
        help="user-assigned labels; the solver never overrides them",
    )
    solve.add_argument(
        "--start", type=Path, metavar="MOTION.npz",
        help="earlier motion of these frames to start at, of one camera before others were added",
    )  # fmt: skip
    solve.add_argument("--resolve", type=Path, metavar="MOTION.npz", help="solve a range of an earlier motion again")
    solve.add_argument(
        "--scheduler", metavar="ADDRESS", help="spread a long solve over the workers of a Dask scheduler"
    )
    solve.add_argument("--tls", type=Path, metavar="FOLDER", help="certificates of a scheduler on another host")
    solve.add_argument(
        "--job", type=Path, action="append", metavar="JOB.json",
        help="read the arguments from a job file; may be repeated",
    )  # fmt: skip
    add_settings(solve, [name for name in ROWS if name != "sync"])


def _add_captures(verbs: Any, common: _Parser, reading: _Parser, writing: _Parser) -> None:
    info = verbs.add_parser(
        "info", parents=[reading, writing, common], help="report what a capture holds and what is wrong with it"
    )
    info.add_argument("capture", type=Path, metavar="CAPTURE")
    info.add_argument("--report", type=Path, metavar="PAGE.html", help="also write a page about the capture")

    people = verbs.add_parser("people", parents=[reading, common], help="list the people that two or more views see")
    people.add_argument("capture", type=Path, metavar="CAPTURE")

    calibrate = verbs.add_parser(
        "calibrate",
        parents=[reading, writing, common],
        help="learn a person's shape and marker positions from marker takes",
    )
    calibrate.add_argument("captures", nargs="+", type=Path, metavar="TAKE", help="one or several takes of one person")
    calibrate.add_argument("--out", type=Path, required=True, metavar="SUBJECT.npz")
    add_settings(calibrate, ("body", "layout"))

    layout = verbs.add_parser(
        "layout",
        parents=[reading, writing, common],
        help="write how each marker label is read, as a file to edit",
    )
    layout.add_argument("capture", type=Path, metavar="TAKE")
    layout.add_argument("--out", type=Path, required=True, metavar="LAYOUT.json")

    convert = verbs.add_parser("convert", parents=[reading, writing, common], help="write any capture as one file")
    convert.add_argument("capture", type=Path, metavar="CAPTURE", help="capture, or session of trials")
    convert.add_argument("--out", type=Path, required=True, metavar="CAPTURE.npz", help="file; a session's folder")

    refine = verbs.add_parser(
        "refine-cameras",
        parents=[reading, writing, common],
        help="correct a calibration from the people in the capture",
    )
    refine.add_argument("capture", type=Path, metavar="CAPTURE")
    refine.add_argument("--out", type=Path, required=True, metavar="CAPTURE.npz", help="capture with corrected cameras")

    verbs.add_parser("bodies", parents=[common], help="list the bodies that can be chosen by name")

    demo = verbs.add_parser("demo-capture", parents=[writing, common], help="write the embedded synthetic capture")
    demo.add_argument("--out", type=Path, required=True, metavar="CAPTURE.npz")
    demo.add_argument("--markers", action="store_true", help="optical markers instead of keypoints in four views")


def _add_train(verbs: Any, common: _Parser) -> None:
    train = verbs.add_parser(
        "train", parents=[common], help="train a pose prior or network, or resume from a checkpoint"
    )
    train.add_argument("prior", metavar="PRIOR", help="sposer, rvposer, vposer, svae, lie_vae, gmm, ..., landmarks")
    train.add_argument("--row", default="ours", help="of the landmark networks: ours, base, ortho, bmse, democap, ...")
    train.add_argument("--width", type=int, default=0, help="of a landmark network's layers; its own if left out")
    train.add_argument(
        "--resolution", type=int, default=0, help="of the maps that published rows draw; 160 if left out"
    )
    train.add_argument(
        "--balanced-by", choices=("rvposer", "vposer"), default="rvposer",
        help="prior that finds a landmark network's rare poses, where DIR is a folder of recordings",
    )  # fmt: skip
    train.add_argument("--seconds", type=float, help="of a landmark network's training, instead of steps")
    train.add_argument("--processor", action="store_true", help="count CPU time instead of wall-clock time")
    train.add_argument("--data", type=Path, required=True, metavar="DIR", help="folder that holds motion_cmu")
    train.add_argument("--out", type=Path, default=Path("trained"), metavar="DIR", help="weights and model card")
    train.add_argument("--work", type=Path, metavar="DIR", help="checkpoint and log; OUT/PRIOR_run if left out")
    train.add_argument("--seed", type=int, default=0, help="of the first weights and every draw")
    train.add_argument("--steps", type=int, help="gradient steps in all")
    train.add_argument("--batch", type=int, help="windows a step")
    train.add_argument("--learning-rate", type=float, help="at its height")
    train.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="where the network is trained")
    train.add_argument("--workers", type=int, help="processes that draw batches ahead of the network")
    train.add_argument("--hidden", type=int, default=512, help="width of SPoser's decoder layers")
    train.add_argument(
        "--from",
        dest="start",
        type=Path,
        metavar="WEIGHTS",
        help="weights to start from: sposer, lifter; landmarks: a checkpoint",
    )
    train.add_argument("--part", choices=("encoder",), help="train this part of SPoser alone, for --from's decoder")
