"""Test measures of the markers' benchmark: joints fixed in frames of markers, and the better of two fillings."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.geometry.rotations import exp_so3
from tests.benchmarks.marker_takes.held_out import better_by_gap
from tests.benchmarks.marker_takes.joint_angles import _between
from tests.benchmarks.marker_takes.rigid_bones import CLUSTERS, flexion_in_bones, motion_in_bones

FRAMES = 60


def limbs(rng: np.random.Generator, shift: float) -> tuple[tuple[str, ...], np.ndarray, dict[str, np.ndarray]]:
    """Return labels, markers and joints of four limbs with rigid bones. ``shift`` moves hinges against markers."""
    names = sorted({m.format(s=s) for found in CLUSTERS.values() for c in found for m in c for s in "LR"})
    markers, joints = np.zeros((FRAMES, len(names), 3)), {}
    angle = 0.6 + 0.5 * np.sin(np.linspace(0, 9, FRAMES))
    turned = exp_so3(angle[:, None] * [0.0, 1.0, 0.0])
    below = {"KNE", "SHN", "ANK", "HEE", "TOE", "MT5", "ELB", "FRM", "WRA", "WRB"}
    for i, name in enumerate(names):
        place = 0.3 * rng.normal(size=3)
        markers[:, i] = turned @ place if name[1:] in below else place
    for side in ("left", "right"):
        for parts in (("hip", "knee", "ankle"), ("shoulder", "elbow", "wrist")):
            lower = turned @ np.array([0.05, 0.02, -0.4])
            wander = shift * np.stack([np.zeros(FRAMES), np.zeros(FRAMES), np.sin(np.linspace(0, 40, FRAMES))], -1)
            places = (np.full((FRAMES, 3), [0.02, 0.0, 0.4]), wander @ exp_so3(np.array([0.0, 1.2, 0.0])).T, lower)
            joints |= {f"{side}_{part}": place for part, place in zip(parts, places, strict=True)}
    return tuple(names), markers, joints


def test_rigid_bones_are_met_exactly_and_a_wandering_knee_is_told() -> None:
    rng = np.random.default_rng(3)
    still, moved = limbs(rng, 0.0), limbs(rng, 0.02)
    assert max(motion_in_bones(*still).values()) < 1e-6
    assert max(rms for _, rms in flexion_in_bones(*still).values()) < 1e-6
    wandering = motion_in_bones(*moved)
    assert wandering["left_knee"] == pytest.approx(20 * 2 / np.pi, rel=0.1) and wandering["left_hip"] < 1e-6
    assert all(1.0 < rms < 6.0 for _, rms in flexion_in_bones(*moved).values())


def test_the_better_filling_is_picked_gap_by_gap() -> None:
    judged = np.zeros((8, 2), dtype=bool)
    judged[1:4, 0] = judged[5:7, 0] = judged[2:, 1] = True
    one, other = np.full((8, 2), 3.0), np.full((8, 2), 2.0)
    one[5:7, 0] = 1.0
    assert sorted(better_by_gap(one, other, judged).tolist()) == [1.0] * 2 + [2.0] * 9


def test_two_results_are_compared_at_the_times_they_share() -> None:
    time = np.arange(0.0, 1.0, 0.01)
    angle = 40 * np.sin(6 * time)
    one = {"time": time, "knee_angle_l": angle, "knee_angle_r": angle, "elbow_flex_l": angle}
    other = {"time": time[10:], **{name: values[10:] + 7.0 for name, values in one.items() if name != "time"}}
    other["knee_angle_r"] = other["knee_angle_r"] + 2**0.5 * np.tile([1.0, -1.0], 45)
    assert _between(one, other) == {"knee": pytest.approx(1.0), "elbow": pytest.approx(0.0, abs=1e-9)}
