"""Find keypoints that skin hides from a camera, by casting sight lines at the posed mesh."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import Body
from solver_backend.synthesis.simulation.keypoint_detector import own_faces, stabbed_faces
from solver_backend.types import Cameras


def self_occluded(
    cameras: Cameras, body: Body, vertices: np.ndarray, points: np.ndarray, keypoints: tuple[str, ...]
) -> np.ndarray:
    """Return a mask (C, F, K) of the keypoints that another part of the same body occludes.

    Args:
        cameras: C cameras.
        body: body model that provides faces and body parts.
        vertices: (F, V, 3) posed skin vertices in metres.
        points: (F, K, 3) true keypoint positions in metres.
        keypoints: names of the K keypoints.
    """
    own = own_faces(body, keypoints)
    hidden = np.zeros((len(cameras), *points.shape[:2]), dtype=bool)
    for view, (R, t) in enumerate(zip(cameras.R.astype(np.float32), cameras.t.astype(np.float32), strict=True)):
        for frame in range(len(points)):
            skin, targets = vertices[frame].astype(np.float32) @ R.T + t, points[frame].astype(np.float32) @ R.T + t
            face, target = stabbed_faces(skin, body.faces, targets)
            hidden[view, frame] = np.bincount(target, ~own[target, face], minlength=len(targets)) > 0
    return hidden


def occluded_by(cameras: Cameras, body: Body, vertices: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return a mask (C, F, K) of the points that another person's skin occludes.

    Args: as in ``self_occluded``, with the body and the skin of the other person.
    """
    hidden = np.zeros((len(cameras), *points.shape[:2]), dtype=bool)
    for view, (R, t) in enumerate(zip(cameras.R.astype(np.float32), cameras.t.astype(np.float32), strict=True)):
        for frame in range(len(points)):
            skin, targets = vertices[frame].astype(np.float32) @ R.T + t, points[frame].astype(np.float32) @ R.T + t
            hidden[view, frame, np.unique(stabbed_faces(skin, body.faces, targets)[1])] = True
    return hidden
