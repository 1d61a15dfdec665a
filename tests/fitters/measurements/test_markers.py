"""Optical markers through the bundle that solves views: made from our body, and a real walk beside its skeleton."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.exchange.errors import MarkersUnknown, NoDetections
from solver_backend.exchange.progress import silent
from solver_backend.fitters import Solution, SolveSettings, solve_problem
from solver_backend.fitters.marker_calibration.marker_problem import marker_problem
from solver_backend.fitters.measurements.markers import measure_markers
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.native.motion_file import read_motion, write_motion
from solver_backend.priors.sposer import load_sposer
from solver_backend.residuals.positions import PositionTerm
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import FLAG_UNSEEN, SMPL_JOINTS, MarkerCloud

LABELS = marker_layout("CMU_41")
FRAMES, FPS = 60, 60.0
AWAY = slice(28, 38)
"""Frames in which no marker is seen."""


def solved(cloud: MarkerCloud) -> Solution:
    body = load_body()
    problem = marker_problem(cloud, body, load_sposer(), np.zeros(1), SolveSettings(), silent)
    return solve_problem(problem, SolveSettings())


@pytest.fixture(scope="module")
def worn() -> tuple[MarkerCloud, np.ndarray]:
    """Return markers that sit up to 2 cm off their places on a body of known shape, and its joints."""
    truth, body, rng = demo_capture().truth, load_body(), np.random.default_rng(8)
    landmarks = marker_landmarks(body, LABELS)
    subject = Subject(body, landmarks, truth["betas"], 0.008 * rng.normal(size=(len(LABELS), 3)))
    local = exp_so3(truth["body_pose"][:FRAMES, :63].reshape(-1, 21, 3))
    frames = PosedFrames(exp_so3(truth["global_orient"][:FRAMES]), local, truth["transl"][:FRAMES])
    points = pose(subject, frames).points + 0.001 * rng.normal(size=(FRAMES, len(LABELS), 3))
    points[rng.random(points.shape[:2]) < 0.05] = np.nan
    points[AWAY] = np.nan
    return MarkerCloud(points, FPS, tuple(f"Somebody:{label}" for label in LABELS)), truth["joints"][:FRAMES]


@pytest.fixture(scope="module")
def solution(worn) -> Solution:
    return solved(worn[0])


@pytest.mark.slow
def test_a_known_motion_is_recovered(worn, solution):
    cloud, joints = worn
    seen = np.ones(FRAMES, dtype=bool)
    seen[AWAY] = False
    error = 1000 * np.linalg.norm(solution.motion.joints - joints, axis=-1)
    residual = 1000 * np.linalg.norm(solution.motion.markers - cloud.positions, axis=-1)
    assert error[seen].mean() < 12.0
    assert np.nanmedian(residual) < 4.0
    assert error[~seen].mean() < 35.0


def test_the_motion_tells_what_it_tells_of_views(solution):
    motion = solution.motion
    assert motion.reprojection_px is None and motion.joint_set is None
    np.testing.assert_array_equal((motion.flags & FLAG_UNSEEN) > 0, np.isin(np.arange(FRAMES), np.r_[AWAY]))
    assert (motion.joint_sigma > 0).all() and motion.joint_sigma[AWAY].mean() > motion.joint_sigma[:20].mean()
    assert motion.provenance["markers"] == list(LABELS) and (np.array(motion.provenance["sigma_mm"]) >= 3.0).all()
    assert {"marker_median_mm", "marker_rmse_mm", "outliers_percent"} <= set(motion.provenance["statistics"])
    assert motion.provenance["status"] == solution.status


def test_the_motion_is_written_and_read_back(solution, tmp_path: Path):
    write_motion(tmp_path / "m.npz", solution.motion)
    np.testing.assert_allclose(read_motion(tmp_path / "m.npz").body_pose, solution.motion.body_pose, atol=1e-6)


@pytest.mark.slow
@pytest.mark.shared
def test_a_real_walk_is_solved(shared_data: Path):
    """CMU 02_01, 41 markers, every eighth frame; the skeleton beside it has other joint centres (34 mm by plain
    least squares on all frames, see ``bench_markers_cmu``)."""
    pytest.importorskip("ezc3d")
    from tests.support.cmu_marker_take import read_take

    if not (shared_data / "bvh_samples" / "cmu_mb2_02_01.bvh").is_file():
        pytest.skip("the walk's skeleton is not among the recordings")
    take, every = read_take(shared_data), 8
    assert set(take.labels) == set(LABELS)
    motion = solved(MarkerCloud(take.markers[::every], 120.0 / every, take.labels)).motion
    residual = 1000 * np.linalg.norm(motion.markers - take.markers[::every], axis=-1)
    error = [
        1000 * np.linalg.norm(motion.joints[:, SMPL_JOINTS.index(name)] - joints[::every], axis=-1).mean()
        for name, joints in take.joints.items()
    ]
    assert residual.mean() < 9.0
    assert np.mean(error) < 35.0


def test_what_cannot_be_named_is_named(worn):
    cloud, body = worn[0], load_body()
    for labels, message in (
        (None, "The markers have no labels.*Label them"),
        (("XYZ", *LABELS[1:]), "No known layout contains the marker XYZ.*Known markers: ARIEL, C7"),
        ((LABELS[1], *LABELS[1:]), "Labels occur more than once: RFHD"),
    ):
        with pytest.raises(MarkersUnknown, match=message):
            measure_markers(replace(cloud, labels=labels), body, np.zeros(1))
    nothing = replace(cloud, positions=np.full_like(cloud.positions, np.nan))
    with pytest.raises(NoDetections, match="No frame has enough markers"):
        measure_markers(nothing, body, np.zeros(1))


def test_what_the_tracker_says_of_its_error_adds_to_the_places(worn):
    cloud, _ = worn
    body, known = load_body(), np.isfinite(cloud.positions).all(-1)
    residual = np.where(known, np.linspace(0.0, 0.03, known.size).reshape(known.shape), np.nan)
    plain = measure_markers(cloud, body, np.zeros(1), 0.01)
    unsure = measure_markers(replace(cloud, residual=residual), body, np.zeros(1), 0.01)
    expected = np.where(known, 1.0 / (0.01**2 + np.nan_to_num(residual) ** 2), 0.0)
    assert isinstance(unsure.term, PositionTerm) and isinstance(plain.term, PositionTerm)
    assert np.allclose(unsure.term.weight, expected) and np.allclose(plain.term.weight, known / 0.01**2)
