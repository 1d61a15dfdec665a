"""One calibrated camera on people of 1.45 to 2.05 m at five camera heights: simulated, with a known floor.

Two sets of seven people on held-out motion on a level floor, with a simulated detector of 25 and 17 keypoints in turn.
``world`` is the mean distance of 12 limb joints in the world, ``pa`` after the best similarity of each frame,
``turns_inside_95`` the share of segments with their rotation inside its 95 % ellipsoid, ``stature`` the mean error of
the stature, ``soles_within_10mm`` the share of standing frames with the lowest point of the foot within 10 mm of its
true height, and ``stance_speed`` the median speed of standing feet over the floor. ``class_`` marks figures of Indian
dances, a class of motion that no network was trained on.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.synthesis.simulation.cast import cast_person
from solver_backend.types import JointSet
from tests.benchmarks.metric import Metric
from tests.benchmarks.one_view_takes import ON_LEVEL_FLOOR, UNSEEN_CLASS, short_take
from tests.support.one_view_people import PersonTake, betas_of_stature, figures, filmed
from tests.support.standing_people import grounded

STATURES_M = (1.45, 1.55, 1.65, 1.75, 1.85, 1.95, 2.05)
CAMERA_HEIGHTS_M = (0.6, 1.0, 1.5, 2.1, 2.8)
JOINT_SETS = (JointSet.BODY_25, JointSet.COCO_17)
HIGHER = ("inside_95", "turns_inside_95", "soles_within_10mm")
UNITS = {"inside_95": "%", "turns_inside_95": "%", "stature": "%", "soles_within_10mm": "%", "stance_speed": "m/s"}


def run() -> list[Metric]:
    """Solve every take."""
    subjects = [figures(take) for seed in range(2) for take in people_takes(ON_LEVEL_FLOOR, seed)]
    return [*_metrics("", subjects), *_metrics("class_", [figures(take) for take in people_takes(UNSEEN_CLASS, 2)])]


def _metrics(prefix: str, rows: list[dict[str, float]]) -> list[Metric]:
    means = {key: float(np.nanmean([row[key] for row in rows])) for key in rows[0]}
    return [
        Metric(prefix + key, value, UNITS.get(key, "mm"), "higher" if key in HIGHER else "lower")
        for key, value in means.items()
    ]


def people_takes(clips: tuple[tuple[str, str, int], ...], seed: int = 0) -> Iterator[PersonTake]:
    """Yield one take for each stature, alternating clips, camera heights and joint sets.

    Raises:
        BenchmarkSkipped: the motions are missing.
    """
    body = load_body()
    for number, stature in enumerate(STATURES_M):
        subject, file, start = clips[number % len(clips)]
        take = short_take(file, start)
        rng = np.random.default_rng(100 * seed + number)
        person = cast_person(take, rng, body, betas=betas_of_stature(body, rng, stature))
        person = grounded(person, take.fps)
        height, joint_set = CAMERA_HEIGHTS_M[number % 5], JOINT_SETS[number % 2]
        yield filmed(f"{subject}_{stature:.2f}m_at_{height}m", person, take.fps, height, joint_set, rng)
