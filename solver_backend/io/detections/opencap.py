"""OpenCap's session: a folder a camera in ``Videos``, in it the detections of each trial in a folder of its own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from solver_backend.exchange.errors import CaptureNotRecognised
from solver_backend.io.detections.openpose import has_json_files
from solver_backend.io.recognition.camera_names import listing, natural_key

_VIDEOS, _OUTPUT = "Videos", "OutputJsons*"
"""``Videos/Cam0/OutputJsons_1x736/walk1/walk1_000000000000_keypoints.json`` of OpenCap's pipeline with OpenPose."""


def cameras(root: Path) -> dict[str, list[Path]]:
    """Return the folders of each camera's trials, {} where a folder is no session of OpenCap.

    Args:
        root: the session's folder.
    """
    found: dict[str, list[Path]] = {}
    videos = root / _VIDEOS
    for camera in sorted(videos.iterdir(), key=lambda p: natural_key(p.name)) if videos.is_dir() else ():
        outputs = camera.glob(_OUTPUT) if camera.is_dir() else ()
        trials = [folder for output in sorted(outputs) if output.is_dir() for folder in sorted(output.iterdir())]
        if trials := [folder for folder in trials if folder.is_dir() and has_json_files(folder)]:
            found[camera.name] = trials
    return found


def refuse_several(folders: Sequence[Path]) -> NoReturn:
    """Raise CaptureNotRecognised: a camera has the folders of several trials, or of one with several settings."""
    names = [f"{folder.parent.name}/{folder.name}" for folder in folders]
    raise CaptureNotRecognised(
        f"The session holds several trials: {listing(names)}.", where=str(folders[0].parents[1]),
        hint="Copy the folders of one trial of every camera into a session of its own.",
    )  # fmt: skip
