"""A port that poses come to by the VMC protocol: listens, survives whatever comes, and puts bones onto our body."""

from __future__ import annotations

import errno
import socket
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack
from typing import Any, Protocol, TypeVar

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hands import with_fingers
from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.exchange.live_lines import EventLine, FrameLine, LiveLine, event_line
from solver_backend.exchange.so3 import quat_multiply
from solver_backend.exchange.vmc.address import VmcAddress
from solver_backend.exchange.vmc.bones import BONE_OF
from solver_backend.exchange.vmc.humanoid import Humanoid
from solver_backend.exchange.vmc.osc import LONGEST
from solver_backend.exchange.vmc.t_pose import turned
from solver_backend.fitters.motion_import.shape_from_lengths import shape_from_lengths
from solver_backend.live.face_recording import FaceRecorder
from solver_backend.live.own_proportions import own_shape
from solver_backend.live.pose_recording import PoseRecorder
from solver_backend.live.vmc_frames import BoneFrame, has_fingers

SILENT_S = 2.0
"""Seconds without a packet from which a sender is reported as silent."""
_LOOK_S = 0.2
"""Seconds after which waiting looks about itself."""
_ASK_S = 1.0
"""Seconds of silence from one request to the next."""
_RETRY_S = 0.5
_BUFFER = 1 << 20
"""Bytes that the system keeps for us: a second of the largest bundles."""
_LEGS = (("left_hip", "left_knee", "left_ankle"), ("right_hip", "right_knee", "right_ankle"))
_SAME = 0.005
"""Share by which legs may differ in length without the path being scaled."""

Frame = TypeVar("Frame", covariant=True)


class Assembly(Protocol[Frame]):
    """What makes frames of packets, and news of what is wrong with them."""

    news: list[tuple[str, str]]
    """Kind and sentence of what was wrong for the first time."""

    def take(self, packet: bytes, sender: Any, arrived: float) -> Iterator[Frame]:
        """Yield the frames that a packet makes whole."""
        ...


def listen(
    address: VmcAddress, assembly: Assembly[Frame], ask: Callable[[socket.socket], None] = lambda there: None
) -> Generator[Frame | EventLine, None, None]:
    """Yield frames as they come, and events; a port that is taken is waited for.

    Args:
        address: of this machine.
        assembly: makes frames of packets.
        ask: asks a sender to send, by our socket; called at the beginning and as long as nothing comes.

    Raises:
        CommandLineInvalid: there is no such address on this machine.
    """
    there: socket.socket | None = None
    busy = False
    while there is None:
        there = _bound(address)
        if there is None:
            if not busy:
                yield event_line("port_busy", f"Another program listens at {address}; waiting until it ends.")
            busy = True
            time.sleep(_RETRY_S)
    with there:
        yield event_line("listening", f"Listening at {address}.")
        yield from _received(there, assembly, ask)


def _received(
    there: socket.socket, assembly: Assembly[Frame], ask: Callable[[socket.socket], None] = lambda there: None
) -> Iterator[Frame | EventLine]:
    heard, silent, broken = time.perf_counter(), False, False
    ask(there)
    asked = heard
    while True:
        try:
            packet, sender = there.recvfrom(LONGEST + 1)
        except TimeoutError:
            if time.perf_counter() - asked > _ASK_S:
                asked = time.perf_counter()
                ask(there)
            if not silent and time.perf_counter() - heard > SILENT_S:
                silent = True
                yield event_line("sender_silent", f"Nothing has come for {SILENT_S:g} s; waiting.")
            continue
        except ConnectionError:  # Windows reports what an earlier packet of ours met
            continue
        except OSError as error:
            if not broken:
                broken = True
                yield event_line("port_broken", f"Nothing can be received ({error.strerror or error}); trying again.")
            time.sleep(_LOOK_S)
            continue
        heard, broken = time.perf_counter(), False
        if silent:
            silent = False
            yield event_line("sender_back", "Packets arrive again.")
        yield from assembly.take(packet, sender, heard)
        while assembly.news:
            yield event_line(*assembly.news.pop(0))


def _bound(address: VmcAddress) -> socket.socket | None:
    """Return a socket that listens, None where another program has the port."""
    with ExitStack() as on_failure:
        try:
            family, kind, protocol, _, where = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
            there = on_failure.enter_context(socket.socket(family, kind, protocol))
            there.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
            there.settimeout(_LOOK_S)
            there.bind(where)
        except (OSError, UnicodeError) as error:
            return _refuse(error, address)
        on_failure.pop_all()
        return there


def _refuse(error: Exception, address: VmcAddress) -> None:
    """Return None for a port that is taken.

    Raises:
        CommandLineInvalid: for anything else.
    """
    if getattr(error, "errno", None) == errno.EADDRINUSE:
        return
    reason = getattr(error, "strerror", None) or error
    hint = "A source is an address of this machine: vmc:// for its own programs, vmc://0.0.0.0 for the network."
    raise CommandLineInvalid(f"Nothing can be received here: {reason}.", where=str(address), hint=hint) from error


class BonesOnBody:
    """Puts the bones of a sender onto a body, whose shape follows from the first frame's lengths.

    The body has fingers from the first frame on that has some.
    """

    def __init__(self, body: Body, betas: np.ndarray | None = None) -> None:
        """Take the body, and the shape of a person who is known."""
        self.body, self.betas = body, betas
        self.news: list[EventLine] = []
        self._humanoid: Humanoid | None = None
        self._scale, self._fingers = 1.0, False

    def person(self) -> tuple[Body, np.ndarray]:
        """Return the body and its (10,) shape as they are known by now."""
        return self.body, np.zeros(10) if self.betas is None else self.betas

    def proportions(self) -> tuple[BodyLayout, np.ndarray]:
        """Return the layout and the (J, 3) rest joints of the body."""
        return self.body.layout, self.body.rest_joints(self.person()[1])

    def pose(self, frame: BoneFrame) -> tuple[np.ndarray, np.ndarray]:
        """Return the (J, 3) axis-angles and (3,) transl of a frame; bones that were not heard do not turn."""
        if self._humanoid is None:
            self._meet(frame)
        if not self._fingers and has_fingers(frame):
            self._fingers, self.body = True, with_fingers(self.body)
            self._humanoid = Humanoid(*self.proportions())
            self.news.append(event_line("fingers", "The sender moves fingers, so the body has them too."))
        humanoid = self._humanoid
        assert humanoid is not None
        quat = np.tile([1.0, 0.0, 0.0, 0.0], (len(humanoid.bones), 1))
        rows = {bone: row for row, bone in enumerate(humanoid.bones)}
        for bone, turn in frame.quat.items():
            if bone in rows:
                quat[rows[bone]] = turn
        root_quat, root_place = frame.root
        quat[0] = quat_multiply(root_quat, quat[0])
        hips = root_place + turned(root_quat, frame.place.get("Hips", np.zeros(3)))
        return humanoid.from_unity(quat, self._scale * hips)

    def _meet(self, frame: BoneFrame) -> None:
        """Learn lengths, shape and scale of a sender from its first frame."""
        rest = _t_joints(frame, self.body)
        legs = [_length(rest, self.body, chain) for chain in _LEGS]
        if self.betas is None and np.isfinite(legs).all():
            own = own_shape(self.body, rest)
            self.betas = shape_from_lengths(self.body, rest) if own is None else own
            message = "The person's shape follows from the lengths of the sender's bones."
            self.news.append({**event_line("shape", message), "betas": np.round(self.betas, 6).tolist()})
        layout, ours = self.proportions()
        self._humanoid = Humanoid(layout, ours)
        wanted, given = np.mean([_length(ours, self.body, chain) for chain in _LEGS]), np.mean(legs)
        if np.isfinite(given) and given > 0 and abs(wanted / given - 1.0) > _SAME:
            self._scale = float(wanted / given)
            message = f"The sender's legs are {given:.2f} m long, the body's {wanted:.2f} m: its path is scaled."
            self.news.append(event_line("path_scaled", message))


def pose_lines(
    found: Iterable[BoneFrame | EventLine], onto: BonesOnBody, recorder: PoseRecorder | None = None,
    face: FaceRecorder | None = None,
) -> Iterator[LiveLine]:  # fmt: skip
    """Yield the lines of a live run; frames are recorded before.

    Args:
        found: what ``listen`` yields.
        onto: the body.
        recorder: keeps the poses.
        face: keeps the channels of the face.
    """
    number = 0
    for item in found:
        if isinstance(item, dict):
            yield item
            continue
        taken = time.perf_counter()
        rotvec, transl = onto.pose(item)
        if recorder is not None:
            recorder.add(item.time, rotvec, transl)
        if face is not None and item.face:
            face.add(item.time, item.face)
        yield from onto.news
        onto.news.clear()
        now = time.perf_counter()
        line: FrameLine = {
            "frame": number, "t": round(item.time, 6), "state": "tracking", "root": np.round(rotvec[0], 6).tolist(),
            "pose": np.round(rotvec[1:], 6).ravel().tolist(), "trans": np.round(transl, 6).tolist(),
            "points": 0, "latency_ms": round(1e3 * (now - taken), 3), "lag_ms": round(1e3 * (now - item.arrived), 3),
        }  # fmt: skip
        if item.face:
            line["face"] = {name: round(value, 4) for name, value in item.face.items()}
        yield line
        number += 1


def _t_joints(frame: BoneFrame, body: Body) -> np.ndarray:
    """Return (24, 3) joints of the sender's T-pose from its places, NaN where it has none."""
    layout, joints = body.layout, np.full((NUM_JOINTS, 3), np.nan)
    for j, name in enumerate(layout.joints[:NUM_JOINTS]):
        p, place = layout.parents[j], frame.place.get(BONE_OF.get(name, ""))
        if j == 0:
            joints[0] = 0.0
        elif place is None:  # a sender without an upper chest hangs neck and shoulders on what is below
            joints[j] = joints[p] if name.startswith("spine") else np.nan
        elif np.linalg.norm(place) > 1e-6:
            joints[j] = joints[p] + place * (-1.0, 1.0, 1.0)
    return joints


def _length(joints: np.ndarray, body: Body, chain: tuple[str, ...]) -> float:
    places = joints[[body.layout.joints.index(name) for name in chain]]
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
