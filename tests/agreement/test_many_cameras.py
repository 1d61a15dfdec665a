"""One camera's fault is found among sixteen cameras, although most pairs of views do not show it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from solver_backend.agreement.explain import explain
from solver_backend.agreement.reading import PictureReading
from solver_backend.cameras.projection import project
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Cameras, Detections
from tests.support.scenes import ring_of_cameras

ONE = 5
SLOW = pytest.mark.slow


def ring() -> tuple[Cameras, Detections]:
    demo = demo_capture()
    points, cameras = demo.truth["keypoints3d"][40:160:2], ring_of_cameras(16)
    xy = project(cameras, points) + np.random.default_rng(0).normal(0, 6.0, (16, *points.shape[:2], 2))
    joint_set = demo.require_multiview()[1].joint_set
    return cameras, Detections(cameras.names, xy[:, :, None], np.ones((*xy.shape[:2], 1, xy.shape[2])), joint_set)


def half(cameras: Cameras, xy: np.ndarray) -> np.ndarray:
    return (xy + 0.5) / 2 - 0.5


def upside_down(cameras: Cameras, xy: np.ndarray) -> np.ndarray:
    return cameras.image_size[ONE] - 1 - xy


def late(cameras: Cameras, xy: np.ndarray) -> np.ndarray:
    return np.concatenate([xy[:1]] * 8 + [xy[:-8]])


@pytest.mark.parametrize(
    ("spoil", "code", "picture"),
    [
        (half, "calibration_corrected", PictureReading(0.5)),
        pytest.param(upside_down, "calibration_corrected", PictureReading(turn=2), marks=SLOW),
        (late, "camera_late", PictureReading()),
    ],
)
def test_detections_of_one_camera(
    spoil: Callable[[Cameras, np.ndarray], np.ndarray], code: str, picture: PictureReading
) -> None:
    cameras, seen = ring()
    xy = seen.xy.copy()
    xy[ONE] = spoil(cameras, xy[ONE])
    found = explain(cameras, replace(seen, xy=xy))
    assert [(a.code, a.views) for a in found.applied] == [(code, (ONE,))]
    assert found.reading.pictures[ONE] == picture


def test_a_moved_camera() -> None:
    cameras, seen = ring()
    moved = cameras.t.copy()
    moved[ONE] += [0.36, -0.48, 0.0]
    found = explain(replace(cameras, t=moved), seen)
    assert [(a.code, a.views) for a in found.applied] == [("camera_placed", (ONE,))]
    placed = found.reading.moved[ONE]
    assert placed is not None
    np.testing.assert_allclose(placed[9:], cameras.t[ONE], atol=0.05)


def test_no_fault() -> None:
    assert not explain(*ring()).changed


def test_camera_to_world_files_that_put_a_ring_in_one_place() -> None:
    """As written, no pair of views has epipolar lines. Squeezed images once explained the noise of a level ring."""
    cameras, seen = ring()
    noise = np.random.default_rng(1).normal(0, 12.0, seen.xy.shape)
    R = cameras.R.swapaxes(1, 2)
    inverse = replace(cameras, R=R, t=-np.einsum("cij,cj->ci", R, cameras.t))
    found = explain(inverse, replace(seen, xy=seen.xy + noise))
    assert [a.meaning for a in found.applied] == ["rotations and translations are from camera to world"]
