"""The baselines of thesis tables 5.1 and 5.2 on markers that moved: robust losses beat least squares."""

from __future__ import annotations

import numpy as np
import pytest

from research.baselines import AdaptiveRobust, MoSh
from solver_backend.body.body import load_body
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.exchange.errors import MarkersUnknown
from solver_backend.geometry.rotations import exp_so3
from solver_backend.metrics import mpjpe_mm
from solver_backend.priors.gaussian_vae import load_vae
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture, MarkerCloud

LABELS = marker_layout("MANIFOLD_53")


@pytest.fixture(scope="module")
def take() -> tuple[Capture, np.ndarray]:
    """Four frames with a tenth of the markers displaced, and the true joints."""
    rng, body = np.random.default_rng(0), load_body()
    local = load_vae("rvposer").decode(0.5 * rng.normal(size=(4, 32)))
    root = exp_so3([np.pi / 2, 0.0, 0.0] + 0.2 * rng.normal(size=(4, 3)))
    posed = pose_landmarks(body, marker_landmarks(body, LABELS), np.zeros(10), root, local, np.full((4, 3), 1.0))
    moved = np.argsort(rng.random((4, 53)), axis=1) < 6
    points = posed.points + moved[..., None] * rng.uniform(-0.2, 0.2, (4, 53, 3))
    return Capture(name="take", markers=MarkerCloud(points, 60.0, tuple(LABELS))), posed.skeleton.joints


def test_barrons_loss_leaves_displaced_markers_behind(take: tuple[Capture, np.ndarray]) -> None:
    capture, joints = take
    results = [baseline.solve(capture) for baseline in (MoSh(), AdaptiveRobust())]
    errors = [mpjpe_mm(result.motion.joints, joints[:, :24]) for result in results]
    assert errors[0] < 40.0
    assert errors[1] < 0.5 * errors[0]
    assert results[0].keypoints3d.shape == (4, 53, 3)


def test_barrons_loss_with_a_shape_of_two_is_least_squares(take: tuple[Capture, np.ndarray]) -> None:
    least, shaped = (baseline.solve(take[0]).motion for baseline in (MoSh(), AdaptiveRobust(alpha=2.0)))
    np.testing.assert_array_equal(least.joints, shaped.joints)


def test_a_capture_without_markers_is_refused_by_name() -> None:
    with pytest.raises(MarkersUnknown, match=r"MoSh\+\+ fits markers, and the capture has none"):
        MoSh().solve(demo_capture(num_frames=5))
