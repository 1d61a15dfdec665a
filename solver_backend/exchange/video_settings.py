"""Settings from videos to a capture, declared once for the command line and the panel."""

from __future__ import annotations

from dataclasses import dataclass

from .setting import Choice, check_settings, setting, settings_of_class

VIDEOS = "Videos"  # The group.
CAMERAS = (
    Choice("auto", "Automatic", "A calibration beside the videos, else the board that was filmed, else the person"),
    Choice(
        "board", "Filmed Board", "The board in the folder 'calibration' or 'extrinsics', even if there is a calibration"
    ),
    Choice("person", "The Person", "The person who walks in the take, even if there is a calibration"),
)
CLOCKS = (
    Choice("auto", "Automatic", "By keypoints, else by sound, else as filmed"),
    Choice("keypoints", "Keypoints", "By how the person moves"),
    Choice("clap", "Hand Clap", "By a clap of the hands that all cameras saw"),
    Choice("sound", "Sound", "By a clap, music or speech that all microphones heard"),
    Choice("flash", "Flash", "By light that all cameras saw rise and fall"),
    Choice("none", "In Step", "The cameras were started together"),
)


@dataclass(frozen=True, kw_only=True)
class VideoSettings:
    """Facts that the footage of a take may lack."""

    # fmt: off
    cameras: str = setting(
        "choice", "auto", "Cameras", "How the cameras are calibrated", group=VIDEOS, choices=CAMERAS, metavar="NAME")
    board: str = setting(
        "text", "", "Board", "Which board was filmed, such as charuco:5x7:35mm; empty for the board.toml beside it",
        group=VIDEOS, metavar="BOARD")
    lenses: str = setting(
        "file", "", "Lenses", "A calibration or a lens library that has the cameras' lenses; empty to find or guess "
        "them", group=VIDEOS, metavar="FILE")
    focal: str = setting(
        "text", "", "Focal Length", "Of an unknown lens: 26mm (35 mm equivalent) or 1450px; empty to read it from the "
        "file or guess", group=VIDEOS, metavar="26mm|1450px")
    people: int = setting("whole", 1, "People", "People looked for in each view", group=VIDEOS, low=1, high=8)
    clocks: str = setting(
        "choice", "auto", "Sync", "How the cameras are synchronised", group=VIDEOS, choices=CLOCKS, metavar="NAME")
    """The option is --sync: the setting of a solve that is called so is about captures."""
    # fmt: on

    def __post_init__(self) -> None:
        check_settings(self)


ROWS = settings_of_class(VideoSettings)  # Every setting of videos.
