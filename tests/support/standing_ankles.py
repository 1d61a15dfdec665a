"""Drift of planted ankles: CMU takes as actors without Blender, and the planned ankles of a rig in stances."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from blender_addon.retarget.motion.figures import Actor, Target
from blender_addon.retarget.motion.foreign_actor import actor_of_bones
from blender_addon.retarget.motion.map_pose import map_pose
from blender_addon.retarget.motion.transfer import TransferSettings, transfer
from blender_addon.retarget.rest_stage import stand_in_pose
from solver_backend.exchange.so3 import matrix_from_rotvec
from solver_backend.exchange.stands import stands, steps

STANDS_M = 0.02  # Largest distance of the source's ankle and ball of the foot from their places in a stance.
LOCKED_MM = 5.0
_ROLES = {
    "Hips": "pelvis", "LowerBack": "spine_1", "Spine": "spine_2", "Spine1": "spine_3", "Neck": "neck_1", "Head": "head",
    "UpLeg": "thigh", "Leg": "shin", "Foot": "foot", "ToeBase": "toe", "Shoulder": "clavicle", "Arm": "upper_arm",
    "ForeArm": "forearm", "Hand": "hand",
}  # fmt: skip
_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_THORAX_M = 0.119  # Length of the bone that the conversion lost, see the README of the shared data.


def cmu_actor(path: Path, own_rest: np.ndarray, frames: slice = slice(None)) -> Actor:
    """Return a take of ``motion_cmu/mb2`` as an actor."""
    take = np.load(path)
    names, parents, offsets = [str(n) for n in take["names"]], take["parents"], take["offsets"].astype(float)
    offsets[[names.index(name) for name in ("Neck", "LeftShoulder", "RightShoulder")]] = [0.0, _THORAX_M, 0.0]
    roles = {joint: role for name in names if (role := _role(name)) for joint in [names.index(name)]}
    G, places = _posed(parents, offsets, take["rotvec"][frames].astype(float), take["root"][frames].astype(float))
    G0, rest = _posed(parents, offsets, take["tpose_rotvec"][None].astype(float), np.zeros((1, 3)))
    matrices = np.tile(np.eye(4), (len(names), 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = G0[0], rest[0]
    left = (rest[0, names.index("LeftUpLeg")] - rest[0, names.index("RightUpLeg")]) * [1.0, 1.0, 0.0]
    left /= np.linalg.norm(left)
    R, kept = np.stack([left, np.cross([0.0, 0.0, 1.0], left), [0.0, 0.0, 1.0]]), list(roles)
    stage = stand_in_pose(tuple(names[j] for j in kept), tuple(roles.values()), matrices[kept], R, 1.0)
    turns = R @ G[:, kept] @ G0[0, kept].swapaxes(-1, -2) @ R.T
    moved = (places[:, kept] @ R.T).swapaxes(0, 1)
    A = map_pose(stage, own_rest, {})
    return actor_of_bones(path.stem, stage, A, turns.swapaxes(0, 1), moved, own_rest, float(take["fps"]))


def _role(name: str) -> str:
    for word, side in (("Left", "left_"), ("Right", "right_")):
        if name.startswith(word) and (part := _ROLES.get(name.removeprefix(word))):
            return side + part
    return _ROLES.get(name, "")


def _posed(
    parents: np.ndarray, offsets: np.ndarray, rotvec: np.ndarray, root: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    R = matrix_from_rotvec(rotvec)
    G, p = np.empty_like(R), np.empty(R.shape[:3])
    for j, parent in enumerate(parents):
        G[:, j] = R[:, j] if parent < 0 else G[:, parent] @ R[:, j]
        p[:, j] = root if parent < 0 else p[:, parent] + G[:, parent] @ offsets[j]
    return _UP @ G, p @ _UP.T


def ankle_drifts_mm(actor: Actor, target: Target) -> np.ndarray:
    """Return the drift of the source's ankle or ball and of the rig's ankle from their places in each stance, (N, 2).

    A stance is a range of slow and low frames of ankle and ball (``exchange.stands``).
    """
    done = transfer(actor, target, map_pose(target, actor.rest, {}), TransferSettings())
    drifts = []
    for side, joints in (("left", [7, 10]), ("right", [8, 11])):
        points, ankle = actor.joints[:, joints], done.places[target.index(f"{side}_foot")]
        way, seconds = steps(points, actor.fps)
        fastest = (np.linalg.norm(way, axis=-1) / np.maximum(seconds, 1e-9)).max(axis=1, keepdims=True)
        for first, stop in stands(points[:, 1:, 2], fastest, actor.fps)[0]:
            drifts.append([_drift(points[first:stop]), _drift(ankle[first:stop])])
    return 1000.0 * np.array(drifts).reshape(-1, 2)


def _drift(points: np.ndarray) -> float:
    return float(np.linalg.norm(points - np.median(points, axis=0), axis=-1).max())
