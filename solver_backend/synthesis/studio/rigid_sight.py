"""How head and hands hide points on themselves: tables by direction, for what is rigid hides alike in every pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmark_set import Landmarks
from solver_backend.synthesis.simulation.occlusion import stabbed_faces
from solver_backend.types import SMPL_JOINTS

_CELLS = 28
"""Cells of a side of the octahedral map (Engelhardt and Dachsbacher 2008): about 5 degrees."""
_FAR_M = 3.0
"""Where a camera stands that is farther away, metres: sight lines are the same there; chosen by hand."""
_GROUPS = (("head",), ("left_wrist", "left_hand"), ("right_wrist", "right_hand"))


@dataclass(frozen=True)
class RigidSight:
    """Of Q points that lie on rigid parts."""

    point: np.ndarray
    """(Q,) index of each point."""
    bone: np.ndarray
    """(Q,) bone whose frame its table is in."""
    table: np.ndarray
    """(Q, cells) bool: hidden from there."""
    parts: np.ndarray
    """(Q, J) bool: the parts that the table stands for."""

    def hidden(self, centres: np.ndarray, points: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Return (F, C, Q) bool of (C, 3) camera centres, (F, K, 3) points and (F, J, 3, 3) rotations of the bones."""
        way = (centres[:, None] - points[:, None, self.point]).astype(np.float32)
        local = np.einsum("fqji,fcqj->fcqi", turn[:, self.bone].astype(np.float32), way, optimize=True)
        return self.table[np.arange(len(self.point)), _cell(local)]


def rigid_sight(body: Body, landmarks: Landmarks, counted: np.ndarray) -> RigidSight:
    """Return the tables of a body's mean shape.

    Args:
        body: the body.
        landmarks: K points; those that one of head and hands carries alone get a table.
        counted: (J, K) bool: the part can hide the point.
    """
    face_part = body.weights[body.faces].sum(axis=1).argmax(axis=1)
    at, bone, tables, parts = [], [], [], []
    ways = _directions()
    for group in _GROUPS:
        bones = [body.recorded_joints[SMPL_JOINTS.index(name)] for name in group]
        carried = np.flatnonzero(landmarks.weights[:, bones].sum(axis=1) > 0.85)
        target = landmarks.anchors[carried].sum(axis=1)
        of_group = np.flatnonzero(np.isin(face_part, bones))
        if not len(carried) or not len(of_group):
            continue
        used, faces = np.unique(body.faces[of_group], return_inverse=True)
        skin, faces = body.v_template[used], faces.reshape(-1, 3)
        can = counted[face_part[of_group]][:, carried]
        table = np.zeros((len(carried), len(ways)), dtype=bool)
        for cell, way in enumerate(ways):
            frame = _looking(-way)
            middle = target.mean(axis=0) + _FAR_M * way
            face, point = stabbed_faces((skin - middle) @ frame.T, faces, (target - middle) @ frame.T)
            table[point[can[face, point]], cell] = True
        at.append(carried)
        bone.append(np.full(len(carried), bones[0]))
        tables.append(table)
        parts.append(np.tile(np.isin(np.arange(len(body.parents)), bones), (len(carried), 1)))
    return RigidSight(*(np.concatenate(found) for found in (at, bone, tables, parts)))


def _directions() -> np.ndarray:
    """Return (cells, 3) unit vectors of the middles of the octahedral map's cells."""
    ticks = (np.arange(_CELLS) + 0.5) / _CELLS * 2 - 1
    x, y = (grid.ravel() for grid in np.meshgrid(ticks, ticks, indexing="ij"))
    z = 1 - np.abs(x) - np.abs(y)
    below = z < 0
    x, y = (
        np.where(below, (1 - np.abs(y)) * np.copysign(1, x), x),
        np.where(below, (1 - np.abs(x)) * np.copysign(1, y), y),
    )
    ways = np.stack([x, y, z], axis=1)
    return ways / np.linalg.norm(ways, axis=1, keepdims=True)


def _cell(ways: np.ndarray) -> np.ndarray:
    """Return (...) the cell of each (..., 3) direction of any length."""
    x, y, z = np.moveaxis(ways / np.abs(ways).sum(axis=-1, keepdims=True), -1, 0)
    below = z < 0
    u = np.where(below, (1 - np.abs(y)) * np.copysign(1, x), x)
    v = np.where(below, (1 - np.abs(x)) * np.copysign(1, y), y)
    i, j = (np.clip(((side + 1) * (0.5 * _CELLS)).astype(np.int32), 0, _CELLS - 1) for side in (u, v))
    return i * _CELLS + j


def _looking(way: np.ndarray) -> np.ndarray:
    """Return the (3, 3) rotation to the frame of a camera that looks along a direction."""
    side = np.cross(way, [0.0, 1.0, 0.0] if abs(way[1]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(way, side), way])
