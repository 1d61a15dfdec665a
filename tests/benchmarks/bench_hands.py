"""Hands with a solved body: four studio views, palms of 40 px, and detector errors relative to the palm.

The figures are fingertip errors in the world, flexion errors of knuckles and middle joints, and the share of finger
joints in their 95 % ellipsoids, over frames in which at least two views show a hand. Others are the shares of detected
hands with the right side, and of frames in which fingers intersect by more than 6 mm. The CPU time of a solve without
hands is also measured. Real finger exercises (Ganguly et al. 2021), every sixth recording: flexion of the solved hand's
markers relative to the recorded markers, from 26 and from 10 markers. They need the recordings next to the repository.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np

from solver_backend.fitters.pipeline import solve
from tests.benchmarks.hands.marker_exercises import exercise_errors
from tests.benchmarks.hands.studio_takes import draw_take, errors_of, sides_right
from tests.benchmarks.metric import Metric
from tests.support.recordings import recordings_folder

SEEDS, FRAMES, FPS = (11, 12, 13, 14), 150, 30.0
RADIUS_M = 3.2
EVERY = 6


def run() -> list[Metric]:
    """Solve the takes with and without hands, print a table, and return the figures."""
    found, lines, spent, sides = [], [], np.zeros(2), np.zeros(2, int)
    for seed in SEEDS:
        take = draw_take(seed, FRAMES, FPS, RADIUS_M)
        assert take.capture.keypoints is not None
        bare = replace(take.capture, keypoints=replace(take.capture.keypoints, hands=None))
        for which, capture in enumerate((bare, take.capture)):
            began = time.process_time()
            motion = solve(capture).motion
            spent[which] += time.process_time() - began
        errors = errors_of(take, motion)
        found.append(errors)
        sides += sides_right(take, motion)
        lines.append(
            f"  {seed}: palm {take.palm_px:.0f} px, seen {100 * errors.seen:.0f} %, tips {_rms(errors.tips_mm):.1f} mm "
            f"(of the hand itself {_rms(errors.own_tips_mm):.1f}), flexion {_rms(errors.angles_deg):.1f}°, "
            f"wrist {_rms(errors.wrists_mm):.1f} mm, in ellipsoids {100 * errors.held.mean():.0f} %"
        )
    sys.stdout.write("\n".join(lines) + "\n")

    def all_of(name: str) -> np.ndarray:
        return np.concatenate([getattr(errors, name).ravel() for errors in found])

    return [
        *_exercises(),
        Metric("fingertips_rms_mm", _rms(all_of("tips_mm")), "mm"),
        Metric("fingertips_mean_mm", float(all_of("tips_mm").mean()), "mm"),
        Metric("flexion_rms_deg", _rms(all_of("angles_deg")), "deg"),
        Metric("wrists_rms_mm", _rms(all_of("wrists_mm")), "mm"),
        Metric("in_ellipsoids_percent", 100.0 * float(all_of("held").mean()), "%", "higher"),
        Metric("sides_right_percent", 100.0 * float(sides[0] / sides[1]), "%", "higher"),
        Metric("fingers_through_percent", 100.0 * float((all_of("overlap_mm") > 6.0).mean()), "%"),
        Metric("times_the_body_alone", float(spent[1] / spent[0]), "", rel_tol=0.2),
    ]


def _exercises() -> list[Metric]:
    """Return the figures of real hands, or none if they are missing."""
    paths = sorted((recordings_folder() / "hands" / "leap").glob("*.npz"))[::EVERY]
    figures = []
    for layout in ("hand26", "hand10") if paths else ():
        alike, joints = zip(*(exercise_errors(path, layout) for path in paths), strict=True)
        both = [_rms(np.concatenate([e[np.isfinite(e).all(1)] for e in errors])) for errors in (alike, joints)]
        sys.stdout.write(f"  {layout}: flexion {both[0]:.1f}° of its markers, {both[1]:.1f}° of its joints\n")
        figures.append(Metric(f"{layout}_flexion_rms_deg", both[0], "deg"))
    return figures


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))
