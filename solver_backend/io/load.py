"""Read a capture, whatever it is: our own file, a Pose2Sim trial, or folders of OpenPose JSON with a calibration."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import CaptureNotRecognised, JobInvalid, TooFewViews
from solver_backend.exchange.progress import Progress, silent
from solver_backend.io.calibration.search import find_calibration, levels_above
from solver_backend.io.captures.openpose_json import read_detections
from solver_backend.io.captures.pose2sim import TrialConfig, camera_folders, read_config, trials_below
from solver_backend.io.footage.footage import find_footage, headers, with_sizes_of
from solver_backend.io.footage.mp4 import VideoHeader
from solver_backend.io.native.capture_file import read_capture
from solver_backend.io.recognition.camera_names import listing
from solver_backend.io.recognition.world_check import check_world
from solver_backend.people.person_selection import select_person
from solver_backend.types import Capture, JointSet

DEFAULT_FPS = 60.0
READABLE = (
    "our own capture .npz; a Pose2Sim trial folder (pose/<camera>_json/*.json with a calibration); "
    "a folder with one folder of OpenPose JSON for each camera and a calibration beside them"
)
"""What is recognised, for messages."""


def load_capture(
    path: Path | str,
    *,
    fps: float | None = None,
    trim: bool = False,
    joint_set: JointSet | None = None,
    unit: str | None = None,
    up_axis: str | None = None,
    progress: Progress = silent,
) -> Capture:
    """Read a capture and choose the person to solve.

    Args:
        path: file or folder.
        fps: frames per second; None takes what the recording says.
        trim: cut cameras of different lengths to the frames all have.
        joint_set: what the keypoints are; None takes what the recording says, or tells it from the data.
        unit: length unit of the calibration; None tells it from the file.
        up_axis: axis of the calibration's world that points up; None is Z.
        progress: told how far reading has come.

    Returns:
        A capture that can be triangulated, with notes on what was assumed and problems the user should know.

    Raises:
        CaptureNotRecognised: the path is nothing we read.
        CalibrationMissing, CalibrationMismatch, CalibrationInvalid: see ``find_calibration``.
        FrameCountMismatch, KeypointCountMismatch, FileDamaged, NonFiniteData: see ``read_detections``.
        TooFewViews, NoDetections: fewer than two views hold detections, or no two agree on anybody.
        JobInvalid: the frame rate is not positive.
    """
    path = Path(os.path.abspath(path))
    if fps is not None and not (np.isfinite(fps) and fps > 0):
        raise JobInvalid(f"The frame rate must be a positive number, not {fps}.", where="fps")
    if path.is_dir():
        capture = _load_folder(path, fps, trim, joint_set, (unit, up_axis), progress)
    elif path.suffix.lower() == ".npz" and path.is_file():
        capture = _load_file(path, fps, joint_set)
    else:
        what = "is not a capture we can read" if path.exists() else "does not exist"
        raise CaptureNotRecognised(f"The path {what}.", where=str(path), hint=f"Captures are {READABLE}.")
    if capture.keypoints is not None:
        capture.require_multiview()
    if capture.num_frames == 1:
        capture = replace(capture, problems=(*capture.problems, "The take is a single frame: a pose, not a motion."))
    return capture


def _load_file(path: Path, fps: float | None, joint_set: JointSet | None) -> Capture:
    capture = read_capture(path)
    if capture.keypoints is None:
        return capture
    changed = replace(
        capture.keypoints, fps=fps or capture.keypoints.fps, joint_set=joint_set or capture.keypoints.joint_set
    )
    return replace(capture, keypoints=changed, sources=capture.sources or (str(path),))


def _load_folder(
    root: Path,
    fps: float | None,
    trim: bool,
    joint_set: JointSet | None,
    world: tuple[str | None, str | None],
    progress: Progress,
) -> Capture:
    folders = camera_folders(root)
    if not folders:
        raise _not_recognised(root)
    if len(folders) < 2:
        raise TooFewViews(
            f"Only one camera is recorded, {listing(folders)}; two are needed.",
            where=str(root),
            hint="Add the folder of another camera.",
        )
    levels = levels_above(root)
    config = read_config(levels)
    calibration = find_calibration(root, tuple(folders), unit=world[0], up_axis=world[1])
    detections = read_detections(
        folders, joint_set=joint_set, configured=config.joint_set, trim=trim, progress=progress
    )
    footage = find_footage(levels[:2], tuple(folders))
    videos = headers(footage)
    calibration = with_sizes_of(calibration, videos, detections)
    rate, rate_notes, rate_problems = _frame_rate(fps, config, videos)
    person = select_person(calibration.cameras, detections, rate, progress)
    world_check = check_world(calibration.cameras, person.keypoints)
    return Capture(
        name=root.name,
        cameras=calibration.cameras,
        keypoints=person.keypoints,
        footage=footage if any(footage) else (),
        sources=(*(str(folder) for folder in folders.values()), str(calibration.source), *config.sources),
        notes=(*calibration.notes, *detections.notes, *rate_notes, *person.notes, *world_check.notes()),
        problems=(
            *calibration.problems, *detections.problems, *rate_problems,
            *_length_problems(config, videos, detections.num_frames), *person.problems, *world_check.problems(),
        ),
    )  # fmt: skip


def _not_recognised(root: Path) -> CaptureNotRecognised:
    trials = trials_below(root)
    if trials:
        return CaptureNotRecognised(
            "The folder is not a recording but holds several.", where=str(root), hint=f"Choose one: {listing(trials)}."
        )
    return CaptureNotRecognised(
        "The folder holds no folders of detections.", where=str(root), hint=f"Captures are {READABLE}."
    )


def _frame_rate(
    given: float | None, config: TrialConfig, videos: Sequence[VideoHeader | None]
) -> tuple[float, tuple[str, ...], tuple[str, ...]]:
    """Return the frame rate, how it was told, and what is doubtful about it."""
    rates = [round(header.fps, 3) for header in videos if header is not None]
    problems: list[str] = []
    if len(set(rates)) > 1:
        problems.append(f"The videos have different frame rates: {listing(f'{rate:g}' for rate in rates)} fps.")
    video = float(np.median(rates)) if rates else None
    if given is not None:
        return given, (f"{given:g} frames a second, as given.",), tuple(problems)
    if config.fps is not None:
        if video is not None and abs(video - config.fps) > 0.02 * config.fps:
            problems.append(f"Config.toml says {config.fps:g} fps, the videos {video:g}; {config.fps:g} is used.")
        return config.fps, (f"{config.fps:g} frames a second, from Config.toml.",), tuple(problems)
    if video is not None:
        return video, (f"{video:g} frames a second, from the videos.",), tuple(problems)
    problems.append(f"Neither Config.toml nor a video states the frame rate; {DEFAULT_FPS:g} fps is assumed.")
    return DEFAULT_FPS, (), tuple(problems)


def _length_problems(config: TrialConfig, videos: Sequence[VideoHeader | None], frames: int) -> tuple[str, ...]:
    problems: list[str] = []
    lengths = sorted({header.num_frames for header in videos if header is not None})
    if lengths and lengths != [frames]:
        problems.append(f"The videos have {listing(str(n) for n in lengths)} frames, the detections {frames}.")
    if config.frame_range:
        first, last = config.frame_range
        problems.append(f"Config.toml restricts the frames to {first}-{last}; all are read.")
    return tuple(problems)
