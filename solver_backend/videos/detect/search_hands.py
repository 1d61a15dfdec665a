"""Both hands of a person in the pictures of one frame: at the ends of the arms, then where other views have them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.cameras.triangulation.triangulate import triangulate
from solver_backend.exchange.hand_points import NUM_HAND_POINTS, SIDES
from solver_backend.types import UNSEEN_POINT, Cameras
from solver_backend.videos.detect.hand_crops import HAND_M, HandCrop, first_crop, second_crop

PRESENCE = 0.5
"""Presence from which a crop shows a hand, as MediaPipe has it."""
PLACED = 0.05
"""Presence from which a first look is worth a second, about what it found: the model was trained on crops that sit
better than a forearm places them. Of 88 pairs on Pose2Sim's balancing videos, 17 rise from below 0.5 to above."""
AWAY_M = 0.1
"""A hand has its wrist so near the arm's at most, where all views or its own have that; chosen on two takes."""
ALIKE = 0.1
"""Arms this near each other, in hands, place crops that show the same."""
NEAREST_M = 0.1
"""No hand is looked for nearer to a camera."""
SURE = 0.3
"""Confidence from which a view's own elbow and wrist place a crop; chosen on two takes."""
SIGMA = 0.06
"""Standard deviation of a point, as a share of the hand's length in the picture, by which views agree on a hand."""

RIGHT, LEAST_TRUST = 0.5, 0.1
"""A hand that looks less like a right one than this counts for less, in proportion, down to this share: points of a
back that is taken for a palm are those of other fingers. Chosen on Pose2Sim's balancing videos, where it ends fingers
that run through one another; of hands below 0.1 that face a view two thirds are turned about."""


@dataclass(frozen=True)
class HandInCrop:
    """What a network finds in a crop."""

    points: np.ndarray
    """(21, 2) px of the crop, or of the picture."""
    presence: float
    """0 to 1: whether there is a hand."""
    right: float = 1.0
    """0 to 1: how much it looks like a right hand, as which every crop shows its hand."""

    def counted(self) -> np.ndarray:
        """Return (21, 3) points and what they count."""
        trust = self.presence * min(1.0, max(LEAST_TRUST, self.right / RIGHT))
        return np.column_stack([self.points, np.full(len(self.points), trust)])


Look = Callable[[np.ndarray], HandInCrop]
"""(224, 224, 3) crop -> what is in it."""


@dataclass(frozen=True)
class Arms:
    """Elbows and wrists of one frame, left first."""

    places: np.ndarray
    """(2, 2, 3) metres: elbow and wrist, of each side; NaN where no views agree."""
    detected: np.ndarray
    """(C, 2, 2, 3) px and confidence of the same in each view."""


@dataclass(frozen=True)
class ArmsInViews:
    """Elbows and wrists over F frames."""

    places: np.ndarray
    """(F, 2, 2, 3) metres: elbow and wrist, of each side, left first; NaN where no views agree."""
    detected: np.ndarray
    """(C, F, 2, 2, 3) px and confidence of the same in each view."""

    def of(self, frame: int) -> Arms:
        """Return those of one frame."""
        return Arms(self.places[frame], self.detected[:, frame])


def search_hands(
    pictures: Mapping[int, np.ndarray], cameras: Cameras, arms: Arms, look: Look, before: np.ndarray | None = None,
    due: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """Return (C, 2, 21, 3) x, y and confidence of both hands in each view; unseen where there is none.

    Args:
        pictures: (H, W, 3) uint8 by view.
        cameras: C of the take.
        arms: of the frame.
        look: finds a hand in a crop.
        before: (C, 2, 21, 3) of the frame before: a hand that is still there is looked for once.
        due: (C, 2) which views look for which hand; None: all look for both.
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
    rgb: np.ndarray, cameras: Cameras, view: int, side: int, px: np.ndarray, arms: Arms, look: Look,
    earlier: np.ndarray | None,
) -> np.ndarray:  # fmt: skip
    """Return (21, 3) of a hand at the end of its arm: where it was, where the arm is, where this view has the arm."""
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
    """Look for a hand once more, in place, in views that miss it, where two others agree on its points."""
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
        again = _looked_twice(rgb, second_crop(there, side), side, look)
        if again is not None:
            found[view, side] = again


def _looked_twice(rgb: np.ndarray, crop: HandCrop, side: int, look: Look) -> np.ndarray | None:
    """Return (21, 3) of a hand in a crop about what a first look finds; None where the second sees no hand."""
    first = _in_crop(rgb, crop, look)
    if first.presence < PLACED:
        return None
    second = _in_crop(rgb, second_crop(first.points, side), look)
    return second.counted() if second.presence >= PRESENCE else None


def _in_crop(rgb: np.ndarray, crop: HandCrop, look: Look) -> HandInCrop:
    seen = look(crop.cut(rgb))
    return replace(seen, points=crop.in_picture(seen.points))
