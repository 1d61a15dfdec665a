"""Predict a camera array's error of triangulated keypoints at every place of the floor."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmark_set import Landmarks
from solver_backend.cameras.projection import project
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.progress import Progress, silent
from solver_backend.synthesis.faults import Faults
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.simulation.keypoint_detector import Sight, detect_keypoints, miscalibrated, px_per_mm
from solver_backend.synthesis.studio.camera_arrays import CameraRing, aim_point
from solver_backend.synthesis.studio.motions import MotionSource
from solver_backend.synthesis.studio.sight import BodySight, pose_proxy, sight_lines
from solver_backend.synthesis.studio.stage import seeded
from solver_backend.types import Cameras, JointSet

_POSES, _DRAWS = 5, 8  # Poses a place, and how often a detector looks at each.
_FPS = 30.0  # Frames a second of the person that is placed; chosen by hand.


@dataclass(frozen=True)
class PlaceErrors:
    """Errors over the floor; Y rows, X columns."""

    array: str
    x_m: np.ndarray  # (X,) metres.
    y_m: np.ndarray  # (Y,) metres.
    error_mm: np.ndarray  # (Y, X) RMS distance of triangulated keypoints to the truth; NaN: most not found.
    views: np.ndarray  # (Y, X) mean number of cameras that see a keypoint.
    cameras: np.ndarray  # (C, 3) metres.

    @property
    def median_mm(self) -> float | None:
        """Median over the places where somebody is located, None where nobody is anywhere."""
        return float(np.nanmedian(self.error_mm)) if np.isfinite(self.error_mm).any() else None


def place_errors(
    array: CameraRing, faults: Faults, *, half_m: float = 2.0, step_m: float = 0.5, seed: int = 0,
    joint_set: JointSet = JointSet.BODY_25, progress: Progress = silent,
) -> PlaceErrors:  # fmt: skip
    """Return the error of an array over a square of the floor.

    At each place a person stands in some poses of the choreography; a detector looks at each several times, and what
    two cameras or more see is triangulated as a solve would.

    Args:
        array: the cameras.
        faults: of the detector and the calibration.
        half_m: half the square's side.
        step_m: between places.
        seed: of detector and calibration.
        joint_set: of the keypoints.
        progress: called for every place.
    """
    body, betas = load_body(), np.zeros(10)
    person = MotionSource("choreography", None).play(body, betas, _FPS, 180)
    frames = np.linspace(0, len(person.transl) - 1, _POSES).round().astype(int)
    still = Person(body, betas, person.orient[frames], person.local[frames], person.transl[frames])
    middle = still.landmarks(JointSet.SMPL_24).points[:, 0] * [1.0, 1.0, 0.0]
    still = replace(still, transl=still.transl - middle)
    points = still.landmarks(joint_set).points
    sight = BodySight(body, betas, _keypoints(body, joint_set))
    posed = pose_proxy(sight, still, slice(None))
    true = array.around(np.zeros(3))
    centre = aim_point(true)[:2] if array.fixed else np.zeros(2)
    rng = seeded(seed, array.name, "places")
    room = np.array([*centre, 0.95])
    off_mm = faults.cameras.calibration_mm
    known = miscalibrated(true, room, off_mm, rng) if off_mm and len(true) > 1 else true
    ticks = np.arange(-half_m, half_m + 1e-9, step_m)
    moves = np.array([[centre[0] + x, centre[1] + y, 0.0] for y in ticks.tolist() for x in ticks.tolist()])
    looked, stage = [], f"camera array {array.name}"
    for i, move in enumerate(moves):
        centres = true.centres - move  # as seen from where the person is
        hidden = sight.hidden(centres, sight_lines(centres, points), points, posed).swapaxes(0, 1)
        looked.append(_look(true, still, points + move, hidden, joint_set, faults, rng))
        progress(stage, i + 1, len(moves) + 1)
    shape = len(ticks), len(ticks)
    xy, confidence = (np.concatenate(found, axis=1) for found in zip(*looked, strict=True))
    views = (confidence > 0).sum(axis=0).reshape(*shape, -1).mean(axis=2)
    error = np.full(shape, np.nan)
    if len(true) > 1:
        # All places at once: the detector's errors are estimated from all, as from a whole take.
        located = triangulate(known, xy, confidence).points
        truth = np.concatenate([np.tile(points + move, (_DRAWS, 1, 1)) for move in moves])
        off = np.linalg.norm(located - truth, axis=-1).reshape(*shape, -1)
        good = np.isfinite(off)
        mean = np.where(good, off**2, 0).sum(axis=2) / np.maximum(good.sum(axis=2), 1)
        error = np.where(good.mean(axis=2) > 0.5, 1e3 * np.sqrt(mean), np.nan)
    progress(stage, len(moves) + 1, len(moves) + 1)
    return PlaceErrors(array.name, centre[0] + ticks, centre[1] + ticks, error, views, true.centres)


@lru_cache(maxsize=8)
def _keypoints(body: Body, joint_set: JointSet) -> Landmarks:
    """Return the keypoints, the same object each time: tables of what hides them are found by it."""
    return keypoint_landmarks(body, joint_set)


def _look(
    true: Cameras, person: Person, points: np.ndarray, hidden: np.ndarray, joint_set: JointSet,
    faults: Faults, rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return (C, F, K, 2) detections and (C, F, K) confidences of a detector that looks often at some poses."""
    px = project(true, points)
    with np.errstate(invalid="ignore"):
        inside = ((px >= 0) & (px < true.image_size[:, None, None])).all(-1)
    way = np.einsum("fij,cfi->cfj", person.orient, true.centres[:, None] - points[None, :, 0])
    # Looks are apart: drift is new in each, and nobody exchanges limbs.
    detector = replace(faults.detector, swaps_per_minute=0.0, drift_s=1e-3)
    tile = (1, _DRAWS, 1)
    sight = Sight(
        np.tile(np.where(inside[..., None], px, -1e6), (*tile, 1)), np.tile(px_per_mm(true, points), tile),
        np.tile(np.arctan2(way[..., 0], way[..., 2]), (1, _DRAWS)), np.tile(hidden, tile), true.image_size,
    )  # fmt: skip
    found = detect_keypoints(sight, joint_set, _FPS, detector, rng)
    return found.xy, found.confidence


def places_text(places: Sequence[PlaceErrors]) -> str:
    """Return maps as JSON for programs that show them, with null where nobody is located."""
    maps = [
        {"camera_array": p.array, "x_m": p.x_m.tolist(), "y_m": p.y_m.tolist(), "cameras": p.cameras.tolist(),
         "views": p.views.tolist(), "median_mm": p.median_mm,
         "error_mm": [[round(v, 3) if v == v else None for v in row] for row in p.error_mm.tolist()]}
        for p in places
    ]  # fmt: skip
    return json.dumps({"format": "manifold_mocap_places", "version": 1, "places": maps}, allow_nan=False) + "\n"
