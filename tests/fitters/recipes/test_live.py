"""Live fits: the noise-aware objective's own variances, and limbs that nobody sees for a while."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.joint_limits import JOINT_LIMITS, swing_and_twist
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks
from solver_backend.fitters.recipes.live import SHAPE_FRAMES, LiveFit
from solver_backend.geometry.rotations import exp_so3
from solver_backend.labelling.outputs import MARKERS

FPS, FRAMES = 120.0, 300
ARM = [i for i, name in enumerate(MARKERS) if name[0] == "L" and name[1:] in ("ELB", "IEL", "WRA", "WRB", "FIN", "FRM")]
ELBOW = 17
"""Column of the left elbow among joints 1 to 21."""


@pytest.fixture(scope="module")
def walk() -> tuple[np.ndarray, np.ndarray]:
    """(F, 53, 3) markers and (F, 24, 3) joints of a tall body with lowered arms that swings one of them."""
    body, t = load_body(), np.arange(FRAMES) / FPS
    local = np.zeros((FRAMES, 21, 3))
    local[:, 15, 2], local[:, 16, 2], local[:, 15, 1] = -1.0, 1.0, 0.3 * np.sin(3 * t)
    root = np.broadcast_to(exp_so3(np.array([np.pi / 2, 0, 0])), (FRAMES, 3, 3))
    ahead = np.stack([0 * t, -1.2 * t, 0.9 + 0 * t], axis=1)
    betas = np.array([1.0, *np.zeros(9)])
    posed = pose_landmarks(body, marker_landmarks(body, MARKERS), betas, root, exp_so3(local), ahead)
    return posed.points, posed.skeleton.joints


def fitted(fit: LiveFit, points: np.ndarray, guess: np.ndarray) -> list:
    """Return every frame fitted, where the network is 20 cm sure of its guesses."""
    sigma = np.full(len(MARKERS), 0.2)
    return [fit.step(frame, told, sigma, 1 / FPS) for frame, told in zip(points, guess, strict=True)]


def test_the_pose_and_the_shape_are_found_and_the_shape_stays(walk):
    points, _ = walk
    fit = LiveFit(load_body())
    assert fit.known_shape is None
    found = fitted(fit, points, points)
    assert np.linalg.norm(found[-1].landmarks - points[-1], axis=-1).mean() < 0.005
    assert fit.known_shape is not None and len(found) > SHAPE_FRAMES
    assert fit.known_shape[0] == pytest.approx(1.0, abs=0.35)


def test_an_outlier_moves_the_body_by_little(walk):
    points, _ = walk
    spoiled = points.copy()
    spoiled[:, MARKERS.index("LKNE")] += (0.3, 0.0, 0.0)
    found = fitted(LiveFit(load_body(), betas=np.array([1.0, *np.zeros(9)])), spoiled, points)
    assert np.linalg.norm(found[-1].landmarks - points[-1], axis=-1).max() < 0.03


def test_an_unseen_arm_stays_within_anatomy_though_the_network_is_wrong_of_it(walk):
    points, _ = walk
    hidden, wrong = points.copy(), points.copy()
    hidden[150:270, ARM] = np.nan
    wrong[:, ARM] += (0.0, 0.0, 0.6)
    found = fitted(LiveFit(load_body(), betas=np.array([1.0, *np.zeros(9)])), hidden, wrong)
    off = np.linalg.norm(found[269].landmarks[ARM] - points[269, ARM], axis=-1)
    assert off.max() < 0.3
    angles = swing_and_twist(found[269].pose.local)[0]
    low, high = JOINT_LIMITS[..., 0], JOINT_LIMITS[..., 1]
    assert (angles[ELBOW] > low[ELBOW] - 0.2).all() and (angles[ELBOW] < high[ELBOW] + 0.2).all()
    seen_again = np.linalg.norm(found[-1].landmarks - points[-1], axis=-1)
    assert seen_again.max() < 0.02
