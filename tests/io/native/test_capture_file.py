"""Capture files come back as they were written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import (
    CalibrationInvalid,
    CalibrationMismatch,
    CaptureInvalid,
    FileDamaged,
    KeypointCountMismatch,
    NonFiniteData,
    OutputExists,
)
from solver_backend.exchange.npz import read_npz, write_npz
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.types import Capture, JointSet
from tests.support.scenes import small_capture, small_markers


def assert_same(a: Capture, b: Capture) -> None:
    for key in ("name", "sources", "notes", "problems"):
        assert getattr(a, key) == getattr(b, key)
    assert (a.cameras is None) == (b.cameras is None)
    if a.cameras is not None and b.cameras is not None:
        assert (a.cameras.names, a.cameras.models) == (b.cameras.names, b.cameras.models)
        for key in ("K", "distortion", "R", "t", "image_size"):
            np.testing.assert_array_equal(getattr(a.cameras, key), getattr(b.cameras, key))
    assert (a.keypoints is None) == (b.keypoints is None)
    if a.keypoints is not None and b.keypoints is not None:
        assert (a.keypoints.joint_set, a.keypoints.fps) == (b.keypoints.joint_set, b.keypoints.fps)
        np.testing.assert_array_equal(a.keypoints.xy, b.keypoints.xy)
        np.testing.assert_array_equal(a.keypoints.confidence, b.keypoints.confidence)
    assert a.truth.keys() == b.truth.keys()
    for key in a.truth:
        np.testing.assert_array_equal(a.truth[key], b.truth[key])


@pytest.mark.parametrize("frames", [1, 7])
@pytest.mark.parametrize("joint_set", [JointSet.BODY_25B, JointSet.HALPE_26])
def test_round_trip(tmp_path: Path, frames: int, joint_set: JointSet) -> None:
    capture = small_capture(frames, joint_set)
    back = read_capture(write_capture(tmp_path / "c.npz", capture))
    assert_same(capture, back)
    assert back.keypoints is not None
    assert np.isnan(back.keypoints.xy[0, 0, 0]).all()
    assert back.keypoints.confidence[0, 0, 0] == 0


def test_missing_optional_parts(tmp_path: Path) -> None:
    capture = replace(small_capture(), footage=(), truth={}, notes=(), problems=(), sources=())
    back = read_capture(write_capture(tmp_path / "c.npz", capture))
    assert_same(capture, back)
    assert back.footage == ()
    assert "markers" not in " ".join(read_npz(tmp_path / "c.npz"))


def test_other_points_are_written_without_residuals(tmp_path: Path) -> None:
    markers = small_markers()
    write_capture(tmp_path / "c.npz", Capture("m", markers=markers, others=markers))
    stored = {name for name in read_npz(tmp_path / "c.npz") if name.startswith("other_")}
    assert stored == {"other_positions", "other_labels"}


def test_markers_alone(tmp_path: Path) -> None:
    capture = Capture("m", markers=small_markers())
    back = read_capture(write_capture(tmp_path / "c.npz", capture))
    assert back.cameras is None
    assert back.keypoints is None
    assert back.markers is not None
    assert capture.markers is not None
    np.testing.assert_array_equal(back.markers.positions, capture.markers.positions)
    assert back.markers.residual is not None
    np.testing.assert_array_equal(back.markers.residual, np.full((5, 3), 0.5))
    assert (back.markers.labels, back.markers.fps, back.num_frames) == (("LASI", "RASI", "C7"), 120.0, 5)


def test_covariances_of_markers_come_back(tmp_path: Path) -> None:
    markers = small_markers()
    shape = np.random.default_rng(0).normal(size=(*markers.positions.shape, 3))
    covariance = 1e-6 * shape @ shape.swapaxes(-1, -2)
    covariance[2, 1] = np.nan
    given = Capture("m", markers=replace(markers, covariance=covariance))
    back = read_capture(write_capture(tmp_path / "c.npz", given))
    assert back.markers is not None and back.markers.covariance is not None
    np.testing.assert_allclose(back.markers.covariance, covariance, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("wrong", [np.inf, -1e-6])
def test_a_covariance_that_is_none_is_refused(tmp_path: Path, wrong: float) -> None:
    markers = small_markers()
    covariance = np.tile(1e-6 * np.eye(3), (*markers.positions.shape[:2], 1, 1))
    seen = np.argwhere(np.isfinite(markers.positions).all(-1))[0]
    covariance[tuple(seen)][0, 0] = wrong
    path = write_capture(tmp_path / "c.npz", Capture("m", markers=replace(markers, covariance=covariance)))
    with pytest.raises(NonFiniteData, match=f"frame {seen[0]}, marker {seen[1]}"):
        read_capture(path)


def test_footage_moves_with_its_folder(tmp_path: Path) -> None:
    (tmp_path / "take").mkdir()
    outside = tmp_path / "elsewhere.mp4"
    footage = (tmp_path / "take" / "videos" / "a.mp4", None, outside, None)
    write_capture(tmp_path / "take" / "c.npz", replace(small_capture(), footage=footage))
    (tmp_path / "take").rename(tmp_path / "moved")
    back = read_capture(tmp_path / "moved" / "c.npz")
    assert back.footage == (tmp_path / "moved" / "videos" / "a.mp4", None, outside, None)


def test_no_overwriting(tmp_path: Path) -> None:
    write_capture(tmp_path / "c.npz", small_capture())
    with pytest.raises(OutputExists):
        write_capture(tmp_path / "c.npz", small_capture())
    write_capture(tmp_path / "c.npz", small_capture(3), overwrite=True)
    assert read_capture(tmp_path / "c.npz").num_frames == 3


def damaged(tmp_path: Path, **changes: np.ndarray | None) -> Path:
    arrays = read_npz(write_capture(tmp_path / "good.npz", small_capture()))
    arrays |= {key: value for key, value in changes.items() if value is not None}
    return write_npz(
        tmp_path / "bad.npz", {k: v for k, v in arrays.items() if not (k in changes and changes[k] is None)}
    )


@pytest.mark.parametrize(
    ("changes", "error", "text"),
    [
        (
            {"xy": np.zeros((4, 0, 17, 2)), "confidence": np.zeros((4, 0, 17))},
            CaptureInvalid,
            "The capture has no frames",
        ),
        (
            {
                "xy": np.zeros((0, 7, 17, 2)),
                "confidence": np.zeros((0, 7, 17)),
                "camera_names": np.zeros(0, "<U1"),
                "K": np.zeros((0, 3, 3)),
                "distortion": np.zeros((0, 8)),
                "R": np.zeros((0, 3, 3)),
                "t": np.zeros((0, 3)),
                "image_size": np.zeros((0, 2)),
            },
            CaptureInvalid,
            "The capture has no views",
        ),
        ({"footage_first": np.full(4, np.inf)}, CaptureInvalid, "footage_first contains NaN or infinite"),
        (
            {"truth_joints": np.full((7, 24, 3), 1e30)},
            CaptureInvalid,
            "ground truth 'joints' contains an impossible number",
        ),
        ({"format": np.array("else")}, FileDamaged, "not a capture: its format is 'else'"),
        ({"format": None}, FileDamaged, "does not state a format"),
        ({"version": np.array(2)}, FileDamaged, r"version 2.*reads up to 1.*Update"),
        ({"confidence": None}, FileDamaged, r"does not contain 'confidence'. It contains .*camera_names"),
        ({"R": None}, FileDamaged, "does not contain 'R'"),
        ({"xy": np.zeros((4, 7, 17, 3))}, FileDamaged, r"shape \(any, any, any, 2\)"),
        ({"K": np.array("no")}, FileDamaged, "'K' is <U2"),
        ({"joint_set": np.array("BODY_9")}, FileDamaged, r"Unknown joint set 'BODY_9'. Known sets: BODY_25, "),
        ({"joint_set": np.array("HALPE_26")}, KeypointCountMismatch, r"17 keypoints do not fit HALPE_26.*COCO_17"),
        ({"R": np.ones((4, 3, 3))}, CalibrationInvalid, r"not orthonormal.*camera cam_a"),
        ({"t": np.full((4, 3), np.nan)}, CalibrationInvalid, "t contains NaN"),
        ({"xy": np.full((4, 7, 17, 2), np.inf)}, NonFiniteData, r"infinite.*view 0, frame 0, nose"),
        ({"fps": np.array(0.0)}, NonFiniteData, "frame rate"),
        (
            {"xy": np.zeros((3, 7, 17, 2)), "confidence": np.zeros((3, 7, 17))},
            CalibrationMismatch,
            "4 cameras .*3 views",
        ),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, changes: dict, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        read_capture(damaged(tmp_path, **changes))
