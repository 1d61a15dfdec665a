"""Joint positions as tables: TRC for OpenSim and its kin, CSV for everything else."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..._exchange.progress import Progress
from ...animation.curves import current_action
from ...animation.lanes import resting_at
from ..pose_samples import PoseSamples, sample_joints
from ..take import ExportTake
from .bvh import R_YUP_ZUP


def export_trc(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write the joints as markers: millimetres, Y up, tab-separated, as OpenSim reads it; see ``measured_joints``."""
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

    See ``measured_joints`` for those that are left out.
    """
    pose = measured_joints(take, progress)
    columns = [f"{name}_{axis}_m" for name in pose.names for axis in "xyz"]
    head = ",".join(["frame", "time_s", *columns])
    _write(path, [head], pose.fps, pose.heads, first=take.frame_start, delimiter=",", decimals=7)


def measured_joints(take: ExportTake, progress: Progress) -> PoseSamples:
    """Return the joints of a take without what nothing measured: a table can leave it out, a skeleton cannot.

    Joints at rest throughout are no columns; where a joint rests for a while its places are NaN.
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
    """Write lines, then a row a frame: its number, its time in seconds, positions (F, J, 3), NaN as nothing."""
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
