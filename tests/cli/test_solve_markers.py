"""The command line on a C3D of our own making: recognised, solved, reported, and read back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.markers import marker_layout
from solver_backend.cli.main import main
from solver_backend.exchange.motion_file import is_motion
from solver_backend.exchange.motion_file import read_motion as read_shown
from solver_backend.io.markers.c3d import write_c3d
from solver_backend.io.native.motion_file import read_motion
from tests.support.worn_markers import WornMarkers, worn_markers

LABELS = marker_layout("PLUGIN_GAIT_39")
FRAMES = 40


@pytest.fixture(scope="module")
def worn() -> WornMarkers:
    return worn_markers(LABELS, FRAMES)


@pytest.fixture(scope="module")
def take(worn: WornMarkers, tmp_path_factory: pytest.TempPathFactory) -> Path:
    points = worn.cloud.positions.copy()
    points[14:18, LABELS.index("LFIN")] = np.nan
    points = np.concatenate([points, points[:, :2] + 0.02], axis=1)
    labels = (*(f"Anna:{label}" for label in LABELS), "Anna:LHJC", "Anna:wand")
    cloud = type(worn.cloud)(points, worn.cloud.fps, labels)
    return write_c3d(tmp_path_factory.mktemp("take") / "walk.c3d", cloud)


@pytest.fixture(scope="module")
def solved(take: Path) -> Path:
    out = take.with_name("motion.npz")
    assert main(["solve", str(take), "--out", str(out), "--report", str(take.with_name("page.html"))]) == 0
    return out


def test_info_says_what_was_recognised(take, capsys):
    assert main(["info", str(take), "--json"]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (result["frames"], result["fps"], result["markers"], result["cameras"]) == (FRAMES, 60.0, 41, [])
    names = result["marker_names"]
    assert len(names["known"]) == 39 and names["subjects"] == ["Anna"]
    assert (names["unknown"], names["computed"], names["unlabelled"]) == (["Anna:wand"], ["Anna:LHJC"], 0)
    assert names["gaps"] == [{"marker": "Anna:LFIN", "gaps": 1, "missing_percent": 10.0}]
    assert main(["info", str(take)]) == 0
    text = capsys.readouterr().out
    assert "markers     41: 39 known, 1 unknown, 1 computed" in text
    assert "Lengths are in mm" in text and "Z points up" in text
    assert "gaps        1 in 1 markers, most in Anna:LFIN" in text


def test_a_known_motion_is_recovered(worn, solved):
    motion = read_motion(solved)
    error = 1000 * np.linalg.norm(motion.joints - worn.joints, axis=-1)
    assert error.mean() < 15.0
    assert motion.markers is not None and motion.marker_residual_mm is not None
    # A marker that no layout knows moves with the head, beside whose markers it was put.
    assert motion.marker_labels == (*(f"Anna:{label}" for label in LABELS), "Anna:wand")
    assert motion.layout[-1] in ("@head", "@neck")
    assert motion.keypoints3d is None and motion.reprojection_px is None
    distance = 1000 * np.linalg.norm(motion.markers[:, :-1] - worn.cloud.positions, axis=-1)
    missing = np.isnan(motion.marker_residual_mm[:, :-1])
    assert missing.sum() == 4 and missing[14:18, LABELS.index("LFIN")].all()
    np.testing.assert_allclose(motion.marker_residual_mm[:, :-1][~missing], distance[~missing], atol=1e-2)
    assert np.median(distance) < 5.0
    assert distance[missing].mean() < 25.0


def test_the_add_on_reads_the_motion(solved):
    assert is_motion(solved)
    shown = read_shown(solved)
    assert shown.num_frames == FRAMES and shown.keypoints3d is None and shown.reprojection_px is None


def test_command_line_and_report_speak_of_markers(take, solved, capsys):
    page = take.with_name("page.html").read_text(encoding="utf-8")
    assert "Marker residual" in page and "Residual in millimetres" in page and "rejected" in page and "LFIN" in page
    for camera_word in ("Reprojection", "None px", "px (", "two cameras", "Cameras and keypoints", "wedges"):
        assert camera_word not in page, camera_word
    argv = ["solve", str(take), "--out", str(take.with_name("again.npz")), "--method", "frame", "--json"]
    assert main(argv) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert result["reprojection_median_px"] is None and 0 < result["marker_median_mm"] < 15


@pytest.mark.slow
def test_a_stretch_of_markers_is_solved_again(take, solved):
    out = take.with_name("stretch.npz")
    assert main(["solve", str(take), "--resolve", str(solved), "--frames", "14", "28", "--out", str(out)]) == 0
    before, after = read_motion(solved), read_motion(out)
    assert before.markers is not None and after.markers is not None
    np.testing.assert_array_equal(after.markers[:10], before.markers[:10])
    assert after.marker_labels == before.marker_labels
