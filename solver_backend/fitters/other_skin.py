"""Skin of other people in a take, as points with normals, which a person does not enter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.mesh import face_normals
from solver_backend.exchange.motion_file import FLAG_UNSEEN
from solver_backend.fitters.model.subject import BLOCK_POSES, PosedFrames, Subject, points_of
from solver_backend.types import Motion

SPACING_M = 0.025  # Distance of chosen points on the skin.
NORMAL_M = 0.01  # Length of the posed normals.
REACH_M = 0.08  # Largest distance of skin that may touch.
CLOSE_M = 0.3  # Joints so near may belong to bodies that touch: flesh of two trunks. Chosen by hand.
_FAR_M = 1e4  # Place of a person who is not seen.
BLOCK = 8  # Frames at a time. Affects time and memory only.


def spread_vertices(body: Body) -> np.ndarray:
    """Return vertices that are at least ``SPACING_M`` apart at rest."""
    rest, free, taken = body.v_template, np.ones(len(body.v_template), bool), list[int]()
    while free.any():
        taken.append(int(free.argmax()))
        free &= np.linalg.norm(rest - rest[taken[-1]], axis=-1) > SPACING_M
    return np.array(taken)


def come_close(one: Motion, other: Motion) -> bool:
    """Return whether joints of two people of the same take come within ``CLOSE_M``."""
    if one.joints is None or other.joints is None or len(one.joints) != len(other.joints):
        return False
    return any(
        bool((np.linalg.norm(one.joints[:, joint, None] - other.joints, axis=-1) < CLOSE_M).any())
        for joint in range(one.joints.shape[1])
    )


@dataclass(frozen=True)
class OtherSkin:
    """T points on the skin of other people in all frames of a take."""

    points: np.ndarray  # (F, T, 3) metres, single precision.
    normals: np.ndarray  # (F, T, 3) unit vectors out of the skin.

    @classmethod
    def of(cls, body: Body, motions: Sequence[Motion]) -> OtherSkin:
        """Return the skin of motions of this body with the same frames."""
        vertices = spread_vertices(body)
        normals = np.zeros_like(body.v_template)
        for corners in body.faces.T:
            np.add.at(normals, corners, face_normals(body.v_template, body.faces))
        normals = normals[vertices] / np.linalg.norm(normals[vertices], axis=-1, keepdims=True)
        both, rest = np.r_[vertices, vertices], body.v_template[vertices]
        ends = np.concatenate([rest, rest + NORMAL_M * normals])
        names = tuple(f"skin {number}" for number in range(len(both)))
        arrays = body.shapedirs[both], body.weights[both]
        skin = Landmarks.of_points(names, ends, *arrays, posedirs=body.posedirs[both])
        people = [Subject(body, skin, motion.betas, np.zeros((len(both), 3))) for motion in motions]
        poses = [PosedFrames.of_motion(motion, np.zeros(1)) for motion in motions]
        shape = motions[0].num_frames, len(motions) * len(vertices), 3
        points, out = np.full(shape, _FAR_M, np.float32), np.zeros(shape, np.float32)
        for number, (motion, person, posed) in enumerate(zip(motions, people, poses, strict=True)):
            own = slice(number * len(vertices), (number + 1) * len(vertices))
            seen = np.ones(len(points), bool) if motion.flags is None else motion.flags & FLAG_UNSEEN == 0
            for first in range(0, int(seen.sum()), BLOCK_POSES):
                frames = np.flatnonzero(seen)[first : first + BLOCK_POSES]
                found, tips = np.split(np.asarray(points_of(person, posed.select(frames))), 2, axis=1)
                points[frames, own] = found
                out[frames, own] = (tips - found) / np.linalg.norm(tips - found, axis=-1, keepdims=True)
        return cls(points, out)

    def nearest(self, points: np.ndarray, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the signed distance (F, S) of points (F, S, 3) from the plane of the nearest skin, and its normal.

        Distances are negative inside, and infinite beyond ``REACH_M``. ``frames`` (F,) are the numbers of the frames.
        """
        height, normals = np.full(points.shape[:2], np.inf), np.tile([0.0, 0.0, 1.0], (*points.shape[:2], 1))
        for first in range(0, len(frames), BLOCK):
            some = slice(first, first + BLOCK)
            skin = self.points[frames[some]]
            theirs = _columns_in(skin, points[some])
            ours = _columns_in(points[some], skin[:, theirs])
            if not len(ours):
                continue
            own, skin, out = points[some, ours], skin[:, theirs].astype(float), self.normals[frames[some]][:, theirs]
            squared = (own**2).sum(-1)[..., None] + (skin**2).sum(-1)[:, None] - 2.0 * own @ skin.swapaxes(1, 2)
            pick = squared.argmin(axis=2)[..., None]
            normal = np.take_along_axis(out, pick, 1)
            away = own - np.take_along_axis(skin, pick, 1)
            near = np.linalg.norm(away, axis=-1) < REACH_M
            height[some, ours] = np.where(near, (away * normal).sum(axis=-1), np.inf)
            normals[some, ours] = normal
        return height, normals


def _columns_in(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the columns of points (F, S, 3) that in some frame are within reach of the box of the others (F, T, 3)."""
    if not others.shape[1]:
        return np.zeros(0, int)
    low, high = others.min(axis=1, keepdims=True) - REACH_M, others.max(axis=1, keepdims=True) + REACH_M
    return np.flatnonzero(((points > low) & (points < high)).all(axis=-1).any(axis=0))
