"""Text formats: BVH, and the joints as tables (TRC, CSV)."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..._exchange.progress import Progress
from ...animation.curves import current_action
from ...animation.lanes import resting_at
from ..plain_take import plain_take
from ..take import ExportTake, PoseSamples, sample_joints, sample_pose

R_YUP_ZUP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""(x, y, z) becomes (x, z, -y). Blender's front, -Y, becomes +Z."""


UNITS_PER_METRE = 100.0  # BVH files are in centimetres by convention.
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

    (z, x, y) and (z + pi, pi - x, y + pi) are one rotation. Each frame takes the one nearer to the frame before.
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
    """Return the distance of two sets of angles without whole turns."""
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


def export_trc(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write the joints as markers: millimetres, Y up, tab-separated, as OpenSim reads it. See ``measured_joints``."""
    pose = measured_joints(take, progress)
    frames, count, rate = pose.num_frames, len(pose.names), f"{pose.fps:.10g}"
    axes = "\t".join(f"X{j}\tY{j}\tZ{j}" for j in range(1, count + 1))
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{take.name}.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{frames}\t{count}\tmm\t{rate}\t1\t{frames}",
        "Frame#\tTime\t" + "\t\t\t".join(pose.names),
        f"\t\t{axes}",
        "",
    ]
    positions_mm = 1000 * pose.heads @ R_YUP_ZUP.T
    _write(path, head, pose.fps, positions_mm, first=1, delimiter="\t", decimals=4)


def export_csv(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write the joints: metres in Blender's world (Z up), the scene's frame numbers, seconds from the first.

    See ``measured_joints`` for omitted joints.
    """
    pose = measured_joints(take, progress)
    columns = [f"{name}_{axis}_m" for name in pose.names for axis in "xyz"]
    head = ",".join(["frame", "time_s", *columns])
    _write(path, [head], pose.fps, pose.heads, first=take.frame_start, delimiter=",", decimals=7)


def measured_joints(take: ExportTake, progress: Progress) -> PoseSamples:
    """Return the measured joints of a take.

    A joint that is always at rest is omitted. Places of a joint are NaN while it rests.
    """
    pose = sample_joints(take, progress)
    lanes = resting_at(current_action(take.armature), take.times)
    rests = np.array([lanes.get(name, np.zeros(pose.num_frames, dtype=bool)) for name in pose.names]).T
    kept = np.flatnonzero(~rests.all(axis=0))
    index = {int(j): i for i, j in enumerate(kept)}
    return replace(
        pose,
        names=tuple(pose.names[j] for j in kept),
        parents=tuple(index.get(pose.parents[j], -1) for j in kept),
        rest_heads=pose.rest_heads[kept],
        rest_tails=pose.rest_tails[kept],
        rotations=pose.rotations[:, kept],
        heads=np.where(rests[:, kept, None], np.nan, pose.heads[:, kept]),
    )


def _write(
    path: Path, head: list[str], fps: float, positions: np.ndarray, *, first: int, delimiter: str, decimals: int
) -> None:
    """Write lines, then a row per frame: number, time in seconds, positions (F, J, 3), empty for NaN."""
    at = np.arange(len(positions))
    rows = np.column_stack([first + at, at / fps, positions.reshape(len(positions), -1)])
    formats = ["%d", "%.9f", *([f"%.{decimals}f"] * (rows.shape[1] - 2))]
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        stream.writelines(f"{line}\n" for line in head)
        if np.isfinite(rows).all():
            np.savetxt(stream, rows, fmt=formats, delimiter=delimiter)
            return
        text = io.StringIO()
        np.savetxt(text, rows, fmt=formats, delimiter=delimiter)
        stream.write(text.getvalue().replace("nan", ""))
