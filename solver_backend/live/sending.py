"""Send live poses by the VMC protocol or as JSON, and replay solved motions."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.clips import unpose
from solver_backend.exchange.events import FrameLine, LiveLine, PoseValues, event_line, frame_line
from solver_backend.exchange.vmc.humanoid import Humanoid
from solver_backend.exchange.vmc.json_frames import JsonFrames
from solver_backend.exchange.vmc.osc import FrameBundle
from solver_backend.exchange.vmc.sender import JSON, PacketSender, VmcAddress
from solver_backend.live.frames import LATE_S, due_times
from solver_backend.types import Motion

Proportions = Callable[[], tuple[BodyLayout, np.ndarray]]
"""Function that returns the layout and the (J, 3) rest joints of the body, as currently known."""


class PoseSender:
    """Context manager that sends the poses of live output lines to another program.

    It calls ``proportions`` before the first pose, and again when the body's shape or fingers become known.
    """

    def __init__(self, address: VmcAddress, proportions: Proportions) -> None:
        self._proportions = proportions
        self._bundle: FrameBundle | JsonFrames | None = None
        self._clock = math.nan
        self._shift = 0.0
        self._packets = PacketSender(address)

    def watched(self, lines: Iterable[LiveLine]) -> Iterator[LiveLine]:
        """Send the pose in each output line, then yield the line. Raise MotionInvalid if the body is not supported."""
        for line in lines:
            if "event" in line:
                if line["event"] in ("shape", "fingers"):
                    self._bundle = None
            elif message := self._send(line):
                back = message.endswith("is back.")
                yield event_line("receiver_back" if back else "receiver_away", message, line["t"])
            yield line

    def _send(self, line: FrameLine) -> str:
        if "root" not in line or "pose" not in line or "trans" not in line:
            return ""
        if self._bundle is None:
            proportions = self._proportions()
            is_json = self._packets.address.scheme == JSON
            self._bundle = JsonFrames(*proportions) if is_json else FrameBundle(Humanoid(*proportions))
        rotvec = np.array([*line["root"], *line["pose"]]).reshape(-1, 3)
        return self._packets.send(self._bundle.encode(self._time(line["t"]), rotvec, np.array(line["trans"])))

    def _time(self, t: float) -> float:
        """Return a time that never decreases, because receivers would discard a pose that looks outdated."""
        if math.isnan(self._clock) or t < self._clock:
            self._shift += (0.0 if math.isnan(self._clock) else self._clock) - t
        self._clock = t
        return t + self._shift

    def summary(self) -> dict[str, object]:
        """Return the address, and the numbers of sent and refused packets."""
        return {"sent_to": str(self._packets.address), "sent": self._packets.sent, "refused": self._packets.refused}

    def __enter__(self) -> PoseSender:
        return self

    def __exit__(self, *_: object) -> None:
        self._packets.close()


def pose_values(rotvec: np.ndarray, transl: np.ndarray) -> PoseValues:
    """Convert rotation vectors (J, 3) and a translation (3,) to an output line's values, rounded to 1 µrad and 1 µm."""
    root, pose, trans = (np.round(part, 6).ravel().tolist() for part in (rotvec[0], rotvec[1:], transl))
    return {"root": root, "pose": pose, "trans": trans}


def replayed_poses(motion: Motion, *, paced: bool = True, repeat: bool = False) -> Iterator[FrameLine]:
    """Play a motion: yield an output line with all joints for each frame.

    ``paced``: play at the motion's rate, and skip frames that are late by more than ``LATE_S``. ``repeat``: play in a
    loop, with times that continue to increase.
    """
    vectors = np.concatenate([motion.global_orient, motion.body_pose], axis=1).reshape(motion.num_frames, -1, 3)
    for number, due in due_times(motion.num_frames, motion.fps, paced=paced, repeat=repeat):
        if (lag := time.perf_counter() - due) < LATE_S:
            at = number % motion.num_frames
            pose = pose_values(vectors[at], motion.transl[at])
            yield frame_line(number, number / motion.fps, "tracking", 0.0, lag, points=0, **pose)


def rest_joints(motion: Motion) -> np.ndarray:
    """Compute the (J, 3) rest joints of a motion's body from the joints and rotations in the first frame."""
    rotvec = np.concatenate([motion.global_orient[0], motion.body_pose[0]]).reshape(-1, 3)
    return unpose(motion.body_layout.parents, rotvec, motion.joints[0], motion.transl[0])
