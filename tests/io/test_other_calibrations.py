"""Calibrations as NeRF tools, NumPy scripts, DLT tools and others write them: the same cameras come back."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMissing, FileDamaged
from solver_backend.io.calibration.camera_values import projection_of, split_projection
from solver_backend.io.calibration.read import calibrations_in, read_calibration
from solver_backend.io.calibration.search import find_calibration
from tests.support.other_calibrations import CAMERAS, NAMES, UNNAMED, WRITERS, P, nerf, projection_texts


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_the_same_cameras_come_back(write: Callable[[Path], None], tmp_path: Path) -> None:
    write(tmp_path)
    (found,), errors = calibrations_in(tmp_path, unit="m")
    assert not errors
    cameras = found.cameras
    assert cameras.names == (NAMES if write not in UNNAMED else tuple(f"cam_{c + 1}" for c in range(4)))
    for name in ("K", "R", "t"):
        np.testing.assert_allclose(getattr(cameras, name), getattr(CAMERAS, name), atol=1e-6 if name != "K" else 1e-3)


def test_a_chain_of_kalibr_has_the_first_camera_as_its_world(tmp_path: Path) -> None:
    whole = np.tile(np.eye(4), (len(NAMES), 1, 1))
    whole[:, :3, :3], whole[:, :3, 3] = CAMERAS.R, CAMERAS.t
    lines = []
    for c, K in enumerate(CAMERAS.K):
        intrinsics = [float(K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))]
        lines += [f"cam{c}:", "  camera_model: pinhole", f"  intrinsics: {intrinsics}", "  resolution: [1920, 1080]"]
        if c:
            step = whole[c] @ np.linalg.inv(whole[c - 1])
            lines += ["  T_cn_cnm1:", *(f"  - {row}" for row in step.tolist())]
    (tmp_path / "camchain.yaml").write_text("\n".join(lines), encoding="utf-8")
    cameras = read_calibration(tmp_path / "camchain.yaml", unit="m").cameras
    np.testing.assert_allclose(cameras.K, CAMERAS.K)
    np.testing.assert_allclose(cameras.R @ CAMERAS.R[0], CAMERAS.R, atol=1e-9)
    apart = [np.linalg.norm(c.centres - c.centres[0], axis=1) for c in (cameras, CAMERAS)]
    np.testing.assert_allclose(*apart, atol=1e-9)


def test_a_projection_is_split_into_its_camera() -> None:
    K, R, t = split_projection(-0.01 * P[1], "a camera")
    np.testing.assert_allclose(K, CAMERAS.K[1], atol=1e-8)
    np.testing.assert_allclose(R, CAMERAS.R[1], atol=1e-12)
    np.testing.assert_allclose(t, CAMERAS.t[1], atol=1e-10)
    np.testing.assert_allclose(projection_of((P[0] / P[0, 2, 3]).ravel()[:11]), P[0] / P[0, 2, 3])
    with pytest.raises(CalibrationInvalid, match="not a valid 3 x 4 projection matrix"):
        split_projection(np.ones((3, 4)), "a camera")


def test_our_own_arrays_and_others_are_no_calibrations(tmp_path: Path) -> None:
    np.savez(tmp_path / "capture.npz", format="manifold_mocap_capture", K=CAMERAS.K, R=CAMERAS.R, t=CAMERAS.t)
    np.savez(tmp_path / "poses.npz", poses=np.zeros((9, 156)), trans=np.zeros((9, 3)))
    np.savez(tmp_path / "objects.npz", K=np.array([{}], dtype=object))
    np.savetxt(tmp_path / "forces.txt", np.ones((40, 4)))
    assert calibrations_in(tmp_path) == ([], [])


@pytest.mark.parametrize(("name", "words"), [("stereo.mat", "MATLAB"), ("cameras.pkl", "pickle")])
def test_a_calibration_that_is_not_read_is_named(name: str, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(pickle.dumps({}))
    with pytest.raises(CalibrationMissing, match=words):
        find_calibration(tmp_path, ("cam01",))


def test_a_file_beside_the_recording_that_is_of_another_program_is_no_damaged_calibration(tmp_path: Path) -> None:
    (recording := tmp_path / "session").mkdir()
    (tmp_path / "mkdocs.yml").write_text("site_name: A site, with commas\n: [", encoding="utf-8")
    with pytest.raises(CalibrationMissing):
        find_calibration(recording, ("cam01",))
    (tmp_path / "calibration_old.yml").write_text("%YAML:1.0\ncamera: [", encoding="utf-8")
    with pytest.raises(FileDamaged, match="truncated"):
        find_calibration(recording, ("cam01",))


def test_a_folder_of_projections_is_one_calibration(tmp_path: Path) -> None:
    projection_texts(tmp_path)
    np.testing.assert_allclose(read_calibration(tmp_path, unit="m").cameras.t, CAMERAS.t, atol=1e-6)


def _transforms(folder: Path, **changed: object) -> Path:
    nerf(folder)
    path = folder / "transforms.json"
    content = json.loads(path.read_text())
    for frame in content["frames"]:
        frame |= changed
        for key in [key for key, value in changed.items() if value is None]:
            del frame[key]
    path.write_text(json.dumps(content))
    return path


def test_fisheye_and_fields_of_view_of_nerf_tools(tmp_path: Path) -> None:
    lens = {"camera_model": "OPENCV_FISHEYE", "k1": 0.1, "k2": 0.02, "k3": 0.003, "k4": 0.004}
    cameras = read_calibration(_transforms(tmp_path, **lens), unit="m").cameras
    assert set(cameras.models) == {"fisheye"}
    np.testing.assert_allclose(cameras.distortion[0, :4], [0.1, 0.02, 0.003, 0.004])
    wide = 2 * np.arctan(0.5 * CAMERAS.image_size[0, 0] / CAMERAS.K[0, 0, 0])
    given = {"fl_x": None, "fl_y": None, "camera_angle_x": wide}
    np.testing.assert_allclose(
        read_calibration(_transforms(tmp_path, **given), unit="m").cameras.K[0, 0, 0], CAMERAS.K[0, 0, 0]
    )
    with pytest.raises(CalibrationInvalid, match="no focal length.*camera_angle_x"):
        read_calibration(_transforms(tmp_path, fl_x=None, fl_y=None), unit="m")


@pytest.mark.parametrize("fisheye", [False, True])
def test_cameras_of_named_terms_and_poses_in_the_world(fisheye: bool, tmp_path: Path) -> None:
    terms = {"k1": -0.1, "k2": 0.02, "k3": 0.003, "k4": 0.0004}
    written = []
    for c, name in enumerate(NAMES):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = CAMERAS.R[c].T, CAMERAS.centres[c]
        width, height = CAMERAS.image_size[c].tolist()
        written.append({"id": name, "cameraMatrix": CAMERAS.K[c].tolist(), "distCoeffs": terms, "pose": pose.tolist(),
                        "width": width, "height": height, "fisheye": fisheye})  # fmt: skip
    (tmp_path / "cameras.json").write_text(json.dumps({"cameras": written}))
    found = read_calibration(tmp_path / "cameras.json", unit="m").cameras
    assert found.names == NAMES
    np.testing.assert_allclose(found.R, CAMERAS.R, atol=1e-9)
    np.testing.assert_allclose(found.t, CAMERAS.t, atol=1e-9)
    listed = [-0.1, 0.02, 0.003, 0.0004] if fisheye else [-0.1, 0.02, 0.0, 0.0, 0.003, 0.0004]
    np.testing.assert_allclose(found.distortion[:, : len(listed)], [listed] * len(NAMES))
