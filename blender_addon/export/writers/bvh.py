"""BVH: the skeleton and its rotations; centimetres, Y up, only the root moves.

Blender's own exporter keeps Z up, which other programs read as a body on its back, and rounds the frame time.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..._exchange.progress import Progress
from ..plain_take import plain_take
from ..pose_samples import PoseSamples, sample_pose
from ..take import ExportTake

R_YUP_ZUP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""(x, y, z) becomes (x, z, -y): what faces Blender's front, -Y, faces +Z."""


UNITS_PER_METRE = 100.0
"""BVH files are in centimetres by convention."""
_ROTATIONS = "Zrotation Xrotation Yrotation"


def export_bvh(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write a take's deforming bones."""
    with plain_take(take, progress) as plain:
        pose = sample_pose(plain, progress)
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        stream.write("\n".join(["HIERARCHY", *_hierarchy(pose, pose.parents.index(-1), 0), "MOTION", ""]))
        stream.write(f"Frames: {pose.num_frames}\nFrame Time: {1 / pose.fps:.9f}\n")
        np.savetxt(stream, channels(pose), fmt="%.6f")


def channels(pose: PoseSamples) -> np.ndarray:
    """Return (F, 3 + 3 J): root position in centimetres, then Z, X, Y degrees of each joint against its parent."""
    world = R_YUP_ZUP @ pose.rotations @ R_YUP_ZUP.T
    local = world.copy()
    for j, parent in enumerate(pose.parents):
        if parent >= 0:
            local[:, j] = world[:, parent].swapaxes(1, 2) @ world[:, j]
    root = pose.heads[:, pose.parents.index(-1)] @ R_YUP_ZUP.T * UNITS_PER_METRE
    degrees = np.degrees(euler_zxy(local))[:, _depth_first(pose, pose.parents.index(-1))]
    return np.concatenate([root, degrees.reshape(pose.num_frames, -1)], axis=1)


def euler_zxy(R: np.ndarray) -> np.ndarray:
    """Return (F, J, 3) angles z, x, y in radians with ``R = Rz Rx Ry``, continuous in time where they can be.

    (z, x, y) and (z + pi, pi - x, y + pi) are one rotation; each frame takes the one nearer to the frame before.
    """
    x = np.arcsin(np.clip(R[..., 2, 1], -1, 1))
    z = np.arctan2(-R[..., 0, 1], R[..., 1, 1])
    y = np.arctan2(-R[..., 2, 0], R[..., 2, 2])
    first = np.stack([z, x, y], axis=-1)
    second = np.stack([z + np.pi, np.pi - x, y + np.pi], axis=-1)
    changes = _distance(second[1:], first[:-1]) < _distance(first[1:], first[:-1])
    other = np.concatenate([np.zeros((1, *changes.shape[1:]), bool), np.cumsum(changes, axis=0) % 2 == 1])
    return np.unwrap(np.where(other[..., None], second, first), axis=0)


def _distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return how far two sets of angles are apart, whole turns aside."""
    return np.abs((a - b + np.pi) % (2 * np.pi) - np.pi).sum(-1)


def _hierarchy(pose: PoseSamples, j: int, depth: int) -> list[str]:
    """Return the lines of a joint and all below it."""
    indent, inner = "\t" * depth, "\t" * (depth + 1)
    parent = pose.parents[j]
    # Some readers add the root's offset to its position, others do not: it is zero.
    offset = pose.rest_heads[j] - pose.rest_heads[parent] if parent >= 0 else np.zeros(3)
    kind, moves = ("ROOT", "6 Xposition Yposition Zposition") if depth == 0 else ("JOINT", "3")
    lines = [f"{indent}{kind} {pose.names[j].replace(' ', '_')}", f"{indent}{{", f"{inner}OFFSET {_text(offset)}"]
    lines.append(f"{inner}CHANNELS {moves} {_ROTATIONS}")
    children = [child for child, above in enumerate(pose.parents) if above == j]
    for child in children:
        lines += _hierarchy(pose, child, depth + 1)
    if not children:
        end = _text(pose.rest_tails[j] - pose.rest_heads[j])
        lines += [f"{inner}End Site", f"{inner}{{", f"{inner}\tOFFSET {end}", f"{inner}}}"]
    return [*lines, f"{indent}}}"]


def _depth_first(pose: PoseSamples, j: int) -> list[int]:
    below = [child for child, above in enumerate(pose.parents) if above == j]
    return [j, *(index for child in below for index in _depth_first(pose, child))]


def _text(offset_m: np.ndarray) -> str:
    return " ".join(f"{value:.6f}" for value in R_YUP_ZUP @ offset_m * UNITS_PER_METRE)
