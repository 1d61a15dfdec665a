"""Calibrations that no camera can have as written are read as they are meant, and what was done is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.geometry.rotations import log_so3
from solver_backend.io.calibration.read import read_calibration
from tests.support.other_calibrations import CAMERAS, NAMES

SIZE = CAMERAS.image_size[0]


def write(path: Path, change: Callable[[int, np.ndarray, np.ndarray], None]) -> Path:
    cameras = []
    for c, name in enumerate(NAMES):
        K, R = CAMERAS.K[c].copy(), CAMERAS.R[c].copy()
        change(c, K, R)
        pose = {"R": R.tolist(), "t": CAMERAS.t[c].tolist()}
        cameras.append({"id": name, "K": K.tolist(), "dist": [0.0] * 5, **pose, "resolution": SIZE.tolist()})
    path.write_text(json.dumps({"cameras": cameras}), encoding="utf-8")
    return path


def in_shares(c: int, K: np.ndarray, R: np.ndarray) -> None:
    K[:2] /= SIZE[:, None]


def without_middle(c: int, K: np.ndarray, R: np.ndarray) -> None:
    K[:2, 2] = 0.0


def offsets(c: int, K: np.ndarray, R: np.ndarray) -> None:
    K[:2, 2] -= (SIZE - 1) / 2
    K[0, 2] += 1e-3  # zeros alone are missing ones


def mirrored(c: int, K: np.ndarray, R: np.ndarray) -> None:
    R[:, 0] *= -1.0


CASES = {
    in_shares: "calibration_read_as", without_middle: "calibration_read_as",
    offsets: "calibration_read_as", mirrored: "calibration_read_as",
}  # fmt: skip


@pytest.mark.parametrize(("change", "code"), CASES.items())
def test_what_no_camera_can_be_is_read_as_meant(
    change: Callable[[int, np.ndarray, np.ndarray], None], code: str, tmp_path: Path
) -> None:
    found = read_calibration(write(tmp_path / "cameras.json", change), unit="m")
    assert [problem.code for problem in found.problems] == [code]
    np.testing.assert_allclose(found.cameras.R, CAMERAS.R, atol=1e-9)
    np.testing.assert_allclose(found.cameras.K[:, [0, 1], [0, 1]], CAMERAS.K[:, [0, 1], [0, 1]])
    middle = np.broadcast_to((SIZE - 1) / 2, (len(NAMES), 2))
    np.testing.assert_allclose(
        found.cameras.K[:, :2, 2], middle if change is without_middle else CAMERAS.K[:, :2, 2], atol=2e-3
    )


def test_one_mirrored_camera_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "cameras.json", lambda c, K, R: mirrored(c, K, R) if c == 1 else None)
    with pytest.raises(CalibrationInvalid, match="mirrors, unlike the other cameras"):
        read_calibration(path, unit="m")


def test_a_calibration_as_it_should_be_stays(tmp_path: Path) -> None:
    found = read_calibration(write(tmp_path / "cameras.json", lambda c, K, R: None), unit="m")
    assert found.problems == ()


def test_focal_lengths_in_mm_are_refused_with_the_formula(tmp_path: Path) -> None:
    def in_mm(c: int, K: np.ndarray, R: np.ndarray) -> None:
        K[[0, 1], [0, 1]] *= 36.0 / SIZE[0]

    with pytest.raises(CalibrationInvalid, match="may be in mm") as refused:
        read_calibration(write(tmp_path / "cameras.json", in_mm), unit="m")
    assert "sensor width" in refused.value.hint


def test_rotation_vectors_in_degrees_are_read_as_such(tmp_path: Path) -> None:
    listed = [
        {"id": name, "K": CAMERAS.K[c].tolist(), "rvec": np.degrees(log_so3(CAMERAS.R[c])).tolist(),
         "tvec": CAMERAS.t[c].tolist(), "resolution": SIZE.tolist()} for c, name in enumerate(NAMES)
    ]  # fmt: skip
    (tmp_path / "cameras.json").write_text(json.dumps({"cameras": listed}), encoding="utf-8")
    found = read_calibration(tmp_path / "cameras.json", unit="m")
    assert [problem.code for problem in found.problems] == ["calibration_read_as"]
    np.testing.assert_allclose(found.cameras.R, CAMERAS.R, atol=1e-9)
