"""What of a person's own body hides their keypoints: ellipsoids of its parts, and tables of head and hands."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmark_set import Landmarks
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.simulation.occlusion import own_faces
from solver_backend.synthesis.studio.body_proxy import PosedProxy, body_proxy
from solver_backend.synthesis.studio.rigid_sight import RigidSight, rigid_sight
from solver_backend.synthesis.studio.sight import hidden_by_ellipsoids
from solver_backend.types import SMPL_JOINTS


class BodySight:
    """Who of some cameras sees past a body.

    Args:
        body: the body.
        betas: (10,) its shape.
        landmarks: K keypoints; the same object again finds its tables made.
    """

    def __init__(self, body: Body, betas: np.ndarray, landmarks: Landmarks) -> None:
        self.proxy = body_proxy(body, betas)
        self._rigid, counted = _tables(body, landmarks)
        self._counted = counted[self.proxy.bone]

    def hidden(self, centres: np.ndarray, lines: np.ndarray, points: np.ndarray, posed: PosedProxy) -> np.ndarray:
        """Return (F, C, K) bool: the body stands in the sight line of its keypoint.

        Args:
            centres: (C, 3) of the cameras, metres.
            lines: (F, C, K, 3) from ``sight_lines``.
            points: (F, K, 3) the keypoints, metres.
            posed: the proxy in these frames.
        """
        hidden = hidden_by_ellipsoids(centres, lines, posed.middle, posed.shape, self._counted)
        hidden[..., self._rigid.point] |= self._rigid.hidden(centres, points, posed.turn)
        return hidden


def pose_proxy(sight: BodySight, person: Person, frames: slice) -> PosedProxy:
    """Return the proxy in some of a person's frames."""
    return sight.proxy.posed(
        Person(person.body, person.betas, person.orient[frames], person.local[frames], person.transl[frames])
    )


def own_parts(body: Body, names: tuple[str, ...]) -> np.ndarray:
    """Return (K, T) bool: the face is of a part that the point lies in; of SMPL's joints all parts that meet there."""
    own = own_faces(body, names)
    part = body.weights[body.faces].sum(axis=1).argmax(axis=-1)
    for k, name in enumerate(names):
        if name in SMPL_JOINTS and not own[k].any():
            joint = body.recorded_joints[SMPL_JOINTS.index(name)]
            meeting = [joint, body.parents[joint], *(j for j, p in enumerate(body.parents) if p == joint)]
            own[k] = np.isin(part, meeting)
    return own


@lru_cache(maxsize=8)
def _tables(body: Body, landmarks: Landmarks) -> tuple[RigidSight, np.ndarray]:
    """Return the tables of head and hands, and (J, K) bool: the part's ellipsoids can hide the keypoint."""
    part = body.weights[body.faces].sum(axis=1).argmax(axis=1)
    own = own_parts(body, landmarks.names)
    counted = np.stack([~own[:, part == bone].any(axis=1) for bone in range(len(body.parents))])
    rigid = rigid_sight(body, landmarks, counted)
    for point, parts in zip(rigid.point, rigid.parts, strict=True):
        counted[parts, point] = False
    return rigid, counted
