"""Predict a camera array's keypoint triangulation error at every position on the floor."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import Landmarks
from solver_backend.cameras.projection import project
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.progress import Progress, silent
from solver_backend.synthesis.faults import Faults
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.simulation.keypoint_detector import (
    Sight,
    detect_keypoints,
    direction_seen_from,
    miscalibrated,
    px_per_mm,
)
from solver_backend.synthesis.studio.camera_arrays import CameraRing, aim_point
from solver_backend.synthesis.studio.motions import MotionSource
from solver_backend.synthesis.studio.sight import BodySight, sight_lines
from solver_backend.synthesis.studio.stage import seeded
from solver_backend.types import Cameras, JointSet

_POSES, _DRAWS = 5, 8  # Number of poses per position, and of simulated detections per pose.
_FPS = 30.0  # Frame rate of the simulated person in 1/s. Chosen by hand.
_SET = JointSet.BODY_25


@dataclass(frozen=True)
class PlaceErrors:
    """A camera array's errors on a floor grid of Y rows and X columns."""

    array: str
    x_m: np.ndarray  # (X,) positions in metres.
    y_m: np.ndarray  # (Y,) positions in metres.
    error_mm: np.ndarray  # (Y, X) RMS distance from triangulated keypoints to the truth. NaN if most are not found.
    views: np.ndarray  # (Y, X) mean number of cameras that see a keypoint.
    cameras: np.ndarray  # (C, 3) camera positions in metres.

    @property
    def median_mm(self) -> float | None:
        """Median error over all positions with triangulated keypoints, or None if there are no such positions."""
        return float(np.nanmedian(self.error_mm)) if np.isfinite(self.error_mm).any() else None


def place_errors(
    array: CameraRing,
    faults: Faults,
    half_m: float = 2.0,
    step_m: float = 0.5,
    seed: int = 0,
    progress: Progress = silent,
) -> PlaceErrors:
    """Predict the error of a camera array over a square floor with sides of ``2 half_m``.

    At each position, a person takes several poses from the demo motion. A simulated detector observes each pose several
    times. Keypoints detected by at least two cameras are triangulated as in a solve.
    """
    body, betas = load_body(), np.zeros(10)
    person = MotionSource("choreography", None).play(body, betas, _FPS, 180)
    still = person.part(np.linspace(0, len(person.transl) - 1, _POSES).round().astype(int))
    middle = still.landmarks(JointSet.SMPL_24).points[:, 0] * [1.0, 1.0, 0.0]
    still = replace(still, transl=still.transl - middle)
    points = still.landmarks(_SET).points
    sight = BodySight(body, betas, _keypoints(body))
    posed = sight.proxy.posed(still)
    true = array.around(np.zeros(3))
    centre = aim_point(true)[:2] if array.fixed else np.zeros(2)
    rng = seeded(seed, array.name, "places")
    room, off_mm = np.array([*centre, 0.95]), faults.cameras.calibration_mm
    known = miscalibrated(true, room, off_mm, rng) if off_mm and len(true) > 1 else true
    ticks = np.arange(-half_m, half_m + 1e-9, step_m)
    moves = np.array([[centre[0] + x, centre[1] + y, 0.0] for y in ticks.tolist() for x in ticks.tolist()])
    looked, stage = [], f"camera array {array.name}"
    for i, move in enumerate(moves):
        centres = true.centres - move  # relative to the person
        hidden = sight.hidden(centres, sight_lines(centres, points), points, posed).swapaxes(0, 1)
        looked.append(_look(true, still, points + move, hidden, faults, rng))
        progress(stage, i + 1, len(moves) + 1)
    shape = len(ticks), len(ticks)
    xy, confidence = (np.concatenate(found, axis=1) for found in zip(*looked, strict=True))
    views = (confidence > 0).sum(axis=0).reshape(*shape, -1).mean(axis=2)
    error = np.full(shape, np.nan)
    if len(true) > 1:
        # Estimate the detector's errors from all positions together, as if they were one take.
        located = triangulate(known, xy, confidence).points
        truth = np.concatenate([np.tile(points + move, (_DRAWS, 1, 1)) for move in moves])
        off = np.linalg.norm(located - truth, axis=-1).reshape(*shape, -1)
        good = np.isfinite(off)
        mean = np.where(good, off**2, 0).sum(axis=2) / np.maximum(good.sum(axis=2), 1)
        error = np.where(good.mean(axis=2) > 0.5, 1e3 * np.sqrt(mean), np.nan)
    progress(stage, len(moves) + 1, len(moves) + 1)
    return PlaceErrors(array.name, centre[0] + ticks, centre[1] + ticks, error, views, true.centres)


@lru_cache(maxsize=8)
def _keypoints(body: Body) -> Landmarks:
    """Return a body's keypoints. Repeated calls return the same object, because cached sight tables depend on it."""
    return keypoint_landmarks(body, _SET)


def _look(
    true: Cameras, person: Person, points: np.ndarray, hidden: np.ndarray, faults: Faults, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Simulate ``_DRAWS`` detections of each pose: (C, F, K, 2) pixels and (C, F, K) confidences.

    Along F, the poses are repeated ``_DRAWS`` times.
    """
    px = project(true, points)
    with np.errstate(invalid="ignore"):
        inside = ((px >= 0) & (px < true.image_size[:, None, None])).all(-1)
    direction = direction_seen_from(true, person.orient, points[:, 0])
    # Observations are independent: each has its own drift. No limbs are swapped.
    detector = replace(faults.detector, swaps_per_minute=0.0, drift_s=1e-3)
    seen = (np.where(inside[..., None], px, -1e6), px_per_mm(true, points), direction, hidden)
    px, scale, way, behind = (np.tile(part, (1, _DRAWS, *[1] * (part.ndim - 2))) for part in seen)
    found = detect_keypoints(Sight(px, scale, way, behind, true.image_size), _SET, _FPS, detector, rng)
    return found.xy, found.confidence


def places_text(places: Sequence[PlaceErrors]) -> str:
    """Return the error maps as JSON, with null at positions without triangulated keypoints."""
    maps = []
    for p in places:
        values = {"camera_array": p.array, "x_m": p.x_m.tolist(), "y_m": p.y_m.tolist(), "cameras": p.cameras.tolist()}
        values |= {"views": p.views.tolist(), "median_mm": p.median_mm}
        error = [[round(v, 3) if v == v else None for v in row] for row in p.error_mm.tolist()]
        maps.append(values | {"error_mm": error})
    return json.dumps({"format": "manifold_mocap_places", "version": 1, "places": maps}, allow_nan=False) + "\n"
