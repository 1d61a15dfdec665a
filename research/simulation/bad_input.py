"""Add faults to captures, for example a bumped camera or a passer-by.

Each function returns a new capture. Its ground truth contains the faulty view as ``bad_view``, and the faulty frames as
``bad_frames`` (first, one past the last).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from research.simulation.benchmark import JOINT_SET
from research.simulation.filming import FilmSettings, film
from solver_backend.agreement.person_selection import select_people
from solver_backend.cameras.projection import distort, undistort
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.faults import MEASURED_DETECTOR
from solver_backend.synthesis.simulation.cast import Person, Take, cast_person
from solver_backend.synthesis.simulation.keypoint_detector import DetectorOutput
from solver_backend.types import Cameras, Capture, Detections, Keypoints2D

WALK_M_S = 1.4  # Walking speed of a passer-by.


def bumped(capture: Capture, view: int, degrees: float = 5.0, first: int = 0) -> Capture:
    """Rotate a camera from a frame on, as if it was bumped. Only its detections change."""
    cameras, keypoints = capture.require_multiview()
    turn = exp_so3(np.radians(degrees) * np.array([0.6, 0.8, 0.0]))
    one = cameras.subset([view])
    flat = undistort(one, keypoints.xy[view : view + 1, first:])[0]
    ray = np.concatenate([flat, np.ones_like(flat[..., :1])], axis=-1) @ turn.T
    seen = (ray[..., :2] / ray[..., 2:]).reshape(1, -1, 2)
    px = distort(seen, one.distortion, one.models)[0] @ one.K[0, :2, :2].T + one.K[0, :2, 2]
    xy = keypoints.xy.copy()
    xy[view, first:] = px.reshape(xy[view, first:].shape)
    return _with(capture, _inside(xy, keypoints, cameras), view, (first, keypoints.num_frames))


def calibrations_exchanged(capture: Capture, first: int, second: int) -> Capture:
    """Swap the calibrations of two cameras, as if their names were mixed up."""
    cameras, keypoints = capture.require_multiview()
    order = list(range(len(cameras)))
    order[first], order[second] = second, first
    mixed = replace(cameras.subset(order), names=cameras.names)
    wrong = _with(capture, keypoints, first, (0, keypoints.num_frames))
    return replace(wrong, cameras=mixed, truth=wrong.truth | {"bad_view": np.array([first, second])})


def unsynchronised(capture: Capture, view: int, frames: int = 12) -> Capture:
    """Delay one camera by whole frames. Frames before its start have no detections."""
    _, keypoints = capture.require_multiview()
    xy = keypoints.xy.copy()
    xy[view] = np.nan
    late = slice(max(frames, 0), xy.shape[1] + min(frames, 0))
    early = slice(max(-frames, 0), xy.shape[1] - max(frames, 0))
    xy[view, late] = keypoints.xy[view, early]
    confidence = keypoints.confidence.copy()
    confidence[view] = 0.0
    confidence[view, late] = keypoints.confidence[view, early]
    wrong = _with(capture, replace(keypoints, xy=xy, confidence=confidence), view, (0, keypoints.num_frames))
    delays = capture.truth.get("delay_frames", np.zeros(len(xy))) + frames * (np.arange(len(xy)) == view)
    return replace(wrong, truth=wrong.truth | {"delay_frames": delays})


def mirrored(capture: Capture, view: int) -> Capture:
    """Mirror a camera's image, as some webcams do. The detector therefore also swaps left and right."""
    cameras, keypoints = capture.require_multiview()
    sides = list(keypoints.joint_set.mirrored())
    xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
    xy[view], confidence[view] = xy[view][:, sides], confidence[view][:, sides]
    xy[view, ..., 0] = cameras.image_size[view, 0] - 1 - xy[view, ..., 0]
    return _with(capture, replace(keypoints, xy=xy, confidence=confidence), view, (0, keypoints.num_frames))


def sides_exchanged(capture: Capture, view: int) -> Capture:
    """Swap left and right detections in one view over the whole take."""
    _, keypoints = capture.require_multiview()
    sides = list(keypoints.joint_set.mirrored())
    xy, confidence = keypoints.xy.copy(), keypoints.confidence.copy()
    xy[view], confidence[view] = xy[view][:, sides], confidence[view][:, sides]
    return _with(capture, replace(keypoints, xy=xy, confidence=confidence), view, (0, keypoints.num_frames))


def away(capture: Capture, first: int, seconds: float = 3.0) -> Capture:
    """Let the person leave the capture volume and return, visible in fewer views on the way."""
    _, keypoints = capture.require_multiview()
    last = min(first + round(seconds * keypoints.fps), keypoints.num_frames)
    edge = max(1, round(0.1 * keypoints.fps))
    xy = keypoints.xy.copy()
    for view in range(len(xy)):
        late, early = min(view * edge, (last - first) // 3), min((len(xy) - 1 - view) * edge, (last - first) // 3)
        xy[view, max(0, first - late) : last + early] = np.nan
    return _with(capture, replace(keypoints, xy=xy), -1, (first, last))


def with_passerby(
    capture: Capture,
    take: Take,
    seed: int = 1,
    *,
    single_person_detector: bool = False,
    clearance_m: float = 0.7,
    reach_m: float = 2.5,
) -> tuple[Capture, Detections]:
    """Let a second person pass the first at a distance of ``clearance_m``, detected within ``reach_m``.

    Returns:
        The capture, and the detections of both people in every view and frame, in random order. The capture shows the
        person that the program selects or, with ``single_person_detector``, the person who looks larger.
    """
    cameras, keypoints = capture.require_multiview()
    rng = np.random.default_rng(seed)
    true = replace(cameras, R=capture.truth["R"], t=capture.truth["t"])
    walker, away_m = _across(cast_person(take, rng), capture.truth["joints"][:, 0], clearance_m, keypoints.fps)
    there = away_m < reach_m
    found = film(walker, true, FilmSettings(JOINT_SET, keypoints.fps, MEASURED_DETECTOR), rng)
    found = replace(
        found,
        xy=np.where(there[:, None, None], found.xy, np.nan),
        confidence=np.where(there[:, None], found.confidence, 0.0),
    )
    both = _both(keypoints, found, cameras.names, rng)
    if single_person_detector:
        larger = _height(found.xy) > _height(keypoints.xy)
        xy = np.where(larger[..., None, None], found.xy, keypoints.xy)
        chosen = replace(
            keypoints, xy=xy, confidence=np.where(larger[..., None], found.confidence, keypoints.confidence)
        )
        notes = capture.notes
    else:
        selected = select_people(cameras, both, keypoints.fps)[0]
        larger = np.zeros(keypoints.xy.shape[:2], dtype=bool)
        chosen, notes = selected.keypoints, (*capture.notes, *selected.notes)
    first, last = np.flatnonzero(there)[[0, -1]]
    wrong = replace(_with(capture, chosen, -1, (int(first), int(last) + 1)), notes=notes)
    return replace(wrong, truth=wrong.truth | {"other_person": larger}), both


def _across(person: Person, pelvis: np.ndarray, clearance_m: float, fps: float) -> tuple[Person, np.ndarray]:
    """Let a person walk past ``pelvis`` (F, 3). Return the person and the distances (F,) in metres."""
    frames = np.arange(len(pelvis))
    way = WALK_M_S * (frames - len(pelvis) // 2) / fps
    cycle = frames % len(person.transl)
    goal = pelvis[len(pelvis) // 2] + [clearance_m, 0.0, 0.0]
    transl = person.transl[cycle].copy()
    transl[:, :2] = goal[:2] + way[:, None] * [0.0, 1.0]
    return replace(person, orient=person.orient[cycle], local=person.local[cycle], transl=transl), np.abs(way)


def _both(
    keypoints: Keypoints2D, other: DetectorOutput, names: tuple[str, ...], rng: np.random.Generator
) -> Detections:
    xy = np.stack([keypoints.xy, other.xy], axis=2)
    confidence = np.stack([keypoints.confidence, other.confidence], axis=2)
    first = rng.integers(2, size=xy.shape[:2])
    order = np.stack([first, 1 - first], axis=2)
    xy = np.take_along_axis(xy, order[..., None, None], axis=2)
    confidence = np.take_along_axis(confidence, order[..., None], axis=2)
    return Detections(names, xy.astype(np.float32), confidence.astype(np.float32), keypoints.joint_set)


def _height(xy: np.ndarray) -> np.ndarray:
    """Return the (C, F) height of a person's detections in pixels, or 0 without detections."""
    y = xy[..., 1]
    seen = np.isfinite(y)
    high, low = np.where(seen, y, -np.inf).max(-1), np.where(seen, y, np.inf).min(-1)
    return np.where(seen.any(-1), high - low, 0.0)


def _inside(xy: np.ndarray, keypoints: Keypoints2D, cameras: Cameras) -> Keypoints2D:
    size = cameras.image_size[:, None, None]
    seen = ((xy >= 0) & (xy < size)).all(-1)
    return replace(keypoints, xy=np.where(seen[..., None], xy, np.nan))


def _with(capture: Capture, keypoints: Keypoints2D, view: int, frames: tuple[int, int]) -> Capture:
    truth = capture.truth | {"bad_view": np.array([view] if view >= 0 else []), "bad_frames": np.array(frames)}
    return replace(capture, keypoints=keypoints, truth=truth)
