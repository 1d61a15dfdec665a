"""Two people who dance with each other, simulated: salsa pairs of CMU 60 and 61 on bodies of random shape.

Four cameras see both dancers, with a simulated detector. ``true_depth`` is the 95th percentile over frames of the
deepest skin point of one body in the other, ``alone`` that of two separate solves, and ``solved`` that of a second
solve of each dancer against the other, as in ``solve --person all``. ``joints`` is the mean error of both dancers.
Windows of 150 frames have the most frames with skins closer than 20 mm, if their true depth is at most 10 mm. Pairs 3
and 4 were used for tuning.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from research.simulation.benchmark import JOINT_SET, BenchmarkSettings
from research.simulation.filming import FilmSettings, around, film
from solver_backend.body.body import load_body
from solver_backend.fitters.other_skin import REACH_M, OtherSkin, only_close, spread_vertices
from solver_backend.fitters.pipeline import solve
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.synthesis.simulation.cast import UPRIGHT, Person, cast_person
from solver_backend.synthesis.simulation.keypoint_detector import miscalibrated
from solver_backend.types import Capture, Keypoints2D, Motion
from tests.benchmarks.comparison.validation_takes import read_take
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.recordings import ABSENT, recordings_folder

PAIRS = 1, 5, 6, 7, 9, 11, 13, 14
PARTNER, FRAMES, STEP = 15, 150, 50  # Number of the partner's clip less the dancer's, frames of a window, and its step.
TOUCH_MM, DEPTH_MM = 20.0, 10.0  # Distance of skins that touch, and largest true depth of a window.


def run() -> list[Metric]:
    """Solve a window of every pair."""
    folder = recordings_folder() / "motion_cmu" / "daz"
    if not folder.is_dir():
        raise BenchmarkSkipped(ABSENT)
    rows = list[tuple[float, ...]]()
    for number in PAIRS:
        takes = [read_take(folder / f"salsa_{number + part:02d}.npz") for part in (0, PARTNER)]
        dancers, fps = cast_together(takes, number), takes[0].fps
        depth = depths_mm(dancers)
        starts = np.arange(0, len(depth) - FRAMES, STEP)
        windows = [depth[start : start + FRAMES] for start in starts]
        good = [
            (np.mean(w > -TOUCH_MM), start) for w, start in zip(windows, starts, strict=True) if deep(w) <= DEPTH_MM
        ]
        if not good:
            continue
        part = slice(first := int(max(good)[1]), first + FRAMES)
        dancers = [dancer.part(part) for dancer in dancers]
        captures = film_together(dancers, fps, number)
        alone = [solve(capture).motion for capture in captures]
        both = [
            solve(capture, others=[other] if other else []).motion
            for capture, other in zip(captures, [only_close(*alone), only_close(*alone[::-1])], strict=True)
        ]
        errors = [joints_mm(motions, captures) for motions in (alone, both)]
        found = [
            depths_mm([person_of(m, d) for m, d in zip(motions, dancers, strict=True)]) for motions in (alone, both)
        ]
        rows.append((deep(depth[part]), *map(deep, found), *map(max, found), *errors))
        sys.stdout.write(f"  {number}, {first}: " + ", ".join(f"{value:.1f}" for value in rows[-1]) + "\n")
        sys.stdout.flush()
    means = np.mean(rows, axis=0)
    names = (
        "true_depth",
        "alone_depth",
        "solved_depth",
        "alone_deepest",
        "solved_deepest",
        "alone_joints",
        "solved_joints",
    )
    share = 100 * np.mean([row[2] <= DEPTH_MM for row in rows])
    metrics = [Metric(name, float(value), "mm", abs_tol=2.0) for name, value in zip(names, means, strict=True)]
    return [*metrics, Metric("windows_within_10_mm", float(share), "%", "higher", abs_tol=13.0)]


def deep(depth: np.ndarray) -> float:
    """Return the 95th percentile of depths, at least 0."""
    return max(float(np.percentile(depth, 95)), 0.0)


def cast_together(takes: list, seed: int) -> list[Person]:
    """Return both dancers at their recorded places, with one scale for both ways."""
    rng = np.random.default_rng(seed)
    people = [cast_person(take, rng) for take in takes]
    legs = [float(np.ptp(p.body.rest_joints(p.betas)[[0, 7], 1])) for p in people]
    recorded = [float(np.percentile(take.root[:, 1], 90)) for take in takes]
    scale = (sum(legs) + 2 * 0.08) / sum(recorded)
    centre = takes[0].root[0]
    placed = list[Person]()
    for take, person in zip(takes, people, strict=True):
        way = scale * (take.root - centre) @ UPRIGHT.T - person.body.rest_joints(person.betas)[0]
        placed.append(replace(person, transl=np.stack([way[:, 0], way[:, 1], person.transl[:, 2]], axis=-1)))
    return placed


def film_together(people: list[Person], fps: float, seed: int) -> list[Capture]:
    """Return a capture of each dancer by the same cameras."""
    settings, rng = BenchmarkSettings(seed=seed), np.random.default_rng(1000 + seed)
    joints = [person.landmarks(JOINT_SET).skeleton.joints for person in people]
    middle = np.mean([j[:, 0] for j in joints], axis=0)
    cameras = around(middle, settings.num_views)
    calibrated = miscalibrated(cameras, middle.mean(axis=0), settings.calibration_mm, rng)
    captures = list[Capture]()
    for number, person in enumerate(people):
        offsets = 1e-3 * settings.anatomy_mm * rng.normal(size=(JOINT_SET.num_keypoints, 3))
        found = film(person, cameras, FilmSettings(JOINT_SET, fps, settings.detector, offsets, np.zeros(4)), rng)
        keypoints = Keypoints2D(found.xy, found.confidence, JOINT_SET, fps)
        truth = {"joints": joints[number]}
        captures.append(Capture(f"dancer {number}", cameras=calibrated, keypoints=keypoints, truth=truth))
    return captures


def person_of(motion: Motion, like: Person) -> Person:
    """Return a solved motion as a person."""
    turns = exp_so3(motion.body_pose.reshape(motion.num_frames, -1, 3)[:, :21].astype(np.float64))
    orient = exp_so3(motion.global_orient.astype(np.float64))
    return Person(like.body, motion.betas.astype(np.float64), orient, turns, motion.transl.astype(np.float64))


def joints_mm(motions: list[Motion], captures: list[Capture]) -> float:
    """Return the mean joint error of both dancers."""
    errors = [m.joints[:, :22] - c.truth["joints"][:, :22] for m, c in zip(motions, captures, strict=True)]
    return 1000 * float(np.linalg.norm(errors, axis=-1).mean())


def depths_mm(people: list[Person]) -> np.ndarray:
    """Return (F,) depths of the first body's deepest skin point in the other body, negative outside."""
    body, frames = load_body(), np.arange(len(people[0].transl))
    one, other = people
    pose = np.pad(log_so3(other.local).reshape(len(frames), -1), ((0, 0), (0, 6)))
    joints = other.landmarks(JOINT_SET).skeleton.joints
    motion = Motion(other.betas, log_so3(other.orient), pose, other.transl, 30.0, body.id, joints)
    skin = OtherSkin.of(body, [motion])
    vertices, depth = spread_vertices(body), np.empty(len(frames))
    for first in range(0, len(frames), 64):
        part = frames[first : first + 64]
        depth[part] = -1000 * skin.nearest(one.skin(part)[:, vertices], part)[0].min(axis=1)
    return np.maximum(depth, -1000 * REACH_M)
