"""The person that is largest in every view, where no cameras show who is who."""

from __future__ import annotations

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.types import Keypoints2D

JUMP = 0.5
"""A person moves by less than this share of her height from frame to frame."""


def main_person(detections: Detections, fps: float) -> Keypoints2D:
    """Return in every view and frame the detection with the greatest height times mean confidence.

    A frame in which the largest is elsewhere than the one before, by more than half a height, takes the nearest.

    Args:
        detections: of everybody, without cameras.
        fps: frames a second.
    """
    xy, confidence = detections.xy, detections.confidence
    known = confidence > 0
    y = np.where(known, xy[..., 1], np.nan)
    with np.errstate(invalid="ignore"):
        high = np.nanmax(np.where(known, y, -np.inf), axis=-1) - np.nanmin(np.where(known, y, np.inf), axis=-1)
    height = np.where(known.sum(-1) >= 5, high, 0.0)
    size = np.nan_to_num(height, neginf=0.0, posinf=0.0) * confidence.mean(-1)
    count = np.maximum(known.sum(-1), 1)
    middle = np.where(known[..., None], xy, 0.0).sum(-2) / count[..., None]
    C, F = size.shape[:2]
    chosen = size.argmax(-1)
    for f in range(1, F):
        before = np.take_along_axis(middle[:, f - 1], chosen[:, f - 1, None, None], axis=1)[:, 0]
        tall = np.take_along_axis(height[:, f - 1], chosen[:, f - 1, None], axis=1)[:, 0]
        distance = np.where(size[:, f] > 0, np.linalg.norm(middle[:, f] - before[:, None], axis=-1), np.inf)
        mine = np.take_along_axis(distance, chosen[:, f, None], axis=1)[:, 0]
        nearest = distance.argmin(-1)
        elsewhere = (mine > JUMP * tall) & (tall > 0) & (distance.min(-1) < JUMP * tall)
        chosen[:, f] = np.where(elsewhere, nearest, chosen[:, f])
    view, frame = np.ogrid[:C, :F]
    return Keypoints2D(
        xy[view, frame, chosen].astype(float), confidence[view, frame, chosen].astype(float), detections.joint_set, fps
    )
