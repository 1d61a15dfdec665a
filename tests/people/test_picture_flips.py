"""Detections that are flipped, or whose sides are exchanged, in all views: found, undone, and nothing else touched."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from solver_backend.agreement.calibration_fit import CalibrationFit, fit_calibration, views_agreement
from solver_backend.agreement.detections import Detections
from solver_backend.agreement.handedness import handedness
from solver_backend.agreement.picture_flips import FlipFound, PictureFlip, find_flip, flipped
from solver_backend.cameras.camera_corrections import CameraCorrection
from solver_backend.cameras.projection import project
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Cameras, JointSet
from tests.support.scenes import ring_of_cameras

DEMO = demo_capture()
CAMERAS, KEYPOINTS = DEMO.require_multiview()
FRAMES = slice(40, 160)
SIZES = CAMERAS.image_size
FLIPS = [PictureFlip(1), PictureFlip(0, True), PictureFlip(1, True), PictureFlip(sides=True), PictureFlip(2)]


def detections() -> Detections:
    return Detections(
        CAMERAS.names, KEYPOINTS.xy[:, FRAMES][:, :, None], KEYPOINTS.confidence[:, FRAMES][:, :, None],
        KEYPOINTS.joint_set,
    )  # fmt: skip


def found(cameras: Cameras, seen: Detections) -> FlipFound:
    """Return what is found where no other reading of the calibration is tried."""
    agreement = views_agreement(cameras, seen)
    as_written = CalibrationFit(cameras, (CameraCorrection(),) * len(cameras), agreement, agreement)
    return find_flip(as_written, seen, cameras)


@pytest.mark.parametrize(
    ("flip", "factor"), [*((flip, 1.0) for flip in FLIPS), (FLIPS[0], 0.5)],
    ids=["from below", "mirrored", "from below, exchanged", "exchanged", "x and y", "from below, half"],
)  # fmt: skip
def test_what_is_flipped_in_all_views_is_undone(flip: PictureFlip, factor: float) -> None:
    spoiled = flipped(detections(), flip, SIZES)
    spoiled = replace(spoiled, xy=(spoiled.xy + 0.5) * factor - 0.5)
    seen = found(CAMERAS, spoiled)
    assert seen.flip == flip and not seen.is_mirrored
    sizes = None if flip.axis is None else np.round(SIZES * factor)
    assert (seen.image_size is None) == (sizes is None)
    if sizes is not None:
        np.testing.assert_allclose(seen.image_size, sizes)


def late(seen: Detections) -> Detections:
    xy = seen.xy.copy()
    xy[1] = np.roll(xy[1], 30, axis=0)
    return replace(seen, xy=xy)


def one_mirrored(seen: Detections) -> Detections:
    xy = seen.xy.copy()
    xy[1, ..., 0] = SIZES[1, 0] - 1 - xy[1, ..., 0]
    return replace(seen, xy=xy[:, :, :, list(seen.joint_set.mirrored())])


@pytest.mark.parametrize(
    "spoil",
    [
        lambda seen: seen,
        late,
        one_mirrored,
        lambda seen: replace(seen, xy=seen.xy[[1, 0, 2, 3]]),
        lambda seen: replace(seen, xy=np.random.default_rng(1).uniform(0, 1000, seen.xy.shape)),
        lambda seen: replace(seen, confidence=np.zeros_like(seen.confidence)),
    ],
    ids=["as it should be", "late", "one mirrored", "exchanged", "nonsense", "nobody"],
)
def test_nothing_is_undone_without_evidence(spoil: Callable[[Detections], Detections]) -> None:
    assert found(CAMERAS, spoil(detections())) == FlipFound()


def test_pictures_of_half_the_size_are_not_flipped() -> None:
    seen = replace(detections(), xy=(detections().xy + 0.5) / 2 - 0.5)
    assert find_flip(fit_calibration(CAMERAS, seen), seen, CAMERAS) == FlipFound()


def in_the_round(points: np.ndarray, joint_set: JointSet) -> tuple[Cameras, Detections]:
    """Return level cameras at one height, which agree with a world upside down, and what they see."""
    cameras = ring_of_cameras(height=0.9)
    px = project(cameras, points)
    return cameras, Detections(cameras.names, px[:, :, None], np.ones((*px.shape[:2], 1, px.shape[2])), joint_set)


def test_level_cameras_tell_by_the_person() -> None:
    points = DEMO.truth["keypoints3d"][FRAMES].copy()
    points[..., :2] -= points[..., :2].mean(axis=(0, 1))
    cameras, seen = in_the_round(points, KEYPOINTS.joint_set)
    assert found(cameras, seen) == FlipFound()
    from_below = flipped(seen, PictureFlip(1), cameras.image_size)
    assert views_agreement(cameras, from_below) > 0.85
    assert found(cameras, from_below).flip == PictureFlip(1)
    exchanged = found(cameras, flipped(seen, PictureFlip(sides=True)))
    assert exchanged.flip is None and exchanged.is_mirrored
    handstand = (points - [0, 0, 0.9]) * [1, -1, -1] + [0, 0, 0.9]
    assert found(*in_the_round(handstand, KEYPOINTS.joint_set)) == FlipFound()


def test_hands_are_flipped_with_the_body() -> None:
    hands = np.random.default_rng(0).uniform(0, 1000, (4, 120, 1, 2, 21, 3))
    undone = flipped(replace(detections(), hands=hands), PictureFlip(0, True), SIZES)
    assert undone.hands is not None
    np.testing.assert_allclose(undone.hands[..., 0, :, 0], 1919 - hands[..., 1, :, 0])
    np.testing.assert_allclose(undone.hands[..., 1:], hands[..., ::-1, :, 1:])


@pytest.mark.parametrize("joint_set", [JointSet.BODY_25, JointSet.COCO_17, JointSet.MPII_15, JointSet.H36M_17])
def test_handedness_tells_a_body_from_its_mirror_image(joint_set: JointSet) -> None:
    names = KEYPOINTS.joint_set.keypoints
    points = DEMO.truth["keypoints3d"][FRAMES]
    columns = [names.index(name) if name in names else -1 for name in joint_set.keypoints]
    seen = np.where(np.array(columns)[:, None] >= 0, points[:, columns], np.nan)
    right = handedness(seen, joint_set)
    assert right > (0.2 if joint_set != JointSet.MPII_15 else 0.0)
    assert handedness(seen * [-1, 1, 1], joint_set) == pytest.approx(-right)
    assert handedness(np.full_like(seen, np.nan), joint_set) == 0.0
