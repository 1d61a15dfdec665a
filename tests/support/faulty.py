"""Captures with one thing wrong, made from a good one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.synthesis.embedded.demo import detect
from solver_backend.synthesis.faults import DEMO_DETECTOR
from solver_backend.types import Cameras, Capture, Keypoints2D

LIMB_PARTS = {"arms": ("shoulder", "elbow", "wrist"), "legs": ("hip", "knee", "ankle", "_toe", "heel")}


def filmed_by(capture: Capture, cameras: Cameras, seed: int) -> Capture:
    """Return the capture's true motion as other cameras and another detector see it."""
    assert capture.keypoints is not None
    truth = capture.truth["keypoints3d"]
    px = project(cameras, truth)
    xy, confidence = detect(px, cameras.image_size, capture.fps, DEMO_DETECTOR, np.random.default_rng(seed))
    keypoints = Keypoints2D(xy, confidence, capture.keypoints.joint_set, capture.fps)
    return replace(capture, cameras=cameras, keypoints=keypoints, footage=())


def with_detections(capture: Capture, xy: np.ndarray, confidence: np.ndarray) -> Capture:
    """Return the capture with other detections."""
    assert capture.keypoints is not None
    return replace(capture, keypoints=replace(capture.keypoints, xy=xy, confidence=confidence))


def swapped(capture: Capture, swaps: list[tuple[int, str, int, int]]) -> Capture:
    """Return the capture with left and right limbs exchanged: view, limbs, first and last frame."""
    assert capture.keypoints is not None
    joint_set = capture.keypoints.joint_set
    xy, confidence = capture.keypoints.xy.copy(), capture.keypoints.confidence.copy()
    for view, limb, first, last in swaps:
        columns = [k for k, name in enumerate(joint_set.keypoints) if "_" in name and name.endswith(LIMB_PARTS[limb])]
        mirrored = [joint_set.mirrored()[k] for k in columns]
        frames = slice(first, last + 1)
        xy[view, frames, columns] = capture.keypoints.xy[view, frames, mirrored]
        confidence[view, frames, columns] = capture.keypoints.confidence[view, frames, mirrored]
    return with_detections(capture, xy, confidence)
