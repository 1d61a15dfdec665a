"""Find both hands of a person in the pictures of one frame, at the ends of the arms and where other views see them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.hand_points import NUM_HAND_POINTS, SIDES
from solver_backend.types import UNSEEN_POINT, Cameras

SIDE = 224
"""Size of a crop in pixels."""
HAND_M = 0.19
"""Length from the wrist to the middle finger's tip, in metres."""
MARGIN = 1.3
"""Length of a crop in hand lengths. 1.7 finds 3 and 7 % fewer hands of Pose2Sim's balancing videos, 1 and 2 % fewer of
caliscope's."""
AHEAD = 0.45
"""Distance of the crop's middle from the wrist along the forearm, in hand lengths."""
SECOND_MARGIN = 1.9
"""Size of the second crop in extents of the first points."""
_WRIST, _KNUCKLE = 0, 9


@dataclass(frozen=True)
class HandCrop:
    """Similarity ``x_picture = A x_crop + b`` in pixels."""

    A: np.ndarray
    b: np.ndarray

    def cut(self, rgb: np.ndarray) -> np.ndarray:
        """Return the (224, 224, 3) uint8 crop, bilinear, and black beyond the picture."""
        high, wide = rgb.shape[:2]
        step = np.arange(SIDE, dtype=np.float32)
        (ax, bx), (ay, by) = self.A.astype(np.float32)
        x = (ax * step + bx * step[:, None] + np.float32(self.b[0])).ravel()
        y = (ay * step + by * step[:, None] + np.float32(self.b[1])).ravel()
        outside = (x < 0) | (x > wide - 1) | (y < 0) | (y > high - 1)
        x, y = np.clip(x, 0, wide - 1), np.clip(y, 0, high - 1)
        left, top = np.minimum(x.astype(np.int32), wide - 2), np.minimum(y.astype(np.int32), high - 2)
        u, v = x - left.astype(np.float32), y - top.astype(np.float32)
        low, first = int(top.min()), int(left.min())
        part = rgb[low : int(top.max()) + 2, first : int(left.max()) + 2]
        across, at = part.shape[1], (top - low) * part.shape[1] + left - first
        cut = np.empty((SIDE * SIDE, 3), np.uint8)
        # Channel by channel and in place, so that NumPy's inner loop is long and no memory is allocated.
        for channel in range(3):
            pixels = np.ascontiguousarray(part[..., channel], dtype=np.float32).ravel()
            a, b, c, d = (pixels[o:].take(at) for o in (0, 1, across, across + 1))
            for one, other, share in ((a, b, u), (c, d, u), (a, c, v)):
                other -= one
                other *= share
                one += other
            cut[:, channel] = a + np.float32(0.5)
        cut[outside] = 0
        return cut.reshape(SIDE, SIDE, 3)

    def in_picture(self, points: np.ndarray) -> np.ndarray:
        """Return (K, 2) px of the picture from (K, 2) of the crop."""
        return points @ self.A.T + self.b


def first_crop(
    cameras: Cameras, view: int, wrist_px: np.ndarray, elbow_px: np.ndarray, depth_m: float, side: int
) -> HandCrop:
    """Return the crop of a hand at the end of a forearm from (2,) px. Side 0 is left, and 1 is right."""
    along = wrist_px - elbow_px
    length = float(np.hypot(*along))
    up = along / length if length > 1.0 else np.array([0.0, -1.0])
    hand = float(cameras.K[view, 0, 0]) * HAND_M / depth_m
    # A forearm that points at the camera shows its hand near the wrist, so the crop is centred there.
    forearm = min(1.0, length / (1.3 * hand))
    return _crop(wrist_px + AHEAD * forearm * hand * up, up, MARGIN * hand, side)


def second_crop(points: np.ndarray, side: int) -> HandCrop:
    """Return a closer crop of (21, 2) points, with the middle finger's knuckle above the wrist."""
    along = points[_KNUCKLE] - points[_WRIST]
    length = float(np.hypot(*along))
    up = along / length if length > 1.0 else np.array([0.0, -1.0])
    across = np.array([-up[1], up[0]])
    own = np.stack([points @ across, points @ up], axis=-1)
    low, high = own.min(axis=0), own.max(axis=0)
    middle = 0.5 * (low + high)
    extent = float((high - low).max())
    return _crop(middle[0] * across + middle[1] * up, up, SECOND_MARGIN * max(extent, 8.0), side)


def _crop(middle: np.ndarray, up: np.ndarray, length: float, side: int) -> HandCrop:
    """Return the crop with a middle, up direction and length in px. Left hands are mirrored to look like right ones."""
    right = np.array([-up[1], up[0]])
    A = np.stack([right if side else -right, -up], axis=1) * (length / SIDE)
    return HandCrop(A, middle - A @ np.full(2, 0.5 * (SIDE - 1)))


PRESENCE = 0.5
"""Least presence of a visible hand, as in MediaPipe."""
PLACED = 0.05
"""Least presence of a first crop that deserves a second one, because the model was trained on better placed crops. Of
88 pairs on Pose2Sim's balancing videos, 17 rise from below 0.5 to above."""
AWAY_M = 0.1
"""Largest distance of a hand's wrist from the arm's, in all views or in its own. Chosen on two takes."""
ALIKE = 0.1
"""Arms that are closer than this, in hand lengths, need only one crop."""
NEAREST_M = 0.1
"""Least distance of a hand from a camera, in metres."""
SURE = 0.3
"""Least confidence of a view's own wrist and elbow. Chosen on two takes."""
SIGMA = 0.06
"""Standard deviation of a point for the agreement of views, as a share of the hand's length in the picture."""
RIGHT, LEAST_TRUST = 0.5, 0.1
"""A hand that looks less like a right one gets a proportionally lower confidence, down to the second value, because a
back that is taken for a palm gives the points of other fingers. Chosen on Pose2Sim's balancing videos, where it stops
fingers from crossing. Of hands below 0.1 that face a view, two thirds are the wrong way round."""


@dataclass(frozen=True)
class HandInCrop:
    """Result of the hand network in a crop."""

    points: np.ndarray
    """(21, 2) px of the crop, or of the picture."""
    presence: float
    """Likelihood of a hand, 0 to 1."""
    right: float = 1.0
    """Likelihood of a right hand, as which every crop shows its hand, 0 to 1."""

    def counted(self) -> np.ndarray:
        """Return the points with their confidence, (21, 3)."""
        trust = self.presence * min(1.0, max(LEAST_TRUST, self.right / RIGHT))
        return np.column_stack([self.points, np.full(len(self.points), trust)])


Look = Callable[[np.ndarray], HandInCrop]
"""Finds a hand in a (224, 224, 3) crop."""


@dataclass(frozen=True)
class Arms:
    """Elbows and wrists over F frames, or of one frame without that axis. The left side comes first."""

    places: np.ndarray
    """(F, 2, 2, 3) metres of elbow and wrist of each side, NaN where no views agree."""
    detected: np.ndarray
    """(C, F, 2, 2, 3) px and confidence of the same in each view."""

    def at(self, frame: int) -> Arms:
        """Return the arms of one frame."""
        return Arms(self.places[frame], self.detected[:, frame])


def search_hands(
    pictures: Mapping[int, np.ndarray],
    cameras: Cameras,
    arms: Arms,
    look: Look,
    before: np.ndarray | None = None,
    due: np.ndarray | None = None,
) -> np.ndarray:
    """Return (C, 2, 21, 3) x, y and confidence of both hands in each view, unseen where there is none.

    Args:
        pictures: (H, W, 3) uint8 by view.
        before: (C, 2, 21, 3) hands of the last frame. A hand that is still there is searched once.
        due: (C, 2) mask of views that search each hand. None for all.
    """
    due = np.ones((len(cameras), len(SIDES)), bool) if due is None else due
    found = np.tile(np.array(UNSEEN_POINT), (len(cameras), 2, NUM_HAND_POINTS, 1))
    px = project(cameras, arms.places)
    for view, rgb in pictures.items():
        for side in np.flatnonzero(due[view]):
            earlier = None if before is None else before[view, side]
            found[view, side] = _at_arm(rgb, cameras, view, side, px[view], arms, look, earlier)
    for side in range(len(SIDES)):
        looking = {view: rgb for view, rgb in pictures.items() if due[view, side]}
        _where_others_see_it(looking, cameras, side, found, look)
    return found


def _at_arm(
    rgb: np.ndarray,
    cameras: Cameras,
    view: int,
    side: int,
    px: np.ndarray,
    arms: Arms,
    look: Look,
    earlier: np.ndarray | None,
) -> np.ndarray:
    """Search a hand where it was, at the arm of all views, and at the arm of this view. Return (21, 3)."""
    unseen = np.tile(np.array(UNSEEN_POINT), (NUM_HAND_POINTS, 1))
    wrist = arms.places[1, side]
    depth = float(wrist @ cameras.R[view, 2] + cameras.t[view, 2])
    if not np.isfinite(px[:, side]).all() or depth <= NEAREST_M:
        return unseen
    own = arms.detected[view, :, side]
    sure = own[:, 2:] >= SURE
    hand_px = HAND_M * float(cameras.K[view, 0, 0]) / depth
    there = np.where(sure, own[:, :2], px[:, side])
    alike = float(np.linalg.norm(there - px[:, side], axis=-1).max()) < ALIKE * hand_px
    places = [px[:, side]] if alike else [px[:, side], there]
    places = [place for place in places if ((place[1] >= 0) & (place[1] < rgb.shape[1::-1])).all()]
    reach = AWAY_M * float(cameras.K[view, 0, 0]) / depth

    def near(points: np.ndarray) -> bool:
        return any(float(np.linalg.norm(points[0, :2] - place[1])) < reach for place in places)

    if earlier is not None and earlier[0, 2] > 0:
        again = _in_crop(rgb, second_crop(earlier[:, :2], side), look)
        if again.presence >= PRESENCE and near(again.points):
            return again.counted()
    for elbow, at in places:
        found = _looked_twice(rgb, first_crop(cameras, view, at, elbow, depth, side), side, look)
        if found is not None and near(found):
            return found
    return unseen


def _where_others_see_it(
    pictures: Mapping[int, np.ndarray], cameras: Cameras, side: int, found: np.ndarray, look: Look
) -> None:
    """Search a hand in views that miss it, where two others agree on its points. Update ``found`` in place."""
    seen = found[:, side, 0, 2] > 0
    missing = [view for view in pictures if not seen[view]]
    if seen.sum() < 2 or not missing:
        return
    xy, confidence = found[:, None, side, :, :2], found[:, None, side, :, 2]
    length = np.nanmedian(np.linalg.norm(xy[seen] - xy[seen][..., :1, :], axis=-1).max(-1))
    points = triangulate(cameras, xy, confidence, SIGMA * float(length)).points[0]
    if np.isfinite(points).all(-1).mean() < 0.5:
        return
    px = project(cameras, points)
    for view in missing:
        rgb, there = pictures[view], px[view]
        there = np.where(np.isfinite(there), there, np.nanmean(there, axis=0))
        if ((there < 0) | (there >= rgb.shape[1::-1])).any():
            continue
        if (again := _looked_twice(rgb, second_crop(there, side), side, look)) is not None:
            found[view, side] = again


def _looked_twice(rgb: np.ndarray, crop: HandCrop, side: int, look: Look) -> np.ndarray | None:
    """Return the (21, 3) hand in a second crop around the points of the first. None if the second shows no hand."""
    first = _in_crop(rgb, crop, look)
    if first.presence < PLACED:
        return None
    second = _in_crop(rgb, second_crop(first.points, side), look)
    return second.counted() if second.presence >= PRESENCE else None


def _in_crop(rgb: np.ndarray, crop: HandCrop, look: Look) -> HandInCrop:
    seen = look(crop.cut(rgb))
    return replace(seen, points=crop.in_picture(seen.points))
