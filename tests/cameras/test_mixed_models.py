"""A fisheye beside pinhole cameras: reads, projects, triangulates, solves, and is written and read again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.camera_calibration.adjustment.lens import project_local
from solver_backend.camera_calibration.formats import colmap_texts, opencv_yaml, pose2sim_toml
from solver_backend.cameras.camera_corrections import CameraCorrection, corrected
from solver_backend.cameras.projection import CameraArrays, project, project_with_jacobian, undistort
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange import capture_file
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.lens import LENS_MODELS
from solver_backend.exchange.lens_model import LensModel
from solver_backend.fitters import solve
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Cameras, Capture, Keypoints2D

BENT = {"fisheye": [-0.02, 0.01, -0.006, 0.001, 0, 0, 0, 0], "opencv": [-0.1, 0.02, 1e-3, -5e-4, 0, 0, 0, 0]}
POINTS = np.random.default_rng(0).uniform(-0.6, 0.6, (5, 7, 3)) + [0, 0, 1]


@pytest.fixture(scope="module")
def mixed() -> Cameras:
    """Return the demo's four cameras, the second of them with a fisheye lens."""
    cameras, _ = demo_capture().require_multiview()
    models = ("opencv", "fisheye", "opencv", "opencv")
    return replace(cameras, models=models, distortion=np.array([BENT[name] for name in models]))


@pytest.fixture(scope="module")
def filmed(mixed: Cameras) -> Capture:
    """Return 40 frames of the demo's person as the mixed array sees them."""
    capture = demo_capture(num_frames=40)
    _, keypoints = capture.require_multiview()
    px = project(mixed, capture.truth["keypoints3d"])
    assert np.isfinite(px).all()
    xy = px + np.random.default_rng(1).normal(0, 0.5, px.shape)
    seen = Keypoints2D(xy, np.full(xy.shape[:-1], 0.9), keypoints.joint_set, keypoints.fps)
    return Capture("mixed", mixed, seen, truth=capture.truth)


def test_each_camera_is_computed_by_its_own_model(mixed: Cameras) -> None:
    px, J, depth = project_with_jacobian(mixed, POINTS)
    n = undistort(mixed, px)
    for c in range(len(mixed)):
        one = mixed.subset([c])
        alone = project_with_jacobian(one, POINTS)
        for found, expected in zip((px, J, depth), alone, strict=True):
            np.testing.assert_array_equal(found[c], expected[0])
        np.testing.assert_array_equal(project(mixed, POINTS)[c], px[c])
        np.testing.assert_allclose(n[c], undistort(one, px[[c]])[0], atol=1e-15)
    local = POINTS @ np.swapaxes(mixed.R, -1, -2)[:, None] + mixed.t[:, None, None]
    np.testing.assert_allclose(n, local[..., :2] / local[..., 2:], atol=1e-11)


def test_torch_equals_numpy(mixed: Cameras) -> None:
    torch = pytest.importorskip("torch")
    points = torch.as_tensor(POINTS)
    found = project_with_jacobian(CameraArrays.of(mixed, points), points)
    for tensor, expected in zip(found, project_with_jacobian(mixed, POINTS), strict=True):
        np.testing.assert_allclose(tensor.numpy(), expected, rtol=1e-11, atol=1e-9)


def test_derivatives_by_the_lens_are_those_of_each_model(mixed: Cameras) -> None:
    which = np.array([0, 1, 1, 2, 3, 1])
    x_cam = np.random.default_rng(3).uniform(-0.4, 0.4, (6, 3)) + [0, 0, 1.5]
    found = project_local(mixed, which, x_cam)
    for c in range(len(mixed)):
        at = which == c
        for part, alone in zip(found, project_local(mixed.subset([c]), which[at] * 0, x_cam[at]), strict=True):
            np.testing.assert_array_equal(part[at], alone)


def test_pictures_turned_by_90_degrees_show_the_same_points(mixed: Cameras) -> None:
    turned = corrected(mixed, [CameraCorrection(turn=1)] * len(mixed))
    px = project(mixed, POINTS)
    height = mixed.image_size[:, 1].reshape(-1, 1, 1)
    expected = np.stack([height - 1 - px[..., 1], px[..., 0]], axis=-1)
    np.testing.assert_allclose(project(turned, POINTS), expected, atol=1e-9)


def test_a_mixed_array_triangulates_and_solves(filmed: Capture) -> None:
    cameras, keypoints = filmed.require_multiview()
    located = triangulate(cameras, keypoints.xy, keypoints.confidence)
    off = np.linalg.norm(np.asarray(located.points) - filmed.truth["keypoints3d"], axis=-1)
    assert np.median(off) < 0.003
    motion = solve(filmed).motion
    assert np.nanmedian(motion.reprojection_px[1]) < 4.0  # the fisheye's view fits as the others do


@pytest.mark.parametrize("name", ["cameras.toml", "cameras.yml", "colmap"])
def test_a_calibration_of_a_mixed_array_is_written_and_read_again(mixed: Cameras, tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "colmap":
        path.mkdir()
        for file, text in colmap_texts(mixed).items():
            (path / file).write_text(text, "utf-8")
    else:
        path.write_text(pose2sim_toml(mixed) if name.endswith("toml") else opencv_yaml(mixed), "utf-8")
    again = read_calibration(path, unit="m").cameras
    assert again.models == mixed.models
    np.testing.assert_allclose(project(again, POINTS), project(mixed, POINTS), atol=1e-6)


def test_a_capture_file_keeps_each_model(filmed: Capture, tmp_path: Path) -> None:
    path = write_capture(tmp_path / "c.npz", filmed)
    assert filmed.cameras is not None
    again = read_capture(path).cameras
    assert again is not None and again.models == filmed.cameras.models
    np.testing.assert_array_equal(again.distortion, filmed.cameras.distortion)
    shown = capture_file.read_capture(path)
    assert tuple(camera.distortion_model for camera in shown.cameras) == filmed.cameras.models
    alike = replace(filmed, cameras=replace(filmed.cameras, models=("opencv",)))
    with np.load(write_capture(tmp_path / "alike.npz", alike)) as arrays:
        assert arrays["distortion_model"].shape == () and str(arrays["distortion_model"]) == "opencv"


def test_a_new_model_is_one_row(mixed: Cameras, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The division model ``x / (1 + k u)`` with ``u = x² + y²``, which nothing but its row knows."""

    def distort(x, y, k, xp):
        bottom = 1.0 + k[0] * (x * x + y * y)
        slope = -2.0 * k[0] / bottom**2
        return x / bottom, y / bottom, (1 / bottom + x * x * slope, x * y * slope, 1 / bottom + y * y * slope)

    def growth(u, k, xp):
        return (1.0 - k[0] * u) / (1.0 + k[0] * u) ** 2, u < 0

    def by_terms(x, y, k):
        raise NotImplementedError

    model = LensModel("division", ("k1",), True, distort, growth, by_terms, lengths=(1,))
    monkeypatch.setitem(LENS_MODELS, "division", model)
    cameras = replace(mixed, models=("division", *mixed.models[1:]), distortion=mixed.distortion.copy())
    cameras.distortion[0] = [-0.08, 0, 0, 0, 0, 0, 0, 0]
    px, J, _ = project_with_jacobian(cameras, POINTS)
    h = 1e-6
    for i, e in enumerate(np.eye(3)):
        numeric = (project(cameras, POINTS + h * e) - project(cameras, POINTS - h * e)) / (2 * h)
        np.testing.assert_allclose(J[..., i], numeric, rtol=1e-4, atol=1e-3)
    local = POINTS @ np.swapaxes(cameras.R, -1, -2)[:, None] + cameras.t[:, None, None]
    np.testing.assert_allclose(undistort(cameras, px), local[..., :2] / local[..., 2:], atol=1e-10)
    with pytest.raises(CalibrationInvalid, match="COLMAP has no lens model 'division'.*Write another format"):
        colmap_texts(cameras)
    for name, text in (("c.toml", pose2sim_toml(cameras)), ("c.yml", opencv_yaml(cameras))):
        (tmp_path / name).write_text(text, "utf-8")
        again = read_calibration(tmp_path / name, unit="m").cameras
        assert again.models == cameras.models
        np.testing.assert_allclose(project(again, POINTS), px, atol=1e-6)
    kept = read_capture(write_capture(tmp_path / "c.npz", Capture("c", cameras))).cameras
    assert kept is not None and kept.models == cameras.models
