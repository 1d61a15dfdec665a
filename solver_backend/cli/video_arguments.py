"""What may stand on the command line of the verbs that begin with videos."""

from __future__ import annotations

import argparse
from pathlib import Path

from solver_backend.cli.setting_options import ROWS, WORLD_ROWS, add_settings, help_of
from solver_backend.exchange.detectors import DETECTORS, MEDIAPIPE
from solver_backend.exchange.video_settings import DEFAULTS as VIDEO_DEFAULTS
from solver_backend.exchange.video_settings import ROWS as VIDEO_ROWS


def detect_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of detect."""
    verb.add_argument(
        "videos", nargs="+", type=Path, metavar="VIDEO", help="one video for each camera, or a folder of them"
    )
    verb.add_argument("--out", type=Path, required=True, metavar="CAPTURE.npz", help="capture to write")
    verb.add_argument(
        "--calibration", type=Path, metavar="FILE", help="calibration of the cameras; the capture has none if left out"
    )
    verb.add_argument(
        "--work", type=Path, metavar="DIR", help="folder that keeps each video's detections; beside --out if left out"
    )
    add_settings(verb, WORLD_ROWS)
    verb.add_argument(
        "--preview", type=Path, metavar="DIR", help="also write videos with the keypoints drawn over them"
    )


def from_videos_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of from-videos."""
    verb.add_argument(
        "folder", type=Path, metavar="FOLDER|VIDEO",
        help="folder with takes in 'videos' and boards in 'calibration', or one video",
    )  # fmt: skip
    verb.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the results; FOLDER/mocap or VIDEO_mocap if left out"
    )
    verb.add_argument("--take", metavar="NAME", help="only this take")
    verb.add_argument("--dry-run", action="store_true", help="report what would be done, and do nothing")
    verb.add_argument(
        "--until",
        choices=("detect", "sync", "calibrate", "capture", "solve"),
        default="solve",
        help="step after which to stop",
    )
    verb.add_argument(
        "--redo", action="append", default=[], choices=("detect", "sync", "calibrate", "capture", "solve"),
        help="do this step again",
    )  # fmt: skip
    _add_choice(verb, "--cameras", "cameras")
    verb.add_argument("--board", metavar="BOARD", help=f"{help_of(VIDEO_ROWS['board'])}; see the verb board")
    verb.add_argument("--lenses", type=Path, metavar="FILE", help=help_of(VIDEO_ROWS["lenses"]))
    verb.add_argument("--focal", default="", metavar="26mm|1450px", help=help_of(VIDEO_ROWS["focal"]))
    verb.add_argument(
        "--hand-model", type=Path, metavar="MODEL.tflite",
        help="also find hands where the body has its wrists, by hand_landmark_full.tflite, and solve the fingers",
    )  # fmt: skip
    verb.add_argument(
        "--hand-python", type=Path, metavar="PATH", help="Python that has ai-edge-litert; that of --python if left out"
    )
    add_settings(verb, [*WORLD_ROWS, *(name for name in ROWS if name not in ("layout", "sync"))])


def detector_noise_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of detector-noise."""
    verb.add_argument("captures", nargs="+", type=Path, metavar="CAPTURE", help="captures of known cameras")
    verb.add_argument(
        "--detector-name", metavar="NAME", help="name of the detector; read from the captures if left out"
    )
    verb.add_argument("--out", type=Path, required=True, metavar="NOISE.json", help="noise map to write")


def find_hands_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of find-hands."""
    verb.add_argument("capture", type=Path, metavar="CAPTURE", help="calibrated capture with keypoints and footage")
    verb.add_argument(
        "--model", type=Path, required=True, metavar="MODEL.tflite", help="MediaPipe's hand_landmark_full.tflite"
    )
    verb.add_argument("--python", type=Path, metavar="PATH", help="Python that has ai-edge-litert")
    verb.add_argument("--out", type=Path, required=True, metavar="CAPTURE.npz", help="capture to write")


def detector_options(options: argparse.ArgumentParser) -> None:
    """Add which detector runs, and where."""
    others = "".join(f"{name}, " for name in DETECTORS if name != MEDIAPIPE)
    options.add_argument(
        "--detector", default=MEDIAPIPE, metavar="NAME|MODEL",
        help=f"{MEDIAPIPE} (default), {others}or a file: RTMPose, RTMO, YOLO-pose or MoveNet (.onnx), "
        "MediaPipe (.tflite)",
    )  # fmt: skip
    options.add_argument(
        "--detector-worker",
        type=Path,
        metavar="WORKER",
        help="your own detector: a program that runs in --python",
    )
    options.add_argument("--python", type=Path, metavar="PATH", help="Python to run the detector in")
    options.add_argument(
        "--people", type=int, default=VIDEO_DEFAULTS["people"], metavar="N", help=help_of(VIDEO_ROWS["people"])
    )


def footage_options(options: argparse.ArgumentParser) -> None:
    """Add how recorded videos are read and detected."""
    options.add_argument("--fps", type=float, metavar="X", help="rate of folders of pictures (default: 30)")
    options.add_argument("--hands", action="store_true", help="find hands too, and keep them with the detections")
    options.add_argument(
        "--jobs",
        type=int,
        default=0,
        metavar="N",
        help="detectors that run at the same time; one for each core if left out",
    )
    _add_choice(options, "--sync", "clocks")


def _add_choice(parser: argparse.ArgumentParser, option: str, name: str) -> None:
    row = VIDEO_ROWS[name]
    listed = "; ".join(
        f"{choice.value}: {choice.description[0].lower()}{choice.description[1:]}" for choice in row.choices
    )
    parser.add_argument(
        option, dest=name, choices=[choice.value for choice in row.choices], default=VIDEO_DEFAULTS[name],
        help=f"{help_of(row)} ({listed})",
    )  # fmt: skip
