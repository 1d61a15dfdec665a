"""A camera with a path is at each frame the camera that stands there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cameras.projection import CameraArrays, project, project_with_jacobian
from solver_backend.cameras.steady_camera import steady_camera
from solver_backend.exchange.errors import CalibrationInvalid, CaptureInvalid
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types import CameraPath, Cameras, Capture, JointSet, Keypoints2D

FRAMES = 5


def carried() -> tuple[Cameras, np.ndarray, np.ndarray]:
    """Return a camera with a lens that walks along +X and looks along +Y, and its poses."""
    rng = np.random.default_rng(0)
    K = np.array([[[900.0, 0, 640], [0, 910, 360], [0, 0, 1]]])
    lens = np.array([[-0.05, 0.02, 1e-3, -1e-3, 0, 0, 0, 0]])
    still = Cameras(("phone",), K, lens, np.eye(3)[None], np.zeros((1, 3)), np.array([[1280, 720]]))
    level = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    R = exp_so3(0.05 * rng.normal(size=(FRAMES, 3))) @ level
    centre = np.stack([0.3 * np.arange(FRAMES), -4.0 + 0.1 * rng.normal(size=FRAMES), np.full(FRAMES, 1.4)], axis=1)
    t = -np.einsum("fab,fb->fa", R, centre)
    return still.carried(R, t), R, t


def people() -> np.ndarray:
    return np.random.default_rng(1).uniform([-1, -1, 0], [2, 1, 2], size=(FRAMES, 25, 3))


def capture() -> Capture:
    cameras, _, _ = carried()
    xy = np.asarray(project(cameras, people()))
    return Capture("walk", cameras, Keypoints2D(xy, np.ones(xy.shape[:3]), JointSet.BODY_25, 30.0))


def test_each_frame_is_seen_by_the_camera_that_stands_there() -> None:
    cameras, R, t = carried()
    points = people()
    px, J, depth = project_with_jacobian(cameras, points)
    for frame in range(FRAMES):
        there = replace(cameras, R=R[frame, None], t=t[frame, None], path=None)
        for seen, expected in zip((px, J, depth), project_with_jacobian(there, points[frame]), strict=True):
            np.testing.assert_allclose(seen[:, frame], expected, atol=1e-9)
    step = 1e-6 * np.eye(3)
    by_point = [(project(cameras, points + d) - project(cameras, points - d)) / 2e-6 for d in step]
    np.testing.assert_allclose(J, np.stack(by_point, axis=-1), atol=1e-3)


def test_selected_frames_keep_their_poses() -> None:
    cameras, R, t = carried()
    for part in (cameras.at(slice(2, 4)), capture().frames(2, 4).cameras):
        assert part is not None
        for found, expected in zip(part.poses(0, 2), (R[2:4], t[2:4]), strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-12)
        np.testing.assert_allclose(part.centres[0], -R[2].T @ t[2], atol=1e-12)
    points, shown = people(), capture().keypoints
    assert shown is not None
    moved = shown.xy + 1.0
    term = ReprojectionTerm.of(cameras, replace(shown, xy=moved), np.ones((1, 1, 1)), points)
    whole, some = term.residuals(points), term.select([1, 3]).residuals(points[[1, 3]])
    np.testing.assert_allclose(some.error, whole.error[:, [1, 3]], atol=1e-9)
    assert CameraArrays.of(cameras, points).astype(np.float32).path.R.dtype == np.float32  # type: ignore[union-attr]


def test_a_path_is_stored_with_its_capture(tmp_path: Path) -> None:
    before, file = capture(), tmp_path / "walk.npz"
    write_capture(file, before)
    after = read_capture(file)
    assert before.cameras is not None and after.cameras is not None
    for found, expected in zip(after.cameras.poses(0, FRAMES), before.cameras.poses(0, FRAMES), strict=True):
        np.testing.assert_allclose(found, expected)


def test_an_impossible_path_is_refused() -> None:
    whole = capture()
    cameras, R, t = carried()
    with pytest.raises(CaptureInvalid, match="5 poses for 3 frames"):
        replace(whole, keypoints=whole.keypoints and whole.keypoints.frames(0, 3))
    bent = R.copy()
    bent[3] *= 1.1
    for path in (CameraPath(bent, t), CameraPath(R, np.where(np.arange(FRAMES)[:, None] == 3, np.nan, t))):
        with pytest.raises(CalibrationInvalid, match="an impossible pose") as error:
            replace(cameras, path=path)
        assert error.value.where == "frame 3"
    with pytest.raises(CalibrationInvalid, match="shapes"):
        replace(cameras, path=CameraPath(R[:2], t))


def test_a_steady_camera_stands_level_and_sees_the_same_points_from_the_same_places() -> None:
    whole = capture()
    cameras, _, _ = carried()
    assert whole.keypoints is not None
    steady, seen = steady_camera(cameras, whole.keypoints)
    R, _ = steady.poses(0, FRAMES)
    np.testing.assert_allclose(R[:, 1], np.tile([0.0, 0.0, -1.0], (FRAMES, 1)), atol=1e-12)
    np.testing.assert_allclose(seen.xy, project(steady, people()), atol=1e-6)
    still = replace(cameras, path=None)
    assert steady_camera(still, whole.keypoints) == (still, whole.keypoints)
