"""A frame rate that is twice or half the true one is named by how people walk, run, fall and balance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import sentence
from solver_backend.io.recognition.balance import BalancePoints
from solver_backend.report.frame_rate.balance import G, rate_by_balance
from solver_backend.report.frame_rate.flight import falls_of, rate_by_flight
from solver_backend.report.frame_rate.steps import Gait, gait_of, rate_by_run, rate_by_walk
from solver_backend.report.time_plausibility import CHANGE, frame_rate_plausibility, shown_rate
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import SMPL_JOINTS, JointSet, Motion
from tests.support.foreign_clips import cmu_limbs, ui_prmd_limbs
from tests.support.solved import solved

FPS, STEP_S, STEP_M, ASIDE_M, HEIGHT_M, LIFT_M = 60.0, 0.55, 0.6, 0.1, 0.9, 0.12
FACTORS = [(1.0, 1.0), (2.0, 0.5), (0.5, 2.0)]
"""Times the true rate as stated, and the factor that is found."""


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
    swung = (1 - np.cos(np.pi * share)) / 2  # a foot starts and lands at rest
    lift = LIFT_M * np.sin(np.pi * share)
    swinging = np.stack([(step - 1 + 2 * swung) * STEP_M, -side * ASIDE_M, lift], axis=-1)
    centre = np.stack([step * STEP_M + ahead, aside, np.full_like(t, HEIGHT_M)], axis=-1)
    left = (side > 0)[:, None]
    feet = np.stack([np.where(left, standing, swinging), np.where(left, swinging, standing)])
    return BalancePoints(centre, feet, 0.9)


def legs(body: BalancePoints) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (2, F, 3) hips, knees and ankles of somebody who faces X."""
    hips = np.stack([body.centre + [0.0, side * ASIDE_M, -0.05] for side in (1, -1)])
    return hips, (hips + body.feet) / 2, body.feet


@pytest.mark.parametrize(("stated", "factor"), FACTORS)
def test_the_rate_of_a_walk_is_known_by_its_steps(stated: float, factor: float) -> None:
    body = walker()
    gait = gait_of(*legs(body), body.centre, FPS * stated)
    assert gait.walked >= 6 and gait.run == 0
    assert rate_by_walk(gait, CHANGE) == factor


@pytest.mark.parametrize(("stated", "factor"), FACTORS)
def test_the_rate_of_a_jump_is_known_by_its_fall(stated: float, factor: float) -> None:
    t = np.arange(0.0, 2.0, 1.0 / FPS)
    up = np.maximum(0.0, 0.3 - 0.5 * G * (t - 1.0) ** 2)
    centre = np.stack([0 * t, 0 * t, 0.95 + up], axis=-1)
    feet = np.stack([centre * [1, 1, 0] + np.stack([0 * t, 0 * t + y, up], axis=-1) for y in (0.1, -0.1)])
    body = BalancePoints(centre, feet, 0.9)
    assert rate_by_flight(falls_of(body, np.ones(len(t)), FPS * stated), CHANGE) == factor
    assert len(falls_of(body, np.zeros(len(t)), FPS)) == 0  # a cartwheel


def test_who_neither_falls_nor_rises_shows_no_rate() -> None:
    assert rate_by_run(Gait(0, np.nan, np.nan, 4, 0.0, 0.3), CHANGE) is None
    t = np.arange(120.0)
    feet = np.stack([np.stack([0 * t, 0 * t, np.where((t > 40) & (t < 60), 0.5, 0.0)], axis=-1)] * 2)
    assert len(falls_of(BalancePoints(np.zeros((120, 3)), feet, 0.9), np.ones(120), FPS)) == 0


@pytest.mark.parametrize(("stated", "factor"), [(1.0, None), (2.0, 0.5), (0.5, 2.0)])
def test_the_rate_of_a_pendulum_is_known_by_its_balance(stated: float, factor: float | None) -> None:
    assert rate_by_balance(walker(), FPS * stated, CHANGE) == factor


def test_a_moment_shows_nothing() -> None:
    body = walker(0.6)
    assert rate_by_balance(body, 2 * FPS, CHANGE) is None
    assert rate_by_walk(gait_of(*legs(body), body.centre, 2 * FPS), CHANGE) is None


def test_the_demo_and_short_takes_are_left_alone() -> None:
    _, motion = solved(faults=False)
    assert list(frame_rate_plausibility(motion)) == []
    assert list(frame_rate_plausibility(replace(motion, fps=0.5 * motion.fps))) == []
    demo = demo_capture(360, FPS)
    assert demo.keypoints is not None
    order = [demo.keypoints.joint_set.keypoints.index(name) for name in JointSet.COCO_17.keypoints]
    assert shown_rate(np.asarray(demo.truth["keypoints3d"])[:, order], FPS)[0] == 1.0


@pytest.mark.parametrize(
    ("name", "movement"), [("02_01", "walk"), ("09_01", "run"), ("02_04", "fall"), ("14_12", "balance")]
)
def test_recorded_people_show_their_rate(shared_data: Path, name: str, movement: str) -> None:
    points, fps = cmu_limbs(shared_data / "motion_cmu" / "asfamc" / f"{name}.npz")
    assert shown_rate(points, fps)[0] == 1.0
    assert shown_rate(points, 2 * fps) == (0.5, movement)
    assert shown_rate(points, fps / 2) == ((1.0, "") if movement == "balance" else (2.0, movement))


@pytest.mark.parametrize("name", ["16_15", "127_05", "14_14", "49_21"])
def test_recorded_people_are_left_alone(shared_data: Path, name: str) -> None:
    """A walk, a run, exercises and a dance; a charleston, whose feet swing under the body, is beyond it."""
    assert shown_rate(*cmu_limbs(shared_data / "motion_cmu" / "asfamc" / f"{name}.npz"))[0] == 1.0


@pytest.mark.parametrize("name", ["m03_s07_e05", "m03_s02_e08", "m08_s01_e02"])
def test_slow_exercises_are_left_alone(shared_data: Path, name: str) -> None:
    """Slow lunges on the toes of one foot were taken for movements at twice the rate."""
    assert shown_rate(*ui_prmd_limbs(shared_data / "markers" / "ui_prmd" / f"{name}.npz"))[0] == 1.0


def test_the_warning_names_both_rates_and_the_option(shared_data: Path) -> None:
    points, fps = cmu_limbs(shared_data / "motion_cmu" / "asfamc" / "02_01.npz")
    count, names = len(points), JointSet.COCO_17.keypoints
    joints = np.zeros((count, len(SMPL_JOINTS), 3))
    for k, name in enumerate(names):
        if name in SMPL_JOINTS:
            joints[:, SMPL_JOINTS.index(name)] = points[:, k]
    turns = np.zeros((count, 69))
    (found,) = frame_rate_plausibility(
        Motion(np.zeros(10), turns[:, :3], turns, turns[:, :3], 2 * fps, "neutral-1", joints)
    )
    text = sentence(found)
    assert "60 a second seems too high: people walk so at about 30" in text and "--fps 30" in text
