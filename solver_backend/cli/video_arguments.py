"""What may stand on the command line of the verbs that begin with videos."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from solver_backend.cli.setting_options import ROWS, WORLD_ROWS, add_settings

VIDEO_VERBS = ("detect", "from-videos", "detector-noise", "find-hands")


def add_video_verbs(verbs: Any, writing: argparse.ArgumentParser, common: argparse.ArgumentParser) -> None:
    """Add the verbs from videos to the parser's verbs.

    Args:
        verbs: what ``add_subparsers`` returned.
        writing: options of verbs that write.
        common: options of all verbs.
    """
    detector, of_videos = detector_options(), _of_videos()
    detect = verbs.add_parser(
        "detect", parents=[detector, of_videos, writing, common], help="find keypoints in videos and write a capture"
    )
    detect.add_argument("videos", nargs="+", type=Path, metavar="VIDEO", help="one a camera, or a folder of them")
    detect.add_argument("--out", type=Path, required=True, metavar="CAPTURE.npz")
    detect.add_argument("--calibration", type=Path, metavar="FILE", help="cameras; without, the capture has none yet")
    detect.add_argument("--work", type=Path, metavar="DIR", help="where each video's detections are kept; beside --out")
    add_settings(detect, WORLD_ROWS)
    detect.add_argument("--preview", type=Path, metavar="DIR", help="also draw what was found over the videos")

    road = verbs.add_parser(
        "from-videos",
        parents=[detector, of_videos, writing, common],
        help="solve a folder of videos, or one video: detect, synchronise, calibrate, solve",
    )
    road.add_argument(
        "folder", type=Path, metavar="FOLDER|VIDEO",
        help="takes in 'videos', boards in 'calibration'; or one camera's video",
    )  # fmt: skip
    road.add_argument("--out", type=Path, metavar="DIR", help="results; FOLDER/mocap or VIDEO_mocap if left out")
    road.add_argument("--take", metavar="NAME", help="only this take")
    road.add_argument("--dry-run", action="store_true", help="report what would be done, and do nothing")
    road.add_argument(
        "--until", choices=("detect", "sync", "calibrate", "capture", "solve"), default="solve", help="last step"
    )
    road.add_argument(
        "--redo", action="append", default=[], choices=("detect", "sync", "calibrate", "capture", "solve"),
        help="do this step again",
    )  # fmt: skip
    road.add_argument(
        "--cameras", choices=("auto", "board", "person"), default="auto",
        help="calibrate from the board or the person even if a calibration exists",
    )  # fmt: skip
    road.add_argument("--board", metavar="BOARD", help="which board was filmed, see the verb board")
    road.add_argument("--lenses", type=Path, metavar="FILE", help="a calibration or a lens library with the lenses")
    road.add_argument(
        "--focal", default="", metavar="26mm|1450px",
        help="focal length of unknown lenses: 35 mm equivalent or pixels; from the file or guessed if left out",
    )  # fmt: skip
    road.add_argument("--stature", type=float, metavar="METRES", help="stature of the person, which sets the scale")
    add_settings(road, ["scale", "level", *(name for name in ROWS if name not in ("layout", "sync"))])

    noise = verbs.add_parser(
        "detector-noise", parents=[writing, common], help="measure a detector's noise at each confidence"
    )
    noise.add_argument("captures", nargs="+", type=Path, metavar="CAPTURE", help="captures of known cameras")
    noise.add_argument("--detector-name", metavar="NAME", help="what it is for; read from the captures if left out")
    noise.add_argument("--out", type=Path, required=True, metavar="NOISE.json")
    hands = verbs.add_parser(
        "find-hands", parents=[writing, common], help="find the hands of a capture's person in its footage"
    )
    hands.add_argument("capture", type=Path, metavar="CAPTURE", help="calibrated, with keypoints and footage")
    hands.add_argument("--model", type=Path, required=True, metavar="MODEL.tflite", help="hand_landmark_full.tflite")
    hands.add_argument("--python", type=Path, metavar="PATH", help="Python that has ai-edge-litert")
    hands.add_argument("--out", type=Path, required=True, metavar="CAPTURE.npz")


def detector_options() -> argparse.ArgumentParser:
    """Return the options that choose a detector."""
    options = argparse.ArgumentParser(add_help=False)
    options.add_argument(
        "--detector", default="mediapipe", metavar="NAME|MODEL.onnx",
        help="mediapipe (default), or an ONNX file of RTMPose, RTMO, YOLO-pose or MoveNet",
    )  # fmt: skip
    options.add_argument("--python", type=Path, metavar="PATH", help="Python to run the detector in")
    options.add_argument("--people", type=int, default=1, metavar="N", help="people looked for in each view")
    return options


def _of_videos() -> argparse.ArgumentParser:
    options = argparse.ArgumentParser(add_help=False)
    options.add_argument("--fps", type=float, metavar="X", help="rate of folders of pictures (default: 30)")
    options.add_argument("--hands", action="store_true", help="find hands too, and keep them with the detections")
    options.add_argument("--jobs", type=int, default=0, metavar="N", help="detectors at a time; one a core if left out")
    options.add_argument(
        "--sync", choices=("auto", "keypoints", "clap", "sound", "flash", "none"), default="auto", dest="clocks",
        help="how to synchronise the cameras (default: whatever the footage allows)",
    )  # fmt: skip
    return options
