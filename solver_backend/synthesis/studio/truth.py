"""Compute the ground truth of a shot: keypoints, markers, boxes, contacts and body."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.markers import marker_landmarks, skin_normals
from solver_backend.cameras.projection import project
from solver_backend.geometry.rotations import log_so3
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.studio.sight import BodySight, body_proxy, cast_lines, hidden_by_ellipsoids
from solver_backend.synthesis.studio.stage import Stage
from solver_backend.synthesis.studio.z_buffer import in_pictures
from solver_backend.types import NUM_BODY_JOINTS, NUM_JOINTS, Cameras, JointSet, Motion

OUTSIDE, SELF_HIDDEN, FURNITURE_HIDDEN, VISIBLE = 0, 1, 2, 3  # Visibility: hidden by the body or by furniture.
_SOLE_M, _STANDING_M_S = 0.03, 0.15
_TURNED_AWAY = -0.4  # Smallest cosine of a visible marker's normal to the line of sight, tuned on rendered images.


@dataclass(frozen=True)
class Truth:
    """Ground truth of a shot for F frames and C cameras."""

    keypoints3d: dict[JointSet, np.ndarray]  # (F, K, 3) positions in metres for each joint set.
    xy: dict[JointSet, np.ndarray]  # (C, F, K, 2) pixels, also of hidden points. NaN where projection is impossible.
    visibility: dict[JointSet, np.ndarray]  # (C, F, K) uint8, ``OUTSIDE`` to ``VISIBLE``.
    marker_xy: np.ndarray  # (C, F, M, 2) pixels.
    boxes: np.ndarray  # (C, F, 4) box around the person in px: left, top, right, bottom. NaN if not visible.
    inside: np.ndarray  # (C, F) fraction of the person that is inside the image.
    contacts: np.ndarray  # (F, 2) mask of the frames with the left and right foot on the floor.

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the ground truth as plain arrays by name."""
        result = {"marker_xy": self.marker_xy, "boxes": self.boxes, "inside": self.inside, "contacts": self.contacts}
        for chosen in self.keypoints3d:
            result[f"keypoints3d_{chosen.value}"] = self.keypoints3d[chosen]
            result[f"xy_{chosen.value}"] = self.xy[chosen].astype(np.float32)
            result[f"visibility_{chosen.value}"] = self.visibility[chosen]
        return result


def find_truth(stage: Stage, fps: float, *, sight: bool = True) -> Truth:
    """Compute the ground truth of a shot. If ``sight`` is False, no point is hidden."""
    person, cameras = stage.person, stage.cameras
    every, columns = _keypoints(person.body)
    posed = person.pose(every).points
    px = project(cameras, posed)
    visible = np.where(in_pictures(px, cameras.image_size), VISIBLE, OUTSIDE).astype(np.uint8)
    boxes, inside = np.full((*px.shape[:2], 4), np.nan), np.zeros(px.shape[:2])
    if sight:
        body = BodySight(person.body, person.betas, every)
        for chunk, proxy, lines in cast_lines(body.proxy, person, cameras, posed):
            seen = np.swapaxes(visible[:, chunk], 0, 1)
            seen[(seen == VISIBLE) & body.hidden(cameras.centres, lines, posed[chunk], proxy)] = SELF_HIDDEN
            seen[(seen > OUTSIDE) & stage.room.hides(cameras.centres, lines)] = FURNITURE_HIDDEN
            boxes[:, chunk], inside[:, chunk] = _boxes(cameras, proxy.points, body.proxy.share)
    points = {s: posed[:, c] for s, c in columns.items()}
    xy, visibility = ({s: seen[:, :, c] for s, c in columns.items()} for seen in (px, visible))
    marker_xy = project(cameras, stage.markers).astype(np.float32)
    return Truth(points, xy, visibility, marker_xy, boxes, inside, _contacts(points[JointSet.BODY_25], fps))


def true_motion(person: Person, joints: np.ndarray, contacts: np.ndarray, fps: float) -> Motion:
    """Return a simulated person's true motion."""
    pose = np.zeros((len(person.transl), 3 * (NUM_JOINTS - 1)))
    pose[:, : 3 * NUM_BODY_JOINTS] = log_so3(person.local).reshape(len(pose), -1)
    source = {"source": "studio", "settings": {"body": "neutral"}}
    parameters = person.betas, log_so3(person.orient), pose, person.transl
    return Motion(*parameters, fps, person.body.id, joints, contacts=contacts, provenance=source)


@lru_cache(maxsize=8)
def _keypoints(body: Body) -> tuple[Landmarks, dict[JointSet, list[int]]]:
    """Return the distinct keypoints of all joint sets, and the columns that belong to each joint set."""
    parts: list[Landmarks] = []
    known: dict[bytes, int] = {}
    columns: dict[JointSet, list[int]] = {chosen: [] for chosen in JointSet}
    for chosen, column in columns.items():
        points = keypoint_landmarks(body, chosen)
        for i, name in enumerate(points.names):
            key = name.encode() + np.round(points.anchors[i], 9).tobytes()
            if key not in known:
                known[key] = len(parts)
                parts.append(points.part(slice(i, i + 1)))
            column.append(known[key])
    return Landmarks.joined(parts), columns


def _boxes(cameras: Cameras, skin: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (C, f, 4) boxes around the points (f, P, 3) inside each image, and (C, f) fractions of the skin inside."""
    px = project(cameras, skin)
    # Reduce one axis at a time, because reductions over an axis of length two are slow.
    x, y = (np.ascontiguousarray(px[..., i]) for i in (0, 1))
    wide, high = (cameras.image_size[:, i, None, None] - 0.5 for i in (0, 1))
    with np.errstate(invalid="ignore"):
        there = (x >= -0.5) & (x < wide) & (y >= -0.5) & (y < high)
    first = [np.where(there, side, np.inf).min(axis=-1) for side in (x, y)]
    last = [np.where(there, side, -np.inf).max(axis=-1) for side in (x, y)]
    box = np.stack([*first, *last], axis=-1)
    return np.where(np.isfinite(box), box, np.nan), there @ share


def _contacts(body25: np.ndarray, fps: float) -> np.ndarray:
    """Return (F, 2) floor contacts. A foot stands if any of its sole points is slow and near the floor."""
    names = JointSet.BODY_25.keypoints
    standing = []
    for side in ("left", "right"):
        sole = body25[:, [names.index(f"{side}_{part}") for part in ("big_toe", "small_toe", "heel")]]
        speed = np.linalg.norm(np.gradient(sole, axis=0) if len(sole) > 1 else 0 * sole, axis=-1) * fps
        standing.append(((sole[..., 2] < _SOLE_M) & (speed < _STANDING_M_S)).any(axis=1))
    return np.stack(standing, axis=1)


def marker_sight(stage: Stage) -> np.ndarray:
    """Return the visibility (C, F, M) of markers as float32: 1 for visible and 0 for hidden markers.

    A marker is hidden if the skin at its position faces away from the camera. Other limbs and furniture can block the
    line of sight. 90 % of the results agree with rendered images.
    """
    cameras, person = stage.cameras, stage.person
    seen = np.zeros((len(cameras), stage.num_frames, len(stage.labels)), np.float32)
    if not len(stage.labels):
        return seen
    proxy = body_proxy(person.body, person.betas)
    bone = marker_landmarks(person.body, stage.labels).weights.argmax(axis=1)
    normal, counted = skin_normals(person.body, stage.labels), proxy.bone[:, None] != bone
    within = in_pictures(project(cameras, stage.markers), cameras.image_size)
    for chunk, posed, lines in cast_lines(proxy, person, cameras, stage.markers, 64):
        hidden = hidden_by_ellipsoids(cameras.centres, lines, posed.middle, posed.shape, counted)
        hidden |= stage.room.hides(cameras.centres, lines)
        facing = -(lines * np.einsum("fkij,kj->fki", posed.turn[:, bone], normal)[:, None]).sum(axis=-1)
        hidden |= facing < _TURNED_AWAY * np.linalg.norm(lines, axis=-1)
        seen[:, chunk] = within[:, chunk] & ~np.swapaxes(hidden, 0, 1)
    return seen
