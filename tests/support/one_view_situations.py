"""A filmed walk, and what may be wrong with a single video of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.types import Cameras, Capture, Keypoints2D
from tests.support.walking_take import circling, walk

FRAMES = 120
PACE = 420
"""Frames around the circle of 7.5 m: 1.1 m/s, as long as the steps are."""
JUMP_S = 0.7  # From one landing to the next.
LEGS = ("hip", "knee", "ankle", "heel", "big_toe", "small_toe")


def filmed_walk(frames: int = FRAMES) -> Capture:
    """Return a person who walks around a part of a circle, at the pace of the steps, before one calibrated camera."""
    whole = circling(PACE)
    take = replace(whole, rotations=whole.rotations[:frames], root=whole.root[:frames])
    return benchmark_capture(take, BenchmarkSettings(num_views=2, calibration_mm=0.0)).views([0])


def standing(frames: int = FRAMES, jump_m: float = 0.0) -> Capture:
    """Return a person who stands and moves the arms, or jumps on a trampoline so high, the camera as above."""
    take = walk(frames)
    rotations = take.rotations.copy()
    rotations[:, 1:3] = np.eye(3)
    root = np.tile(take.root.mean(axis=0), (frames, 1))
    root[:, 1] += jump_m * np.abs(np.sin(np.pi * np.arange(frames) / (JUMP_S * take.fps)))
    still = replace(take, rotations=rotations, root=root)
    return benchmark_capture(still, BenchmarkSettings(num_views=2, calibration_mm=0.0)).views([0])


def parts(capture: Capture) -> tuple[Cameras, Keypoints2D]:
    """Return cameras and detections."""
    assert capture.cameras is not None and capture.keypoints is not None
    return capture.cameras, capture.keypoints


def without(capture: Capture, words: tuple[str, ...], frames: slice = slice(None)) -> Capture:
    """Return a capture that does not show these parts of the body in some frames."""
    _, keypoints = parts(capture)
    confidence = keypoints.confidence.copy()
    columns = [k for k, name in enumerate(keypoints.joint_set.keypoints) if name.partition("_")[2] in words]
    confidence[:, frames, columns] = 0.0
    return replace(capture, keypoints=replace(keypoints, confidence=confidence))


def cut(capture: Capture, frame: int) -> Capture:
    """Return a capture whose video jumps from a frame to a later moment, elsewhere in the picture."""
    _, keypoints = parts(capture)
    xy = keypoints.xy.copy()
    xy[:, frame + 1 :] = 0.9 * xy[:, frame + 1 :] + np.array([420.0, 30.0])
    return replace(capture, keypoints=replace(keypoints, xy=xy))


def zoomed(capture: Capture, times: float) -> Capture:
    """Return a capture whose focal length grows to so many times what the calibration has."""
    cameras, keypoints = parts(capture)
    centre = cameras.K[:, None, None, :2, 2]
    factor = np.geomspace(1.0, times, keypoints.num_frames)[None, :, None, None]
    return replace(capture, keypoints=replace(keypoints, xy=centre + factor * (keypoints.xy - centre)))


def doubled(capture: Capture, every: int) -> Capture:
    """Return a capture of a video that shows every such frame twice, as a conversion from 24 to 30 a second does."""
    _, keypoints = parts(capture)
    number = np.arange(keypoints.num_frames)
    number = number - number // every
    return replace(
        capture,
        keypoints=replace(keypoints, xy=keypoints.xy[:, number], confidence=keypoints.confidence[:, number]),
        truth={},
    )


def mirrored(capture: Capture) -> Capture:
    """Return a capture whose video was flipped left to right, as selfie cameras do, before the detector saw it."""
    cameras, keypoints = parts(capture)
    order = list(keypoints.joint_set.mirrored())
    xy, confidence = keypoints.xy[:, :, order].copy(), keypoints.confidence[:, :, order]
    xy[..., 0] = 2.0 * cameras.K[:, None, None, 0, 2] - xy[..., 0]
    return replace(capture, keypoints=replace(keypoints, xy=xy, confidence=confidence), truth={})
