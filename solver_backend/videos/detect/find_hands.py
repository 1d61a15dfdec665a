"""Hands in the footage of a capture, looked for where its body has the wrists."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.cameras.triangulation.triangulate import triangulate
from solver_backend.exchange.errors import CaptureInvalid
from solver_backend.exchange.hand_points import NUM_HAND_POINTS, SIDES
from solver_backend.exchange.progress import Progress, silent
from solver_backend.types import UNSEEN_POINT, Cameras, Capture
from solver_backend.videos.detect.choice import DetectorChoice
from solver_backend.videos.detect.hand_crops import HandCrop, first_crop, second_crop
from solver_backend.videos.detect.process import DetectorProcess
from solver_backend.videos.files.probe import probe
from solver_backend.videos.files.read import Picture, read_pictures

PRESENT = 0.5
"""Presence from which a hand is one."""
AWAY_M = 0.1
"""A hand that was followed has its wrist so near the arm's at most."""
_STEP = 25
"""Frames from one report of progress to the next; chosen by hand."""

Look = Callable[[np.ndarray], tuple[np.ndarray, float]]
"""(224, 224, 3) crop -> (21, 2) points in it, and presence 0 to 1."""


def find_hands(capture: Capture, choice: DetectorChoice, progress: Progress = silent) -> Capture:
    """Return the capture with the hands that its footage shows.

    Wrists and elbows are triangulated; in every view a crop is placed from them, turned upright, mirrored for the left
    hand, and placed once more from what was found. Nobody else's hand is looked for.

    Args:
        capture: calibrated cameras, keypoints and footage.
        choice: a detector of hands in crops.
        progress: called with the pictures that are done.

    Raises:
        CaptureInvalid: it has no footage.
        TooFewViews, NoDetections: see ``Capture.require_multiview``.
        BackendMissing, VideoUnreadable: see ``read_pictures``.
        DetectorMissing, DetectorOutputsUnknown, DetectorFailed: see ``DetectorProcess``.
    """
    cameras, keypoints = capture.require_multiview()
    if not any(capture.footage):
        raise CaptureInvalid("The capture names no footage.", where=capture.name, hint="Read it from its folder again.")
    arms = arms_of(capture)
    hands = np.full((len(cameras), keypoints.num_frames, 2, NUM_HAND_POINTS, 3), np.nan)
    firsts = capture.footage_first or (0,) * len(cameras)
    total = keypoints.num_frames * sum(path is not None for path in capture.footage)
    done = 0
    for view, path in enumerate(capture.footage):
        if path is None:
            continue
        with DetectorProcess(choice) as process:

            def look(crop: np.ndarray, process: DetectorProcess = process) -> tuple[np.ndarray, float]:
                found = process.detect(crop, 0.0)
                return found["points"].astype(np.float64), float(found["presence"][0])

            for frame, picture in _frames(path, firsts[view], keypoints.num_frames):
                before = hands[view, frame - 1] if frame else None
                hands[view, frame] = look_at(picture.rgb, cameras, view, arms[:, frame], look, before)
                if frame % _STEP == 0:
                    progress("Finding hands", done + frame, total)
        done += keypoints.num_frames
    progress("Finding hands", total, total)
    return replace(capture, keypoints=replace(keypoints, hands=hands))


def seen_by_two(capture: Capture) -> dict[str, float]:
    """Return the share of the frames, per cent, in which two views or more show a hand, by side."""
    assert capture.keypoints is not None and capture.keypoints.hands is not None
    views = (capture.keypoints.hands[..., 2] > 0).any(axis=-1).sum(axis=0)
    return {side: round(100.0 * float((views[:, s] >= 2).mean()), 1) for s, side in enumerate(SIDES)}


def look_at(
    rgb: np.ndarray, cameras: Cameras, view: int, arms: np.ndarray, look: Look, before: np.ndarray | None = None
) -> np.ndarray:
    """Return (2, 21, 3) x, y and confidence of both hands in a picture; unseen where there is none.

    Args:
        rgb: (H, W, 3) uint8.
        cameras: of the take.
        view: which of them took it.
        arms: (2, 2, 3) metres: elbow and wrist, of each side.
        look: finds a hand in a crop.
        before: (2, 21, 3) what the picture before showed: a hand that is still there is looked for once.
    """
    found = np.tile(np.array(UNSEEN_POINT), (2, NUM_HAND_POINTS, 1))
    px = project(cameras.K, cameras.distortion, cameras.R, cameras.t, arms, cameras.distortion_model)[view]
    depth = arms[1] @ cameras.R[view, 2] + cameras.t[view, 2]
    for side in range(len(SIDES)):
        elbow, wrist = px[0, side], px[1, side]
        inside = np.isfinite(wrist).all() and ((wrist >= 0) & (wrist < rgb.shape[1::-1])).all()
        if not inside or not np.isfinite(elbow).all() or depth[side] <= 0.1:
            continue
        if before is not None and before[side, 0, 2] > 0:
            points, presence = _in_crop(rgb, second_crop(before[side, :, :2], side), look)
            reach = AWAY_M * float(cameras.K[view, 0, 0]) / float(depth[side])
            if presence >= PRESENT and np.linalg.norm(points[0] - wrist) < reach:
                found[side] = np.column_stack([points, np.full(len(points), presence)])
                continue
        points, presence = _in_crop(rgb, first_crop(cameras, view, wrist, elbow, float(depth[side]), side), look)
        if presence < PRESENT:
            continue
        points, presence = _in_crop(rgb, second_crop(points, side), look)
        if presence >= PRESENT:
            found[side] = np.column_stack([points, np.full(len(points), presence)])
    return found


def arms_of(capture: Capture) -> np.ndarray:
    """Return (2, F, 2, 3) metres: elbows and wrists, left first, triangulated, and bridged where views do not agree."""
    cameras, keypoints = capture.require_multiview()
    names = keypoints.joint_set.keypoints
    columns = [names.index(f"{side}_{part}") for part in ("elbow", "wrist") for side in SIDES]
    points = triangulate(cameras, keypoints.xy[:, :, columns], keypoints.confidence[:, :, columns]).points
    frames = np.arange(len(points))
    for joint in range(len(columns)):
        known = np.isfinite(points[:, joint]).all(-1)
        if known.any():
            for axis in range(3):
                points[:, joint, axis] = np.interp(frames, frames[known], points[known, joint, axis])
    return np.moveaxis(points.reshape(len(points), 2, 2, 3), 1, 0)


def _in_crop(rgb: np.ndarray, crop: HandCrop, look: Look) -> tuple[np.ndarray, float]:
    points, presence = look(crop.cut(rgb))
    return crop.in_picture(points), presence


def _frames(path: Path, first: int, count: int) -> Iterator[tuple[int, Picture]]:
    """Yield the take's frames and their pictures."""
    for picture in read_pictures(probe(path)):
        frame = picture.number - first
        if frame >= count:
            return
        if frame >= 0:
            yield frame, picture
