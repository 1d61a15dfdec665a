"""Evaluate a real take with hands: detection rate, steadiness and reprojection error, with an optional picture.

``python -m tests.benchmarks.hands.real_take CAPTURE [--sheet SHEET.png]`` evaluates a capture of ``hands find`` with
its footage. For each side, it prints the share of frames with the hand detected in two views, among all frames and
among those with the hand visible in two views. A hand is visible if it is inside the picture and at least half of it is
not hidden. The program also prints the steps of the middle joints, and the distance in pixels between the solved hand
and the detections.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.body.hand_skeleton import FINGER_OF, JOINT_OF, KIND_OF
from solver_backend.body.hands import by_finger, hand_of_shape, load_body_with_hands
from solver_backend.cameras.projection import project
from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.exchange.joint_sets import SIDES
from solver_backend.fitters.pipeline import solve
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.load import load_capture
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.studio.person_hands import hidden_points, points_of_hands
from solver_backend.types import Capture, Motion
from tests.benchmarks.hands.hand_sheet import draw_sheet

MIDDLE = np.flatnonzero((FINGER_OF > 0) & (KIND_OF == 0) & (JOINT_OF == 1))
"""Angles of the four fingers' middle joints."""
SEEN_SHARE = 0.5  # Smallest unhidden share of a visible hand.


@dataclass(frozen=True)
class SolvedTake:
    """Both hands as solved, left first."""

    angles: np.ndarray  # (F, 2, A) angles in radians.
    px: np.ndarray  # (C, F, 2, 21, 2) projected points.
    can_see: np.ndarray  # (C, F, 2) mask of visible hands.


def solved_take(capture: Capture, motion: Motion) -> SolvedTake:
    """Return a motion's hands in the cameras of its capture."""
    assert capture.cameras is not None
    cameras, body = capture.cameras, load_body_with_hands()
    turns = exp_so3(motion.body_pose.reshape(motion.num_frames, -1, 3))
    person = Person(body, motion.betas, exp_so3(motion.global_orient), turns, motion.transl)
    size, angles = motion.provenance["hands"]["size"], []
    skeletons = hand_of_shape(body, motion.betas, 0).scaled(size), hand_of_shape(body, motion.betas, 1).scaled(size)
    for side, name in enumerate(SIDES):
        columns = np.array(SMPL_HANDS.group(f"{name}_hand")) - 1
        angles.append(skeletons[side].angles_of(by_finger(turns[:, columns])))
    both = np.stack(angles, axis=1)
    points = points_of_hands(person, skeletons, both)
    px = project(cameras, points)
    inside = ((px >= 0) & (px < cameras.image_size[:, None, None, None])).all(axis=(-1, -2))
    hidden = hidden_points(person, cameras, points).mean(axis=-1)
    return SolvedTake(both, px, inside & (hidden <= 1.0 - SEEN_SHARE))


def figures_of(capture: Capture, take: SolvedTake) -> list[str]:
    """Return a line of text for each side."""
    assert capture.keypoints is not None and capture.keypoints.hands is not None
    hands, lines = capture.keypoints.hands, list[str]()
    for side, name in enumerate(SIDES):
        seen = hands[:, :, side, :, 2] > 0
        found, can = seen.any(-1).sum(0) >= 2, take.can_see[:, :, side].sum(0) >= 2
        error = np.linalg.norm(take.px[:, :, side] - hands[:, :, side, :, :2], axis=-1)
        steps = np.abs(np.diff(np.rad2deg(take.angles[:, side, MIDDLE]), axis=0))
        by_view = [f"{np.median(error[view][seen[view]]):.1f}" for view in range(len(error))]
        lines.append(
            f"{name}: found in two views in {100 * found.mean():.0f} % of all frames and in "
            f"{100 * found[can].mean():.0f} % of the {can.sum()} in which two can see it; middle joints "
            f"{steps.mean():.2f}° a frame; {np.median(error[seen]):.1f} px from the detections "
            f"(by view {', '.join(by_view)}; nine tenths below {np.percentile(error[seen], 90):.1f})"
        )
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Solve a capture, print its figures and draw the sheet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--sheet", type=Path, help="where the contact sheet goes")
    args = parser.parse_args(arguments)
    capture = load_capture(args.capture)
    take = solved_take(capture, solve(capture).motion)
    sys.stdout.write("\n".join(figures_of(capture, take)) + "\n")
    if args.sheet is not None:
        draw_sheet(capture, take.px, args.sheet)
    return 0


if __name__ == "__main__":
    sys.exit(main())
