"""Estimate gravity from a person alone, on recorded motion: the error, and whether it is stated correctly.

Segments of 1.7, 4 and 10 s from CMU takes of a standing person (walks, dance, exercises, fights), each with a random
shape as BODY_25, with 8 mm of bias and 8 mm of noise per keypoint and axis. ``told`` is the share of segments with an
angle below 1.73 times the stated deviation, which is 95 % for normal errors on both axes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from research.simulation.benchmark import JOINT_SET
from solver_backend.io.recognition.gravity import upright_from_person
from solver_backend.synthesis.simulation.cast import cast_person
from tests.benchmarks.comparison.validation_takes import read_take
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.recordings import ABSENT, recordings_folder

SECONDS = (1.7, 4.0, 10.0)
TAKES_A_SUBJECT, TAKES, PIECES = 2, 30, 3
HEELS_OVER_HEAD = {"43", "140"}
"""Subjects who turn cartwheels or get up from lying. People who never stand do not determine gravity."""
FPS = 30.0
BIAS_M, NOISE_M = 0.008, 0.008


def run() -> list[Metric]:
    """Measure all segments."""
    walked = takes()
    metrics = []
    for seconds in SECONDS:
        off, said = np.array([told for points in walked for told in _pieces(points, seconds)]).T
        metrics += [
            Metric(f"median_{seconds:g}s", float(np.median(off)), "deg", abs_tol=0.2),
            Metric(f"rms_{seconds:g}s", float(np.sqrt((off**2).mean())), "deg", abs_tol=0.3),
            Metric(f"told_{seconds:g}s", float((off < 1.73 * said).mean()), "", "higher", abs_tol=0.02),
        ]
    return metrics


def takes() -> list[np.ndarray]:
    """Return the (F, K, 3) true keypoints of the takes in metres, Z up.

    Raises:
        BenchmarkSkipped: the motions are missing.
    """
    rng, count, found = np.random.default_rng(0), dict[str, int](), []
    for path in sorted((recordings_folder() / "motion_cmu" / "mb2").glob("*.npz")):
        subject = path.stem.split("_")[0]
        if subject in HEELS_OVER_HEAD or count.get(subject, 0) >= TAKES_A_SUBJECT or len(found) >= TAKES:
            continue
        take = read_take(path, 1500, 60)  # after the T-pose
        step = max(1, round(take.fps / FPS))
        take = replace(take, rotations=take.rotations[::step], root=take.root[::step], fps=take.fps / step)
        if len(take.rotations) > SECONDS[0] * FPS:
            count[subject] = count.get(subject, 0) + 1
            found.append(cast_person(take, rng).landmarks(JOINT_SET).points)
    if not found:
        raise BenchmarkSkipped("The motions are not here.", hint=ABSENT)
    return found


def _pieces(points: np.ndarray, seconds: float) -> list[tuple[float, float]]:
    """Return the angle error and the stated deviation in degrees for segments distributed over a take."""
    rng, length = np.random.default_rng(len(points)), int(seconds * FPS)
    starts = np.unique(np.linspace(0, len(points) - length, PIECES).astype(int)) if len(points) >= length else []
    found = []
    for start in starts:
        piece = points[start : start + length]
        bias = BIAS_M * rng.normal(size=piece.shape[1:])
        told = upright_from_person(piece + bias + NOISE_M * rng.normal(size=piece.shape), JOINT_SET, FPS)
        found.append((np.degrees(np.arccos(np.clip(told.R[2, 2], -1.0, 1.0))), np.degrees(told.tilt_sigma)))
    return found
