"""What may stand on the command line of the verbs that run live."""

from __future__ import annotations

import argparse
from pathlib import Path

from solver_backend.cli.oak_verbs import add_oak_options
from solver_backend.cli.sensor_verbs import add_chain_options
from solver_backend.cli.setting_options import WORLD_ROWS, add_settings

_SEND_HELP = "also send every pose by the VMC protocol; vmc:// alone is this machine, port 39539"
_SOURCE_HELP = (
    "two to four of: a video to replay, webcam:NUMBER, oak:ID; NAME=SOURCE gives the camera's name in the calibration"
)


def live_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of live."""
    verb.add_argument(
        "source",
        metavar="SOURCE",
        help="take or motion to replay at its own rate, - for lines on stdin, vmc://:PORT for poses that come there, "
        "livelink:// or ifacialmocap://PHONE for a face",
    )
    verb.add_argument("--fast", action="store_true", help="run as fast as possible, and drop no frame")
    verb.add_argument("--repeat", action="store_true", help="replay the file in a loop")
    verb.add_argument(
        "--lines", type=Path, metavar="POSES.jsonl", help="write the lines to this file, not to standard output"
    )
    verb.add_argument("--send", metavar="vmc://HOST:PORT", help=_SEND_HELP)
    verb.add_argument(
        "--record", type=Path, metavar="TAKE.c3d|MOTION.npz|FACE.csv",
        help="also record the points, to be solved afterwards, the poses that come by vmc://, or the face",
    )  # fmt: skip
    verb.add_argument("--subject", type=Path, metavar="SUBJECT.npz", help="calibrated person, see calibrate")
    verb.add_argument("--with-points", action="store_true", help="each line also holds the points, for a display")


def sensors_live_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of sensors-live."""
    verb.add_argument("source", nargs="?", type=Path, metavar="FOLDER", help="a recording, or a shot of the studio")
    verb.add_argument("--oak", action="append", metavar="ID[=NAME]", help="a camera, instead of FOLDER")
    add_oak_options(verb)
    verb.add_argument("--poses", action="store_true", help="fit a body to the points, and write lines as live does")
    verb.add_argument("--send", metavar="vmc://HOST:PORT", help=f"with --poses: {_SEND_HELP}")
    verb.add_argument("--wand", action="store_true", help="report the wand's coverage, and where to wave it next")
    verb.add_argument("--with-points", action="store_true", help="each line of a pose also holds the points")
    verb.add_argument("--subject", type=Path, metavar="SUBJECT.npz", help="calibrated person, see calibrate")
    verb.add_argument(
        "--lines", type=Path, metavar="LINES.jsonl", help="write the lines to this file, not to standard output"
    )
    verb.add_argument("--record", type=Path, metavar="FOLDER", help="also record the sensors' frames")
    verb.add_argument("--solve", type=Path, metavar="MOTION.npz", help="solve the recording with the bundle afterwards")
    verb.add_argument("--repeat", action="store_true", help="replay the folder in a loop")
    verb.add_argument("--seconds", type=float, help="stop after this many seconds")
    add_chain_options(verb)


def camera_live_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of camera-live."""
    verb.add_argument("sources", nargs="+", metavar="[NAME=]SOURCE", help=_SOURCE_HELP)
    verb.add_argument("--calibration", type=Path, required=True, metavar="FILE", help="calibration of the cameras")
    verb.add_argument("--up-axis", metavar="AXIS", help="axis of the calibration that points up, if not z")
    verb.add_argument(
        "--rate", type=float, default=30.0, metavar="HZ", help="largest number of poses per second (default 30)"
    )
    verb.add_argument("--repeat", action="store_true", help="replay the videos in a loop")
    verb.add_argument("--seconds", type=float, help="stop after this many seconds")
    verb.add_argument("--subject", type=Path, metavar="SUBJECT.npz", help="calibrated person, see calibrate")
    verb.add_argument("--send", metavar="vmc://HOST:PORT", help=_SEND_HELP)
    verb.add_argument(
        "--lines", type=Path, metavar="LINES.jsonl", help="write the lines to this file, not to standard output"
    )
    verb.add_argument("--with-points", action="store_true", help="each line also holds points and doubt, for a display")
    verb.add_argument(
        "--record", type=Path, metavar="TAKE.npz",
        help="also record keypoints and times as a capture, and the poses as TAKE_live.npz, for solve --start",
    )  # fmt: skip
    add_settings(verb, WORLD_ROWS)
