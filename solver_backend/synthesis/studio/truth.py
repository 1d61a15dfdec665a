"""Compute the truth of a shot: keypoints of every joint set with visibility, boxes, contacts, body parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmark_set import Landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.cameras.projection import project
from solver_backend.geometry.rotations import log_so3
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.studio.sight import BodySight, hidden_by_boxes, pose_proxy, sight_lines
from solver_backend.synthesis.studio.stage import Stage
from solver_backend.types import NUM_BODY_JOINTS, NUM_JOINTS, Cameras, JointSet, Motion

OUTSIDE, SELF_HIDDEN, FURNITURE_HIDDEN, VISIBLE = 0, 1, 2, 3  # Visibility; hidden by the own body or by furniture.
_CHUNK = 32  # Frames that are looked at together.
_SOLE_M, _STANDING_M_S = 0.03, 0.15
_SETS = tuple(JointSet)


@dataclass(frozen=True)
class Truth:
    """Of F frames and C cameras."""

    keypoints3d: dict[JointSet, np.ndarray]  # (F, K, 3) metres of each joint set.
    xy: dict[JointSet, np.ndarray]  # (C, F, K, 2) pixels, hidden ones too; NaN where a camera cannot show them.
    visibility: dict[JointSet, np.ndarray]  # (C, F, K) uint8, ``OUTSIDE`` to ``VISIBLE``.
    marker_xy: np.ndarray  # (C, F, M, 2) pixels.
    boxes: np.ndarray  # (C, F, 4) left, top, right, bottom of the person, px, NaN where nobody is.
    inside: np.ndarray  # (C, F) share of the person that is within the picture's edges.
    contacts: np.ndarray  # (F, 2) bool: left and right foot stand.

    def arrays(self) -> dict[str, np.ndarray]:
        """Return plain arrays by name."""
        result = {"marker_xy": self.marker_xy, "boxes": self.boxes, "inside": self.inside, "contacts": self.contacts}
        for chosen in self.keypoints3d:
            result[f"keypoints3d_{chosen.value}"] = self.keypoints3d[chosen]
            result[f"xy_{chosen.value}"] = self.xy[chosen].astype(np.float32)
            result[f"visibility_{chosen.value}"] = self.visibility[chosen]
        return result


def find_truth(stage: Stage, fps: float, *, sight: bool = True) -> Truth:
    """Return what is true of a shot.

    Args:
        stage: the shot.
        fps: frames per second.
        sight: cast sight lines; without, a point in the picture counts as visible.
    """
    person, cameras = stage.person, stage.cameras
    every, columns = _keypoints(person.body)
    posed = pose_landmarks(person.body, every, person.betas, person.orient, person.local, person.transl).points
    px = project(cameras, posed)
    with np.errstate(invalid="ignore"):
        within = ((px >= -0.5) & (px < cameras.image_size[:, None, None] - 0.5)).all(-1)
    visible = np.where(within, VISIBLE, OUTSIDE).astype(np.uint8)
    boxes, inside = np.full((*px.shape[:2], 4), np.nan), np.zeros(px.shape[:2])
    if sight:
        body = BodySight(person.body, person.betas, every)
        for start in range(0, stage.num_frames, _CHUNK):
            chunk = slice(start, start + _CHUNK)
            proxy = pose_proxy(body, person, chunk)
            lines = sight_lines(cameras.centres, posed[chunk])
            seen = np.swapaxes(visible[:, chunk], 0, 1)
            seen[(seen == VISIBLE) & body.hidden(cameras.centres, lines, posed[chunk], proxy)] = SELF_HIDDEN
            seen[(seen > OUTSIDE) & hidden_by_boxes(cameras.centres, lines, stage.room.furniture)] = FURNITURE_HIDDEN
            boxes[:, chunk], inside[:, chunk] = _boxes(cameras, proxy.points, body.proxy.share)
    marker_xy = project(cameras, stage.markers)
    body25 = JointSet.BODY_25
    points = posed[:, columns[_SETS.index(body25)]]
    return Truth(
        {s: posed[:, c] for s, c in zip(_SETS, columns, strict=True)},
        {s: px[:, :, c] for s, c in zip(_SETS, columns, strict=True)},
        {s: visible[:, :, c] for s, c in zip(_SETS, columns, strict=True)},
        marker_xy.astype(np.float32), boxes, inside, _contacts(points, fps),
    )  # fmt: skip


def true_motion(person: Person, joints: np.ndarray, contacts: np.ndarray, fps: float) -> Motion:
    """Return what the person does as a motion."""
    pose = np.zeros((len(person.transl), 3 * (NUM_JOINTS - 1)))
    pose[:, : 3 * NUM_BODY_JOINTS] = log_so3(person.local).reshape(len(pose), -1)
    return Motion(
        person.betas, log_so3(person.orient), pose, person.transl, fps, person.body.id, joints, contacts=contacts,
        provenance={"source": "studio", "settings": {"body": "neutral"}},
    )  # fmt: skip


def _each_once(parts: list[Landmarks]) -> tuple[tuple[str, ...], Landmarks, list[list[int]]]:
    """Return the different landmarks of all sets, and each set's columns of them."""
    names: list[str] = []
    chosen: list[Landmarks] = []
    known: dict[bytes, int] = {}
    columns: list[list[int]] = []
    for part in parts:
        column = []
        for i, name in enumerate(part.names):
            key = name.encode() + np.round(part.anchors[i], 9).tobytes()
            if key not in known:
                known[key] = len(names)
                names.append(name)
                chosen.append(part.part(slice(i, i + 1)))
            column.append(known[key])
        columns.append(column)
    return tuple(names), Landmarks.joined(chosen), columns


@lru_cache(maxsize=8)
def _keypoints(body: Body) -> tuple[Landmarks, list[list[int]]]:
    """Return the different landmarks of all joint sets, and each set's columns of them."""
    _, every, columns = _each_once([keypoint_landmarks(body, chosen) for chosen in _SETS])
    return every, columns


def _boxes(cameras: Cameras, skin: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (C, f, 4) boxes of (f, P, 3) points, cut off at the picture's edges, and (C, f) shares inside."""
    px = project(cameras, skin)
    # Axis by axis: reductions over two neighbours are slow.
    x, y = (np.ascontiguousarray(px[..., i]) for i in (0, 1))
    wide, high = (cameras.image_size[:, i, None, None] - 0.5 for i in (0, 1))
    with np.errstate(invalid="ignore"):
        there = (x >= -0.5) & (x < wide) & (y >= -0.5) & (y < high)
    first = [np.where(there, side, np.inf).min(axis=-1) for side in (x, y)]
    last = [np.where(there, side, -np.inf).max(axis=-1) for side in (x, y)]
    box = np.stack([*first, *last], axis=-1)
    return np.where(np.isfinite(box), box, np.nan), there @ share


def _contacts(body25: np.ndarray, fps: float) -> np.ndarray:
    """Return (F, 2): the lowest point of the sole is near the floor and hardly moves."""
    names = JointSet.BODY_25.keypoints
    standing = []
    for side in ("left", "right"):
        sole = body25[:, [names.index(f"{side}_{part}") for part in ("big_toe", "small_toe", "heel")]]
        speed = np.linalg.norm(np.gradient(sole, axis=0) if len(sole) > 1 else 0 * sole, axis=-1) * fps
        standing.append(((sole[..., 2] < _SOLE_M) & (speed < _STANDING_M_S)).any(axis=1))
    return np.stack(standing, axis=1)
