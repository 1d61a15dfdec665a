"""What each source contributes on cameras, in one form: bodies where they start, and where cameras saw them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import lens_of
from solver_backend.camera_calibration.adjustment.problem import Bodies, BodySightings
from solver_backend.camera_calibration.boards.board import Board
from solver_backend.camera_calibration.boards.detection import BoardSighting
from solver_backend.camera_calibration.extrinsics.from_board import placed_boards, poses_seen
from solver_backend.camera_calibration.extrinsics.from_person import LEAST_CONFIDENCE, START_SIGMA_PX
from solver_backend.camera_calibration.extrinsics.points_session import CLICK_SIGMA_PX, PLACE_SIGMA_M, Clicks
from solver_backend.camera_calibration.extrinsics.two_views import intersected
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.errors import CalibrationInvalid, NoDetections
from solver_backend.geometry.alignment import umeyama
from solver_backend.types import Cameras, Keypoints2D

PERSON_FRAMES = 160
"""Frames of a take at most, spread over it."""
PERSON_ALIKE = 10
"""Frames that count as one, for a detector's errors are alike from frame to frame."""
LEAST_PLACES = 3
"""Known places by which a world is found."""


@dataclass(frozen=True)
class Evidence:
    """What one source contributes."""

    name: str
    """As messages call it."""
    bodies: Bodies
    """B bodies at a start, in the cameras' world."""
    seen: BodySightings
    """Of these bodies; deviations are a first guess."""
    alike: float = 1.0
    """Sightings with correlated errors, by which their weight is reduced."""
    metric: bool = False
    """It fixes the scale: a board, or known places."""
    moments: tuple[int, ...] = ()
    """Frame of each pose of a board."""


def board_evidence(
    cameras: Cameras, board: Board, sightings: Sequence[Mapping[int, BoardSighting]], fps: float | None = None
) -> Evidence:
    """Return the evidence of a carried board; each pose starts by the camera that sees most of it.

    Args:
        cameras: C cameras at a start.
        board: what was filmed.
        sightings: for each camera, what it saw by the frame's number.
        fps: frames a second, where cameras may be late.

    Raises:
        NoDetections: no camera saw it.
    """
    poses = [poses_seen(board, seen, lens_of(cameras, c)) for c, seen in enumerate(sightings)]
    moments = tuple(sorted(set().union(*(p.keys() for p in poses))))
    if not moments:
        raise NoDetections(f"No camera sees the {board}.", hint="Check that --board names the board that was filmed.")
    stands = list(zip(cameras.R, cameras.t, strict=True))
    bodies, seen = placed_boards(board, sightings, poses, stands, moments, fps)
    return Evidence("board", bodies, seen, metric=True, moments=moments)


def person_evidence(cameras: Cameras, keypoints: Keypoints2D) -> Evidence:
    """Return the evidence of one person's keypoints: points alone, of frames spread over the take.

    Raises:
        NoDetections: no two cameras see the person at the same moment.
    """
    useful = np.flatnonzero(((keypoints.confidence >= LEAST_CONFIDENCE).sum(2) > 3).sum(0) >= 2)
    if not len(useful):
        raise NoDetections(
            "No two cameras see the person at the same moment.", hint="Check that the views are synchronised."
        )
    frames = useful[np.unique(np.linspace(0, len(useful) - 1, min(PERSON_FRAMES, len(useful))).astype(int))]
    confidence = keypoints.confidence[:, frames].reshape(len(cameras), -1)
    xy = keypoints.xy[:, frames].reshape(len(cameras), -1, 2)
    xy = np.where((confidence >= LEAST_CONFIDENCE)[..., None], xy, np.nan)
    sigma = START_SIGMA_PX / np.sqrt(np.clip(confidence, 0.1, 1.0))
    return Evidence("person", *_points(cameras, xy, sigma), alike=float(min(PERSON_ALIKE, len(frames))))


def clicks_evidence(cameras: Cameras, clicks: Clicks) -> Evidence:
    """Return the evidence of clicked points; known places hold them."""
    xy, known = _tables(cameras, clicks)
    bodies, seen = _points(cameras, xy, np.full(xy.shape[:2], CLICK_SIGMA_PX), known)
    return Evidence("clicks", bodies, seen, metric=bool(np.isfinite(known).any()))


def in_world_of(clicks: Clicks, cameras: Cameras, *, with_scale: bool) -> Cameras:
    """Return the cameras in the world of the known places, as far as these fix it; as they are where none is known.

    Args:
        clicks: in pictures, some of known places.
        cameras: C cameras in any world.
        with_scale: theirs is not to be trusted.

    Raises:
        CalibrationInvalid: fewer than three known places are seen by two cameras, or they are in a line.
    """
    xy, known = _tables(cameras, clicks)
    if not np.isfinite(known).any():
        return cameras
    located = intersected(cameras.R, cameras.t, undistort(cameras, xy))
    both = np.isfinite(located).all(-1) & np.isfinite(known).all(-1)
    spread = np.linalg.svd(known[both] - known[both].mean(0))[1] if both.sum() >= LEAST_PLACES else np.zeros(2)
    if spread[1] < 0.02 * max(float(spread[0]), 1e-9):
        raise CalibrationInvalid(
            f"{int(both.sum())} known places are seen by two cameras; {LEAST_PLACES} that are not in a line are needed "
            "to know the world.",
            hint="Click more points with known places, or leave the places out.",
        )
    scale, R, t = umeyama(located[both], known[both], with_scale=with_scale)
    turned = cameras.R @ np.asarray(R).T
    return replace(cameras, R=turned, t=float(scale) * cameras.t - turned @ np.asarray(t))


def _tables(cameras: Cameras, clicks: Clicks) -> tuple[np.ndarray, np.ndarray]:
    """Return the clicks (C, P, 2) px and the places (P, 3) metres, NaN where there is none."""
    points = sorted({p for by_point in clicks.px.values() for p in by_point})
    nowhere = (np.nan, np.nan, np.nan)
    xy = [[clicks.px.get(name, {}).get(p, nowhere[:2]) for p in points] for name in cameras.names]
    return np.array(xy).reshape(len(cameras), -1, 2), np.array([clicks.places.get(p, nowhere) for p in points])


def _points(
    cameras: Cameras, xy: np.ndarray, sigma: np.ndarray, known: np.ndarray | None = None
) -> tuple[Bodies, BodySightings]:
    """Return points alone, those that two cameras see or whose places are known.

    Args:
        cameras: C cameras.
        xy: (C, P, 2) px, NaN where not seen.
        sigma: (C, P) px.
        known: (P, 3) metres, NaN where unknown.
    """
    located = intersected(cameras.R, cameras.t, undistort(cameras, xy))
    if known is not None:
        located = np.where(np.isfinite(known), known, located)
    used = np.isfinite(located).all(-1)
    camera, point = np.nonzero(np.isfinite(xy).all(-1) & used)
    number = np.cumsum(used) - 1
    seen = BodySightings(camera, number[point], np.zeros((len(point), 3)), xy[camera, point], sigma[camera, point])
    still = np.tile(np.eye(3), (int(used.sum()), 1, 1))
    return Bodies(still, located[used], None if known is None else known[used], PLACE_SIGMA_M), seen
