"""Declare the detectors, and the settings for making a capture from videos."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from .setting import Choice, check_settings, setting, settings_of_class

VIDEOS = "Videos"  # Name of the group.
CAMERAS = (
    Choice(
        "auto",
        "Automatic",
        "Use the calibration next to the videos, otherwise the board, otherwise the person (recommended)",
    ),
    Choice(
        "board",
        "Filmed Board",
        "Use the board in 'calibration' or 'extrinsics', for cameras that moved after calibration",
    ),
    Choice("person", "The Person", "Use the person who walks in the take, if the calibration is wrong"),
)
CLOCKS = (
    Choice("auto", "Automatic", "Use keypoints, otherwise sound, otherwise correct nothing (recommended)"),
    Choice("keypoints", "Keypoints", "Compare the person's movement, for videos without sound"),
    Choice("sound", "Sound", "Compare a clap, music or speech that all microphones recorded"),
    Choice("none", "In Step", "Correct nothing, for cameras that started together"),
)
_video = partial(setting, group=VIDEOS)


@dataclass(frozen=True, kw_only=True)
class VideoSettings:
    """Settings for information that a take's footage does not contain, for example cameras and lenses."""

    # fmt: off
    cameras: str = _video(
        "choice", "auto", "Cameras", "Source of the calibration", choices=CAMERAS, metavar="NAME")
    board: str = _video(
        "text", "", "Board", "Filmed calibration board, such as charuco:5x7:35mm, by default from board.toml",
        metavar="BOARD")
    lenses: str = _video(
        "file", "", "Lenses", "Calibration or lens library, by default found or estimated",
        metavar="FILE")
    focal: str = _video(
        "text", "", "Focal Length", "Focal length of unknown lenses: 26mm (35 mm equivalent) or 1450px, by "
        "default from the video file or estimated", metavar="26mm|1450px")
    people: int = _video("whole", 1, "People", "Maximum number of people to find in each view", low=1, high=8)
    clocks: str = _video(
        "choice", "auto", "Sync", "Source of the camera delays", choices=CLOCKS, metavar="NAME")
    """The option is --sync, which is also a solve setting for captures."""
    # fmt: on

    def __post_init__(self) -> None:
        check_settings(self)


ROWS = settings_of_class(VideoSettings)  # Every setting for videos.


@dataclass(frozen=True)
class NamedDetector:
    """A detector that the user chooses by name."""

    label: str  # Label in a panel.
    description: str  # Sentence without full stop.
    worker: str  # Module in ``pose_workers``.
    own_environment: bool = False  # True if it runs in Set Up Detector's Python, otherwise in the solver's.


LARGEST_DESCRIPTION = 16_000  # Size limit of a model description in bytes. It is a command line argument.
MEDIAPIPE = "mediapipe"  # Default detector.
DETECTORS = {
    MEDIAPIPE: NamedDetector(
        "MediaPipe",
        "33 keypoints of one person, detected in the Python environment set in the preferences",
        "mediapipe_pose",
        True,
    )
}
"""Detectors by the names that users type, in lower case."""
