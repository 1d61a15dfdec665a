"""Recording poses that come live: written as they come, finished into a motion at the end or by the next run."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.hands import FIRST_FINGER, with_fingers
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.body_layout import SMPL, SMPL_HANDS
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.motion_file import FLAG_UNSEEN
from solver_backend.exchange.so3 import quat_from_rotvec, rotvec_from_quat, sign_continuous
from solver_backend.fitters.motion_import.shape_from_lengths import standing_feet
from solver_backend.geometry.interpolation import slerp
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.native.motion_file import write_motion
from solver_backend.live.recorder import Recorder
from solver_backend.types import Motion

_FORMAT, _VERSION = "manifold_mocap_live_poses", 1
_RATES = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 72.0, 75.0, 90.0, 100.0, 120.0, 144.0, 200.0, 240.0)
"""Frame rates that senders have."""
_NEAR = 0.03
"""Share by which a rate may differ from one of these and be it."""
_NEIGHBOURS = 4.0
"""Frame times from one frame to the next in which others may have been lost."""
_SILENCE_S, _CUT_TO_S = 10.0, 1.0
"""A silence of more seconds is no part of a take, and is cut to so many."""
_GAP_S = 0.1
"""Frames farther than this from one that came were bridged."""

Proportions = Callable[[], tuple[Body, np.ndarray]]
"""Returns the body and its (10,) shape; asked at the first pose."""


class PoseRecorder(Recorder):
    """Appends every pose to ``MOTION.npz.recording``, and makes ``MOTION.npz`` of it at the end; a context manager."""

    def __init__(self, path: Path, source: str, person: Proportions, *, overwrite: bool) -> None:
        """Begin a recording; what a run that was killed has left is finished under a name of its own.

        Raises:
            OutputExists, OutputNotWritable: it cannot be written, or another process records to it.
        """
        super().__init__(path, finish_poses, "poses", overwrite=overwrite)
        self._source, self._person = source, person
        self._last = self._cut = 0.0

    @property
    def count(self) -> int:
        """Number of poses in the file."""
        return max(self._file.written - 1, 0)

    def add(self, time: float, rotvec: np.ndarray, transl: np.ndarray) -> None:
        """Append a pose.

        Args:
            time: seconds, not before the last one's.
            rotvec: (24, 3) axis-angles, or (52, 3) with fingers, which may begin at any pose.
            transl: (3,) metres.
        """
        if self._file.written == 0 and self._file.lost == 0:
            body, betas = self._person()
            head = {
                "format": _FORMAT, "version": _VERSION, "body": body.id, "joints": SMPL_HANDS.num_joints,
                "betas": np.asarray(betas).tolist(), "source": self._source,
            }  # fmt: skip
            self._file.append(json.dumps(head).encode() + b"\n")
        elif time - self._last > _SILENCE_S:
            self._cut += time - self._last - _CUT_TO_S
        self._last = time
        turns = np.zeros((SMPL_HANDS.num_joints, 3))
        known = len(rotvec) if len(rotvec) == len(turns) else FIRST_FINGER
        turns[:known] = rotvec[:known]
        self._file.append(np.concatenate([[time - self._cut], transl, turns.ravel()]).astype("<f8").tobytes())


def finish_poses(recording: Path, path: Path, *, overwrite: bool = False) -> bool:
    """Write a recording of poses as a motion of one rate and remove it; return whether it had poses.

    Raises:
        FileDamaged: it is none, or of another body than the one that ships.
        OutputExists, OutputNotWritable: the motion cannot be written; the recording is kept.
    """
    head, line, content = recording.read_bytes().partition(b"\n")
    count = 0
    if line:
        found = _read_head(head, recording)
        body = load_body()
        if found["body"] != body.id:
            raise FileDamaged(f"The recording is of the body {found['body']}.", where=str(recording))
        width = 4 + 3 * int(found["joints"])
        count = len(content) // (8 * width)
        rows = np.frombuffer(content[: 8 * width * count], "<f8").reshape(count, width)
        if count:
            if rows.shape[1] > 4 + 3 * SMPL.num_joints and rows[:, 4 + 3 * FIRST_FINGER :].any():
                body = with_fingers(body)
            else:
                rows = np.pad(rows[:, : 4 + 3 * FIRST_FINGER], ((0, 0), (0, 3 * (SMPL.num_joints - FIRST_FINGER))))
            write_motion(path, _motion(rows, np.array(found["betas"]), body, found["source"]), overwrite=overwrite)
    recording.unlink()
    return count > 0


def _read_head(head: bytes, recording: Path) -> dict[str, Any]:
    try:
        found = json.loads(head)
        if found["format"] == _FORMAT and found["version"] == _VERSION and found["joints"] > 0:
            return found
    except (ValueError, KeyError, TypeError):
        pass
    raise FileDamaged("The recording of poses cannot be read.", where=str(recording))


def _motion(rows: np.ndarray, betas: np.ndarray, body: Body, source: str) -> Motion:
    """Return rows of time, transl and axis-angles as a motion at their rate, poses in between by great arcs."""
    rows = rows[np.concatenate([[True], np.diff(rows[:, 0]) > 1e-4])]
    fps = rate_of(rows[:, 0])
    times = rows[0, 0] + np.arange(round((rows[-1, 0] - rows[0, 0]) * fps) + 1) / fps
    return poses_at(times, rows, fps, betas, body, source)


def poses_at(
    times: np.ndarray, rows: np.ndarray, fps: float, betas: np.ndarray, body: Body, source: str
) -> Motion:  # fmt: skip
    """Return a motion at (F,) even times, by great arcs between recorded poses; the ends hold where none came.

    Args:
        times: seconds, at the rate.
        rows: (N, 4 + 3 J) time ascending, transl and axis-angles of the poses that came.
        fps: the rate.
        betas: (10,) shape.
        body: whose poses they are.
        source: where they came from.
    """
    after = np.clip(np.searchsorted(rows[:, 0], times), 1, max(len(rows) - 1, 1))
    before, after = after - 1, np.minimum(after, len(rows) - 1)
    apart = rows[after, 0] - rows[before, 0]
    share = np.clip((times - rows[before, 0]) / np.where(apart > 0, apart, 1.0), 0.0, 1.0)
    quat = sign_continuous(quat_from_rotvec(rows[:, 4:].reshape(len(rows), -1, 3)))
    between = np.broadcast_to(share[:, None], (len(times), quat.shape[1]))
    rotvec = rotvec_from_quat(slerp(quat[before], quat[after], between))
    transl = rows[before, 1:4] + share[:, None] * (rows[after, 1:4] - rows[before, 1:4])
    nearest = np.minimum(times - rows[before, 0], np.maximum(rows[after, 0] - times, 0.0))
    joints = forward_kinematics(body, betas, exp_so3(rotvec[:, 0]), exp_so3(rotvec[:, 1:]), transl).joints
    return Motion(
        betas=betas, global_orient=rotvec[:, 0], body_pose=rotvec[:, 1:].reshape(len(times), -1), transl=transl,
        fps=fps, body=body.id, joints=joints, body_layout=body.layout, contacts=standing_feet(body, betas, joints, fps),
        flags=np.where(nearest > _GAP_S, FLAG_UNSEEN, 0).astype(np.uint8),
        provenance={"source": source, "method": "live poses"},
    )  # fmt: skip


def rate_of(times: np.ndarray) -> float:
    """Return the frame rate of (F,) seconds that may jitter or lack frames: a usual one, or a whole number."""
    if len(times) < 2:
        return 60.0
    apart = np.diff(times)
    usual_s = float(np.median(apart))
    near = apart[apart < _NEIGHBOURS * usual_s]  # longer ones are silences
    rate = float(np.rint(near / usual_s).sum() / near.sum())
    usual = min(_RATES, key=lambda known: abs(math.log(known / rate)))
    return usual if abs(usual / rate - 1.0) < _NEAR else float(max(round(rate), 1))
