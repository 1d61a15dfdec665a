"""Represent other people's skin by points with normals, so that a person's solve does not penetrate it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.mesh import vertex_normals
from solver_backend.exchange.motion_file import FLAG_UNSEEN
from solver_backend.fitters.model.subject import BLOCK_POSES, PosedFrames, Subject, points_of
from solver_backend.types import Motion

SPACING_M = 0.025  # Distance between chosen points on the skin.
NORMAL_M = 0.01  # Length of the posed normals.
REACH_M = 0.08  # Largest distance between skin that may touch.
CLOSE_M = 0.3  # Joints this close may belong to bodies that touch: the flesh of two trunks. Chosen by hand.
_FAR_M = 1e4  # Coordinates in metres given to a person who is not visible.
BLOCK = 8  # Number of frames at a time. Affects only time and memory.


def spread_vertices(body: Body) -> np.ndarray:
    """Select vertices that are at least ``SPACING_M`` apart at rest."""
    rest, free, taken = body.v_template, np.ones(len(body.v_template), bool), list[int]()
    while free.any():
        taken.append(int(free.argmax()))
        free &= np.linalg.norm(rest - rest[taken[-1]], axis=-1) > SPACING_M
    return np.array(taken)


def only_close(one: Motion, other: Motion) -> Motion | None:
    """Return the other person's motion. Only frames in which the two people are close count as seen.

    People are close if a joint of one is within ``CLOSE_M`` of a joint of the other. Frames that do not show both
    people are also unseen. Return None if no frame is left.
    """
    if one.joints is None or other.joints is None or len(one.joints) != len(other.joints):
        return None
    apart = (np.linalg.norm(one.joints[:, joint, None] - other.joints, axis=-1) for joint in range(one.joints.shape[1]))
    near = np.any([(distance < CLOSE_M).any(axis=1) for distance in apart], axis=0) & _seen(one) & _seen(other)
    return replace(other, flags=np.where(near, 0, FLAG_UNSEEN).astype(np.uint8)) if near.any() else None


def _seen(motion: Motion) -> np.ndarray:
    return np.ones(motion.num_frames, bool) if motion.flags is None else motion.flags & FLAG_UNSEEN == 0


@dataclass(frozen=True)
class OtherSkin:
    """T points on other people's skin, in the N frames that show any of these people."""

    points: np.ndarray  # (N, T, 3) metres, single precision.
    normals: np.ndarray  # (N, T, 3) unit vectors that point out of the skin.
    rows: np.ndarray  # (F,) row of each frame in the take, -1 if nobody is visible.

    @classmethod
    def of(cls, body: Body, motions: Sequence[Motion]) -> OtherSkin:
        """Build the skin from the motions of other people with this body, over the same frames."""
        vertices = spread_vertices(body)
        normals = vertex_normals(body.v_template, body.faces)[vertices]
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        both, rest = np.r_[vertices, vertices], body.v_template[vertices]
        ends = np.concatenate([rest, rest + NORMAL_M * normals])
        names = tuple(f"skin {number}" for number in range(len(both)))
        arrays = body.shapedirs[both], body.weights[both]
        skin = Landmarks.of_points(names, ends, *arrays, posedirs=body.posedirs[both])
        people = [Subject(body, skin, motion.betas, np.zeros((len(both), 3))) for motion in motions]
        poses = [PosedFrames.of_motion(motion, np.zeros(1)) for motion in motions]
        seen = np.array([_seen(motion) for motion in motions])
        rows = np.where(seen.any(axis=0), np.cumsum(seen.any(axis=0)) - 1, -1)
        shape = int(rows.max()) + 1, len(motions) * len(vertices), 3
        points, out = np.full(shape, _FAR_M, np.float32), np.zeros(shape, np.float32)
        for number, (person, posed) in enumerate(zip(people, poses, strict=True)):
            own = slice(number * len(vertices), (number + 1) * len(vertices))
            for first in range(0, int(seen[number].sum()), BLOCK_POSES):
                frames = np.flatnonzero(seen[number])[first : first + BLOCK_POSES]
                found, tips = np.split(np.asarray(points_of(person, posed.select(frames))), 2, axis=1)
                points[rows[frames], own] = found
                out[rows[frames], own] = (tips - found) / np.linalg.norm(tips - found, axis=-1, keepdims=True)
        return cls(points, out, rows)

    def nearest(self, points: np.ndarray, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the signed distances (F, S) of points from the nearest skin, and the normals (F, S, 3) of this skin.

        Distances are negative inside, and infinite beyond ``REACH_M``. ``frames`` (F,) are the frame numbers.
        """
        height, normals = np.full(points.shape[:2], np.inf), np.tile([0.0, 0.0, 1.0], (*points.shape[:2], 1))
        kept = np.flatnonzero(self.rows[frames] >= 0)
        for first in range(0, len(kept), BLOCK):
            some = kept[first : first + BLOCK]
            rows = self.rows[frames[some]]
            skin = self.points[rows]
            theirs = _columns_in(skin, points[some])
            ours = _columns_in(points[some], skin[:, theirs])
            if not len(ours):
                continue
            both = np.ix_(some, ours)
            own, skin, out = points[both], skin[:, theirs].astype(float), self.normals[rows][:, theirs]
            squared = (own**2).sum(-1)[..., None] + (skin**2).sum(-1)[:, None] - 2.0 * own @ skin.swapaxes(1, 2)
            pick = squared.argmin(axis=2)[..., None]
            normal = np.take_along_axis(out, pick, 1)
            away = own - np.take_along_axis(skin, pick, 1)
            near = np.linalg.norm(away, axis=-1) < REACH_M
            height[both] = np.where(near, (away * normal).sum(axis=-1), np.inf)
            normals[both] = normal
        return height, normals


def _columns_in(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the columns of points (F, S, 3) that are within ``REACH_M`` of the box around ``others`` in any frame."""
    if not others.shape[1]:
        return np.zeros(0, int)
    low, high = others.min(axis=1, keepdims=True) - REACH_M, others.max(axis=1, keepdims=True) + REACH_M
    return np.flatnonzero(((points > low) & (points < high)).all(axis=-1).any(axis=0))
