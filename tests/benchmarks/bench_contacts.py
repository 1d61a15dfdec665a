"""Contacts of the whole body, simulated: our body, four cameras and a detector's measured noise at 60 Hz.

``floor_``: hand-keyed clips of people who kneel, fall, roll and crawl (mesh2motion, CC0), placed on the floor z = 0.
``depth_95`` and ``depth_max`` are the 95th percentile and the maximum over frames of the depth of the deepest skin
below the floor. ``slide`` is the mean movement per frame of skin that truly rests, ``joints`` the mean joint error, and
``cpu_ratio`` the processor time relative to a solve with only foot contacts (``bare_``).
``level_deepest`` is the depth of the lowest skin without hands in half of a take's frames, in the worst take without
skin contacts. ``true_shape_`` has the true shape, ``true_contacts_`` the true positions of the resting skin.
``chair_``: two clips of a person on a chair, declared as a box under the seat. ``steps_``: generated steps with exactly
planted feet. ``edges_within_2`` is the share of landings and lift-offs that ``contacts`` marks within 2 frames, and
``false_edges`` the number of others. ``fit_`` marks takes that chose constants. The others are held out: other clips or
frames, bodies and noise, and other gaits.
"""

from __future__ import annotations

import json
import tempfile
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from research.simulation.benchmark import BenchmarkSettings, film_benchmark
from solver_backend.body.mesh import pose_mesh
from solver_backend.exchange.contact_parts import CONTACT_PARTS
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.pipeline import solve
from solver_backend.fitters.skin_contacts import HANDS, SkinContacts, find_skin_contacts, parts_of_skin
from solver_backend.geometry.obstacles import read_obstacles
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.types import Capture, Motion
from tests.benchmarks.kept_parts import kept
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.floor_takes import FITTED, HELD_OUT, FloorTake, keyed_clips, laid_on_floor, planted_steps
from tests.support.recordings import recordings_folder

CLIPS = {
    "fit_floor": (("Death01", slice(0, 150), 1), ("Fixing_Kneeling", slice(0, 150), 2)),
    "floor": (
        ("Fixing_Kneeling", slice(150, 310), 12),
        ("Roll", slice(0, 150), 13),
        ("Swim_Fwd_Loop", slice(0, 150), 16),
    ),
}  # Clip, frames at 60 Hz, and seed of body and noise.
CHAIRS = (("Sitting_Talking_Loop", 21), ("Sitting_Idle_Loop", 22))
SEEDS = {"fit_steps": (FITTED, 10), "steps": (HELD_OUT, 50)}
SEAT, ARMS = list(CONTACT_PARTS).index("seat"), (4, 5, 6, 7)  # Indices of parts.
TOUCH_M, STILL_M_S = 0.005, 0.05  # Largest distance from the floor and largest speed of true contacts.
REACH = 12  # Largest distance in frames between a found edge and the true one.


def filmed(take: FloorTake, seed: int) -> Capture:
    """Return the take as seen by four cameras and a detector."""
    return film_benchmark(take.person, take.fps, take.name, BenchmarkSettings(seed=seed), np.random.default_rng(seed))


def skin_of(motion: Motion, person: Person) -> np.ndarray:
    """Return the (F, V, 3) skin of a motion in metres."""
    turns = motion.body_pose.reshape(motion.num_frames, -1, 3)[:, : person.local.shape[1]].astype(np.float64)
    root, transl = (values.astype(np.float64) for values in (motion.global_orient, motion.transl))
    return pose_mesh(person.body, motion.betas.astype(np.float64), exp_so3(root), exp_so3(turns), transl)


def floor_figures(motion: Motion, take: FloorTake, joints: np.ndarray) -> dict[str, float]:
    """Return depth and slide of the skin and the joint error in millimetres."""
    true, skin = take.person.skin(np.arange(motion.num_frames)), skin_of(motion, take.person)
    depth, touch = np.maximum(-skin[..., 2].min(axis=1), 0.0), resting(true, take.fps)
    way = np.linalg.norm(np.diff(skin[..., :2], axis=0), axis=-1)[touch[1:] & touch[:-1]]
    body = skin[:, ~np.isin(parts_of_skin(take.person.body), HANDS), 2]
    return {
        "depth_95": 1e3 * float(np.percentile(depth, 95)), "depth_max": 1e3 * float(depth.max()),
        "gap": 1e3 * float(np.abs(skin[..., 2].min(axis=1) - true[..., 2].min(axis=1)).mean()),
        "slide": 1e3 * float(way.mean()), "slide_95": 1e3 * float(np.percentile(way, 95)),
        "joints": 1e3 * float(np.linalg.norm(motion.joints - joints, axis=-1).mean()),
        "level": -1e3 * float(np.median(body.min(axis=1))),
    }  # fmt: skip


def resting(skin: np.ndarray, fps: float) -> np.ndarray:
    """Return an (F, V) mask of true skin (F, V, 3) that touches the floor and does not move."""
    way = np.linalg.norm(np.diff(skin, axis=0, prepend=skin[:1]), axis=-1)
    return (skin[..., 2] < TOUCH_M) & (way * fps < STILL_M_S)


def measure_floor(clip: str, frames: slice, seed: int) -> dict[str, float]:
    """Return the figures of a clip with and without skin contacts, and with a part of the truth."""
    take = laid_on_floor(keyed_clips(recordings_folder())[clip], np.random.default_rng(seed), frames)
    capture = filmed(take, seed)
    true = take.person.skin(np.arange(len(take.person.transl)))
    rests = resting(true, take.fps)

    def find_true(*args: Any, **options: Any) -> SkinContacts | None:
        found = find_skin_contacts(*args, **options)
        if found is None:
            return None
        vertices = [int(name.split()[1]) for name in found.landmarks.names[-len(found.parts) :]]
        return replace(found, held=rests[:, vertices], anchors=true[:, vertices])

    found: dict[str, float] = {"true_depth_max": round(1e3 * max(0.0, -float(true[..., 2].min())), 9)}
    known = SolveSettings(betas=tuple(take.person.betas.tolist()))
    for prefix, settings, patch in (
        ("", SolveSettings(), find_skin_contacts), ("bare_", SolveSettings(), lambda *_, **__: None),
        ("true_shape_", known, find_skin_contacts), ("true_contacts_", SolveSettings(), find_true),
    ):  # fmt: skip
        with mock.patch("solver_backend.fitters.recipes.bundle.find_skin_contacts", patch):
            start = time.process_time()
            motion = solve(capture, settings).motion
            figures = floor_figures(motion, take, capture.truth["joints"]) | {"cpu": time.process_time() - start}
        found |= {f"{prefix}{key}": value for key, value in figures.items()}
    return found


def measure_chair(clip: str, frames: slice, seed: int) -> dict[str, float]:
    """Return depth in a declared box under the seat and the joint error, with the box and without.

    The box begins behind the legs, so that the true skin is outside of it.
    """
    take = laid_on_floor(keyed_clips(recordings_folder())[clip], np.random.default_rng(seed), frames)
    true = take.person.skin(np.arange(len(take.person.transl)))
    parts = parts_of_skin(take.person.body)
    seat, legs = true[:, parts == SEAT], true[:, (parts >= 0) & (parts < SEAT) & ~np.isin(parts, ARMS)]
    top, across, front = float(seat[..., 2].min()), float(seat[..., 0].mean()), float(legs[..., 1].max())
    capture, size = filmed(take, seed), [0.5, 0.5, top]
    box = {"centre": [across, front + 0.25, 0.5 * top], "size": size}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "objects.json"
        file.write_text(json.dumps({"boxes": [box]}), encoding="utf-8")
        world = read_obstacles(file)
        found = {"true_depth_max": 1e3 * max(0.0, -float(world.nearest(true[::10], 0.05)[0].min()))}
        for prefix, settings in (("", SolveSettings(objects=str(file))), ("bare_", SolveSettings())):
            motion = solve(capture, settings).motion
            depth = np.maximum(-world.nearest(skin_of(motion, take.person), 0.05)[0].min(axis=1), 0.0)
            error = np.linalg.norm(motion.joints - capture.truth["joints"], axis=-1).mean()
            found[f"{prefix}depth_95"] = 1e3 * float(np.percentile(depth, 95))
            found[f"{prefix}joints"] = 1e3 * float(error)
    return found


def edges_of(stands: np.ndarray) -> list[tuple[int, int]]:
    """Return (frame, +1 or -1) of each landing and lift-off in an (F,) contact mask of a foot."""
    steps = np.diff(stands.astype(int))
    return [(int(frame) + 1, int(steps[frame])) for frame in np.flatnonzero(steps)]


def edge_errors(found: np.ndarray, true: np.ndarray) -> tuple[list[int], int]:
    """Return the signed error of each true edge in frames, ``REACH`` if none is found, and the number of others."""
    errors, false = [], 0
    for foot in range(true.shape[1]):
        left = edges_of(found[:, foot])
        for frame, kind in edges_of(true[:, foot]):
            near = [edge for edge in left if edge[1] == kind and abs(edge[0] - frame) < REACH]
            if near:
                best = min(near, key=lambda edge: abs(edge[0] - frame))
                left.remove(best)
                errors.append(best[0] - frame)
            else:
                errors.append(REACH)
        false += len(left)
    return errors, false


def measure_steps(take: FloorTake, seed: int) -> dict[str, object]:
    """Return the errors of the edges of ``contacts``."""
    motion = solve(filmed(take, seed)).motion
    assert motion.contacts is not None and take.stands is not None
    errors, false = edge_errors(motion.contacts, take.stands)
    right = float((motion.contacts == take.stands).mean())
    return {"errors": errors, "false": false, "right": right}


def run() -> list[Metric]:
    """Solve every take."""
    if not recordings_folder().is_dir():
        raise BenchmarkSkipped("The recorded motions are not here.", hint="Set MOCAP_SHARED_DATA to their folder.")
    metrics = []
    for group, clips in CLIPS.items():
        rows = [
            kept(
                "tests.benchmarks.bench_contacts", f"{group} {clip} {seed}", partial(measure_floor, clip, frames, seed)
            )
            for clip, frames, seed in clips
        ]
        for key in rows[0]:
            if not key.endswith(("cpu", "level")):
                metrics.append(Metric(f"{group}_{key}", float(np.mean([row[key] for row in rows])), "mm"))
        cpu, bare = (sum(row[key] for row in rows) for key in ("cpu", "bare_cpu"))
        metrics.append(Metric(f"{group}_depth_worst", max(row["depth_95"] for row in rows), "mm"))
        metrics.append(Metric(f"{group}_level_deepest", max(row["bare_level"] for row in rows), "mm"))
        metrics.append(Metric(f"{group}_cpu_ratio", cpu / bare, "", abs_tol=0.2))
    chairs = [
        kept("tests.benchmarks.bench_contacts", f"chair {clip}", partial(measure_chair, clip, slice(0, 120), seed))
        for clip, seed in CHAIRS
    ]
    metrics += [Metric(f"chair_{key}", float(np.mean([row[key] for row in chairs])), "mm") for key in chairs[0]]
    for group, (gaits, seed) in SEEDS.items():
        takes = [(planted_steps(gait, seed + k), seed + k) for k, gait in enumerate(gaits)]
        name = "tests.benchmarks.bench_contacts"
        rows = [kept(name, f"{group} {take.name}", partial(measure_steps, take, at)) for take, at in takes]
        errors = np.abs(np.concatenate([row["errors"] for row in rows]))
        metrics += [
            Metric(f"{group}_edges_within_2", 100.0 * float((errors <= 2).mean()), "%", "higher"),
            Metric(f"{group}_edges_90", float(np.percentile(errors, 90)), "frames", abs_tol=1.0),
            Metric(f"{group}_false_edges", float(sum(row["false"] for row in rows)), "", abs_tol=2.0),
            Metric(f"{group}_frames_right", 100.0 * float(np.mean([row["right"] for row in rows])), "%", "higher"),
        ]
    return metrics
