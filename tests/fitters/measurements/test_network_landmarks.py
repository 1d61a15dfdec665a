"""Direct solving: what the labelling network has for every frame is fitted, without labels for the points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.cli.main import main
from solver_backend.exchange.errors import JobInvalid, NoDetections, SubjectInvalid
from solver_backend.exchange.progress import silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.measurements.markers import measure_network_landmarks
from solver_backend.fitters.pipeline import prepare, solve
from solver_backend.labelling.outputs import JOINTS, LANDMARKS, MARKERS
from solver_backend.labelling.point_network import frame_landmarks, load_network
from solver_backend.synthesis.embedded.demo import DEMO_TAKE, demo_capture, record_markers
from solver_backend.types import Capture, MarkerCloud, MarkerSubject

DIRECT = SolveSettings(method="noise-aware", landmarks="network")


@pytest.fixture(scope="module")
def recorded():
    return record_markers(24, seed=5, layout="MANIFOLD_53")


def nameless(cloud: MarkerCloud, seed: int = 0) -> MarkerCloud:
    """The points of every frame in an order of its own."""
    rng = np.random.default_rng(seed)
    order = np.argsort(rng.random(cloud.positions.shape[:2]), axis=1)
    return MarkerCloud(np.take_along_axis(cloud.positions, order[..., None], axis=1), cloud.fps)


def test_landmarks_are_where_the_markers_and_joints_are_whatever_the_order(recorded):
    network = load_network()
    found = frame_landmarks(nameless(recorded.cloud).positions, network)
    assert found.shape == (24, len(LANDMARKS), 3)
    error = np.linalg.norm(found[:, : len(MARKERS)] - recorded.cloud.positions[:, : len(MARKERS)], axis=-1)
    assert np.nanmedian(error) < 0.02
    joints = np.linalg.norm(found[:, -len(JOINTS) :] - recorded.joints, axis=-1)
    assert np.median(joints) < 0.03
    np.testing.assert_allclose(frame_landmarks(nameless(recorded.cloud, 1).positions, network), found, atol=1e-4)


def test_frames_with_too_few_points_have_no_landmarks(recorded):
    positions = recorded.cloud.positions.copy()
    positions[3, 5:] = np.nan
    found = frame_landmarks(positions, load_network())
    assert np.isnan(found[3]).all() and np.isfinite(found[[2, 4]]).all()
    with pytest.raises(NoDetections, match="6 points"):
        frame_landmarks(positions[3:4], load_network())


def test_joints_are_measured_where_they_are_asked_for(recorded):
    body, cloud = load_body(), nameless(recorded.cloud)
    markers = measure_network_landmarks(cloud, body, np.zeros(1), joints=False)
    both = measure_network_landmarks(cloud, body, np.zeros(1), joints=True)
    assert markers.points.shape == (24, 53, 3) and both.points.shape == (24, 77, 3)
    assert both.landmarks.names == LANDMARKS
    np.testing.assert_array_equal(both.points[:, :53], markers.points)


@pytest.mark.slow
def test_a_cloud_without_names_is_solved_directly(recorded):
    capture = Capture("nameless", markers=nameless(recorded.cloud))
    motion = solve(capture, DIRECT).motion
    assert np.linalg.norm(motion.joints - recorded.joints, axis=-1).mean() < 0.04
    assert motion.marker_labels == LANDMARKS[:53]
    assert motion.provenance["landmark_network"] == load_network().sha256


def test_what_cannot_be_together_is_refused(recorded):
    for other in (replace(DIRECT, layout="own.json"), replace(DIRECT, method="global")):
        with pytest.raises(JobInvalid, match="'noise-aware' without a marker layout"):
            prepare(demo_capture(8), other, silent)
    with pytest.raises(JobInvalid, match="need a marker recording"):
        prepare(demo_capture(8), DIRECT, silent)
    one = np.zeros((1, 3))
    person = MarkerSubject("neutral", np.zeros(10), ("C7",), ("C7",), one, np.array([0.01]), np.array([0.01]))
    with pytest.raises(SubjectInvalid, match="cannot be combined"):
        solve(Capture("nameless", markers=nameless(recorded.cloud)), DIRECT, person=person)


def test_labels_from_a_person_and_a_networks_landmarks_exclude_each_other(tmp_path, capsys):
    labels, out = tmp_path / "labels.json", tmp_path / "m.npz"
    labels.write_text("{}")
    take = ["solve", str(DEMO_TAKE), "--out", str(out), "--labels", str(labels)]
    assert main([*take, "--method", "noise-aware", "--landmarks", "network"]) != 0
    assert "cannot be combined with --landmarks" in capsys.readouterr().err
    assert not out.exists()
