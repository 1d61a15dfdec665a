"""A frame rate that is twice or half the true one is named by how people walk; the true one never is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.io.recognition.balance import BalancePoints, body_points
from solver_backend.report.time_plausibility import G, frame_rate_plausibility, likely_rate
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import JointSet
from tests.support.foreign_clips import cmu_limbs
from tests.support.solved import solved

FPS, STEP_S, STEP_M, ASIDE_M, HEIGHT_M, LIFT_M = 60.0, 0.55, 0.6, 0.1, 0.9, 0.12


def walker(seconds: float = 8.0) -> BalancePoints:
    """Return somebody who walks as an inverted pendulum, whose weight is carried where its foot is.

    ``c'' = (g / h) (c - p)``: forwards c - p grows as sinh, sideways as cosh, over each step.
    Reference: Kajita et al. 2001, "The 3D linear inverted pendulum mode".
    """
    t = np.arange(0.0, seconds, 1.0 / FPS)
    step = (t / STEP_S).astype(int)
    into, side = t - (step + 0.5) * STEP_S, np.where(step % 2, 1.0, -1.0)
    w = np.sqrt(G / HEIGHT_M)
    ahead = 0.5 * STEP_M * np.sinh(w * into) / np.sinh(0.5 * w * STEP_S)
    aside = side * ASIDE_M * (1.0 - np.cosh(w * into) / np.cosh(0.5 * w * STEP_S))
    standing = np.stack([step * STEP_M, side * ASIDE_M, np.zeros_like(t)], axis=-1)
    share = into / STEP_S + 0.5
    lift = LIFT_M * np.sin(np.pi * share)
    swinging = np.stack([(step - 1 + 2 * share) * STEP_M, -side * ASIDE_M, lift], axis=-1)
    centre = np.stack([step * STEP_M + ahead, aside, np.full_like(t, HEIGHT_M)], axis=-1)
    left = (side > 0)[:, None]
    feet = np.stack([np.where(left, standing, swinging), np.where(left, swinging, standing)])
    return BalancePoints(centre, feet, 0.9)


@pytest.mark.parametrize(("stated", "factor"), [(1.0, 1.0), (2.0, 0.5), (0.5, 2.0)])
def test_the_rate_of_a_walk_is_known_by_its_balance(stated: float, factor: float) -> None:
    assert likely_rate(walker(), FPS * stated) == factor


def test_a_moment_shows_nothing() -> None:
    assert likely_rate(walker(0.6), 2 * FPS) == 1.0


def test_the_demo_and_short_takes_are_left_alone() -> None:
    _, motion = solved(faults=False)
    assert list(frame_rate_plausibility(motion)) == []
    assert list(frame_rate_plausibility(replace(motion, fps=0.5 * motion.fps))) == []
    demo = demo_capture(360, FPS)
    assert demo.keypoints is not None
    assert likely_rate(body_points(np.asarray(demo.truth["keypoints3d"]), demo.keypoints.joint_set), FPS) == 1.0


def test_recorded_people_are_left_alone(shared_data: Path) -> None:
    """Of walks, dances and exercises; a charleston, whose feet swing under the body, is beyond it."""
    clips = [f"motion_cmu/asfamc/{name}.npz" for name in ("02_01", "16_15", "49_21", "127_05", "14_14")]
    found = [
        (body_points(points, JointSet.COCO_17), fps) for points, fps in (cmu_limbs(shared_data / c) for c in clips)
    ]
    assert {likely_rate(body, fps) for body, fps in found} == {1.0}
    assert [likely_rate(body, 2 * fps) for body, fps in found].count(0.5) >= 2
