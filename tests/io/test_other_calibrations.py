"""Calibrations as NeRF tools, NumPy scripts, DLT tools and others write them: the same cameras come back."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMissing
from solver_backend.io.calibration.projection_matrix import projection_of, split_projection
from solver_backend.io.calibration.read import calibrations_in, read_calibration
from solver_backend.io.calibration.search import find_calibration
from tests.support.camera_ring import ring

CAMERAS = ring(4)
NAMES = CAMERAS.names
P = CAMERAS.K @ np.concatenate([CAMERAS.R, CAMERAS.t[..., None]], axis=2)


def _write(path: Path, content: object) -> None:
    path.write_text(json.dumps(content))


def nerf(folder: Path) -> None:
    frames = []
    for c, name in enumerate(NAMES):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = CAMERAS.R[c].T, CAMERAS.centres[c]
        pose = pose @ np.diag([1, -1, -1, 1])
        K, (w, h) = CAMERAS.K[c], CAMERAS.image_size[c].tolist()
        frames.append({"file_path": f"images/{name}.png", "fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2],
                       "cy": K[1, 2], "w": w, "h": h, "transform_matrix": pose.tolist()})  # fmt: skip
    _write(folder / "transforms.json", {"camera_model": "OPENCV", "frames": frames})


def numbers_by_name(folder: Path) -> None:
    keys = ("fx", "fy", "cx", "cy", "rotation", "tvec")
    values = [
        (K[0, 0], K[1, 1], K[0, 2], K[1, 2], R.tolist(), t.tolist())
        for K, R, t in zip(CAMERAS.K, CAMERAS.R, CAMERAS.t, strict=True)
    ]
    nodes = {name: dict(zip(keys, camera, strict=True)) for name, camera in zip(NAMES, values, strict=True)}
    _write(folder / "cameras.json", nodes)


def projections(folder: Path) -> None:
    _write(folder / "cameras.json", {name: {"P": (-3.0 * p).tolist()} for name, p in zip(NAMES, P, strict=True)})


def projection_texts(folder: Path) -> None:
    for name, p in zip(NAMES, P, strict=True):
        np.savetxt(folder / f"{name}.txt", p)


def dlt(folder: Path) -> None:
    np.savetxt(folder / "dltcoefs.csv", (P / P[:, 2:, 3:]).reshape(4, 12)[:, :11].T, delimiter=",")


def arrays(folder: Path) -> None:
    np.savez(folder / "calibration.npz", K=CAMERAS.K, R=CAMERAS.R, t=CAMERAS.t, names=np.array(NAMES))


def arrays_a_camera(folder: Path) -> None:
    for c, name in enumerate(NAMES):
        np.savez(folder / f"{name}.npz", mtx=CAMERAS.K[c], dist=np.zeros(5), R=CAMERAS.R[c], T=CAMERAS.t[c])


@pytest.mark.parametrize(
    "write", [nerf, numbers_by_name, projections, projection_texts, dlt, arrays, arrays_a_camera],
    ids=lambda write: write.__name__,
)  # fmt: skip
def test_the_same_cameras_come_back(write: Callable[[Path], None], tmp_path: Path) -> None:
    write(tmp_path)
    (found,), errors = calibrations_in(tmp_path, unit="m")
    assert not errors
    cameras = found.cameras
    assert cameras.names == (NAMES if write is not dlt else tuple(f"cam_{c + 1}" for c in range(4)))
    for name in ("K", "R", "t"):
        np.testing.assert_allclose(getattr(cameras, name), getattr(CAMERAS, name), atol=1e-6 if name != "K" else 1e-3)


def test_a_projection_is_split_into_its_camera() -> None:
    K, R, t = split_projection(-0.01 * P[1], "a camera")
    np.testing.assert_allclose(K, CAMERAS.K[1], atol=1e-8)
    np.testing.assert_allclose(R, CAMERAS.R[1], atol=1e-12)
    np.testing.assert_allclose(t, CAMERAS.t[1], atol=1e-10)
    np.testing.assert_allclose(projection_of((P[0] / P[0, 2, 3]).ravel()[:11]), P[0] / P[0, 2, 3])
    with pytest.raises(CalibrationInvalid, match="none of a camera"):
        split_projection(np.ones((3, 4)), "a camera")


def test_our_own_arrays_and_others_are_no_calibrations(tmp_path: Path) -> None:
    np.savez(tmp_path / "capture.npz", format="manifold_mocap_capture", K=CAMERAS.K, R=CAMERAS.R, t=CAMERAS.t)
    np.savez(tmp_path / "poses.npz", poses=np.zeros((9, 156)), trans=np.zeros((9, 3)))
    np.savez(tmp_path / "objects.npz", K=np.array([{}], dtype=object))
    np.savetxt(tmp_path / "forces.txt", np.ones((40, 4)))
    assert calibrations_in(tmp_path) == ([], [])


@pytest.mark.parametrize(
    ("name", "words"), [("take.xcp", "Vicon"), ("stereo.mat", "MATLAB"), ("cameras.pkl", "pickle")]
)
def test_a_calibration_that_is_not_read_is_named(name: str, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(pickle.dumps({}))
    with pytest.raises(CalibrationMissing, match=words):
        find_calibration(tmp_path, ("cam01",))


def test_a_folder_of_projections_is_one_calibration(tmp_path: Path) -> None:
    projection_texts(tmp_path)
    np.testing.assert_allclose(read_calibration(tmp_path, unit="m").cameras.t, CAMERAS.t, atol=1e-6)
