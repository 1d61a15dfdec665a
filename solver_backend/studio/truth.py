"""What is true of a shot: keypoints of every joint set with their visibility, boxes, contacts, body parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import Landmarks, pose_landmarks
from solver_backend.cameras.projection import project
from solver_backend.geometry.rotations import log_so3
from solver_backend.simulation.filming import Person
from solver_backend.simulation.occlusion import own_faces, stabbed_faces
from solver_backend.studio.stage import Stage
from solver_backend.types import NUM_BODY_JOINTS, NUM_JOINTS, SMPL_JOINTS, Cameras, JointSet, Motion

OUTSIDE, SELF_HIDDEN, FURNITURE_HIDDEN, VISIBLE = 0, 1, 2, 3
"""Visibility of a point: not in the picture, behind the person's own body, behind furniture, or seen."""
SIGHT_HZ = 30.0
"""Sight lines are cast at most so often; between, a point keeps its visibility."""
_SOLE_M, _STANDING_M_S = 0.03, 0.15
_SETS = tuple(JointSet)


@dataclass(frozen=True)
class Truth:
    """Of F frames and C cameras."""

    keypoints3d: dict[JointSet, np.ndarray]
    """(F, K, 3) metres of each joint set."""
    xy: dict[JointSet, np.ndarray]
    """(C, F, K, 2) pixels, also of points out of sight; NaN where a camera cannot show them."""
    visibility: dict[JointSet, np.ndarray]
    """(C, F, K) uint8: ``OUTSIDE``, ``SELF_HIDDEN``, ``FURNITURE_HIDDEN`` or ``VISIBLE``."""
    marker_xy: np.ndarray
    """(C, F, M, 2) pixels."""
    boxes: np.ndarray
    """(C, F, 4) left, top, right and bottom of the person in the picture, pixels, NaN where nobody is."""
    inside: np.ndarray
    """(C, F) share of the person that is within the picture's edges."""
    contacts: np.ndarray
    """(F, 2) bool: left and right foot stand."""

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
    parts = [keypoint_landmarks(person.body, chosen) for chosen in _SETS]
    names, every, columns = _each_once(parts)
    posed = pose_landmarks(person.body, every, person.betas, person.orient, person.local, person.transl).points
    px = project(cameras.K, cameras.distortion, cameras.R, cameras.t, posed, cameras.distortion_model)
    with np.errstate(invalid="ignore"):
        within = ((px >= -0.5) & (px < cameras.image_size[:, None, None] - 0.5)).all(-1)
    visible = np.where(within, VISIBLE, OUTSIDE).astype(np.uint8)
    step = max(1, round(fps / SIGHT_HZ))
    frames = np.arange(0, stage.num_frames, step)
    boxes, inside = np.full((len(cameras), len(frames), 4), np.nan), np.zeros((len(cameras), len(frames)))
    if sight:
        hidden = np.zeros((len(cameras), len(frames), len(names)), np.uint8)
        own = own_parts(person.body, names)
        for chunk in np.array_split(np.arange(len(frames)), -(-len(frames) // 16)):
            skin = person.skin(frames[chunk])
            boxes[:, chunk], inside[:, chunk] = _boxes(cameras, skin)
            hidden[:, chunk] = _hidden(stage, skin, posed[frames[chunk]], own)
        spread = np.repeat(hidden, step, axis=1)[:, : stage.num_frames]
        visible = np.where((visible == VISIBLE) & (spread > 0), spread, visible).astype(np.uint8)
    boxes, inside = (np.repeat(v, step, axis=1)[:, : stage.num_frames] for v in (boxes, inside))
    marker_xy = project(cameras.K, cameras.distortion, cameras.R, cameras.t, stage.markers, cameras.distortion_model)
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


def own_parts(body: Body, names: tuple[str, ...]) -> np.ndarray:
    """Return (K, T) bool: the face is of a part that the point lies in; of SMPL's joints all parts that meet there."""
    own = own_faces(body, names)
    part = body.weights[body.faces].sum(axis=1).argmax(axis=-1)
    for k, name in enumerate(names):
        if name in SMPL_JOINTS and not own[k].any():
            joint = body.smpl_joints[SMPL_JOINTS.index(name)]
            meeting = [joint, body.parents[joint], *(j for j, p in enumerate(body.parents) if p == joint)]
            own[k] = np.isin(part, meeting)
    return own


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


def _hidden(stage: Stage, skin: np.ndarray, points: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return (C, f, K) what hides each point: 0 nothing, ``SELF_HIDDEN`` or ``FURNITURE_HIDDEN``."""
    cameras, faces = stage.cameras, stage.person.body.faces
    furniture, pieces = stage.room.furniture_mesh()
    hidden = np.zeros((len(cameras), *points.shape[:2]), np.uint8)
    for view, (R, t) in enumerate(zip(cameras.R.astype(np.float32), cameras.t.astype(np.float32), strict=True)):
        still = furniture.astype(np.float32) @ R.T + t
        for frame in range(len(points)):
            targets = points[frame].astype(np.float32) @ R.T + t
            face, target = stabbed_faces(skin[frame].astype(np.float32) @ R.T + t, faces, targets)
            count = np.bincount(target, ~own[target, face], minlength=len(targets))
            hidden[view, frame] = np.where(count > 0, SELF_HIDDEN, 0)
            if len(pieces):
                _, behind = stabbed_faces(still, pieces, targets)
                hidden[view, frame, behind] = FURNITURE_HIDDEN
    return hidden


def _boxes(cameras: Cameras, skin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (C, f, 4) boxes of (f, V, 3) skins, cut off at the picture's edges, and (C, f) shares inside."""
    px = project(cameras.K, cameras.distortion, cameras.R, cameras.t, skin, cameras.distortion_model)
    edge = cameras.image_size[:, None, None] - 0.5
    with np.errstate(invalid="ignore"):
        there = ((px >= -0.5) & (px < edge)).all(-1)
    low = np.where(there[..., None], px, np.inf).min(axis=2)
    high = np.where(there[..., None], px, -np.inf).max(axis=2)
    box = np.concatenate([low, high], axis=-1)
    return np.where(np.isfinite(box), box, np.nan), there.mean(axis=2)


def _contacts(body25: np.ndarray, fps: float) -> np.ndarray:
    """Return (F, 2): the lowest point of the sole is near the floor and hardly moves."""
    names = JointSet.BODY_25.keypoints
    standing = []
    for side in ("left", "right"):
        sole = body25[:, [names.index(f"{side}_{part}") for part in ("big_toe", "small_toe", "heel")]]
        speed = np.linalg.norm(np.gradient(sole, axis=0) if len(sole) > 1 else 0 * sole, axis=-1) * fps
        standing.append(((sole[..., 2] < _SOLE_M) & (speed < _STANDING_M_S)).any(axis=1))
    return np.stack(standing, axis=1)
