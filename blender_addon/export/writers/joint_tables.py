"""Write text formats: BVH, and tables of joint positions (TRC, CSV)."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..._exchange.progress import Progress
from ...animation.curves import current_action
from ...animation.lanes import resting_at
from ...conventions.coordinates import euler_from_matrix
from ..plain_take import plain_take
from ..take import ExportTake, PoseSamples, against_parents, sample_joints, sample_pose

R_YUP_ZUP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Rotation that maps (x, y, z) to (x, z, -y). Blender's front, which is -Y, becomes +Z."""


UNITS_PER_METRE = 100.0  # BVH files are in centimetres by convention.
_ROTATIONS = "Zrotation Xrotation Yrotation"


def export_bvh(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write a take's deforming bones as BVH, in centimetres and degrees."""
    with plain_take(take, progress) as plain:
        pose = sample_pose(plain, progress)
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        stream.write("\n".join(["HIERARCHY", *_hierarchy(pose, pose.parents.index(-1), 0), "MOTION", ""]))
        stream.write(f"Frames: {pose.num_frames}\nFrame Time: {1 / pose.fps:.9f}\n")
        np.savetxt(stream, channels(pose), fmt="%.6f")


def channels(pose: PoseSamples) -> np.ndarray:
    """Return BVH channels (F, 3 + 3 J): the root position in centimetres, and joint angles in degrees."""
    local = against_parents(R_YUP_ZUP @ pose.rotations @ R_YUP_ZUP.T, pose.parents)
    root = pose.parents.index(-1)
    path = pose.heads[:, root] @ R_YUP_ZUP.T * UNITS_PER_METRE
    degrees = np.degrees(euler_from_matrix(local, "YXZ")[..., [2, 0, 1]])[:, _depth_first(pose, root)]
    return np.concatenate([path, degrees.reshape(pose.num_frames, -1)], axis=1)


def _hierarchy(pose: PoseSamples, j: int, depth: int) -> list[str]:
    indent, inner = "\t" * depth, "\t" * (depth + 1)
    parent = pose.parents[j]
    # The offset of the root is zero, because only some readers add it to the position.
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
    """Write the measured joints as TRC markers in millimetres, Y up."""
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
    """Write the measured joints as CSV, in metres and in Blender's world."""
    pose = measured_joints(take, progress)
    columns = [f"{name}_{axis}_m" for name in pose.names for axis in "xyz"]
    head = ",".join(["frame", "time_s", *columns])
    _write(path, [head], pose.fps, pose.heads, first=take.frame_start, delimiter=",", decimals=7)


def measured_joints(take: ExportTake, progress: Progress) -> PoseSamples:
    """Return the measured joints of a take. Joints that are missing in a frame are NaN."""
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
    """Write header lines, then one row per frame: frame number, time in seconds, joint positions from (F, J, 3)."""
    at = np.arange(len(positions))
    rows = np.column_stack([first + at, at / fps, positions.reshape(len(positions), -1)])
    formats = ["%d", "%.9f", *([f"%.{decimals}f"] * (rows.shape[1] - 2))]
    text = io.StringIO()
    np.savetxt(text, rows, fmt=formats, delimiter=delimiter)
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        stream.writelines(f"{line}\n" for line in head)
        stream.write(text.getvalue().replace("nan", ""))
