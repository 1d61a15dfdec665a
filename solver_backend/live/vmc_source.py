"""Receive poses by the VMC protocol, and transfer the sender's bones to our body."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hands import with_fingers
from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.events import EventLine, LiveLine, event_line, frame_line
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.exchange.plain_text import plain
from solver_backend.exchange.so3 import quat_multiply
from solver_backend.exchange.vmc.humanoid import BONE_OF, JOINT_OF, Humanoid, t_pose, turned
from solver_backend.exchange.vmc.osc import BONE, ROOT, TIME, OscMessage, decode_packet
from solver_backend.fitters.motion_import.import_motion import shape_from_lengths
from solver_backend.live.port import LARGEST_CHANNEL, MOST_CHANNELS, OneSender, rounded_face
from solver_backend.live.recordings import FaceRecorder, PoseRecorder
from solver_backend.live.sending import pose_values

FARTHEST_M = 1e4  # Largest plausible distance from the origin in metres.
FACE = "/VMC/Ext/Blend/Val"
_LONGEST_NAME = 40  # Longest part of a sender's name shown in messages. Chosen by hand.
_FINGERS = ("Thumb", "Index", "Middle", "Ring", "Little")


@dataclass(frozen=True)
class BoneFrame:
    """Bones and face of the sender's Unity humanoid in one frame."""

    time: float  # Seconds since the first frame, on the sender's clock if it has one.
    arrived: float  # ``time.perf_counter()`` when its first packet arrived.
    quat: dict[str, np.ndarray]  # (4,) unit quaternion wxyz of each bone received, relative to its parent.
    place: dict[str, np.ndarray]  # (3,) position of the same bones in metres, relative to their parents.
    root: tuple[np.ndarray, np.ndarray]  # Unit quaternion wxyz and (3,) position (m) of the root in Unity's world.
    face: dict[str, float]  # Value of each face channel, usually 0 to 1.


class FrameAssembly(OneSender[list[OscMessage], BoneFrame]):
    """Decoder for the bones of one VMC sender. A frame ends when all bones have arrived, or when one arrives again."""

    words = "Another sender is ignored while the first one sends.", "A packet is not Open Sound Control"

    def _meet(self, sender: Any) -> None:
        super()._meet(sender)
        self._quat: dict[str, np.ndarray] = {}
        self._place: dict[str, np.ndarray] = {}
        self._root = (np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
        self._face: dict[str, float] = {}
        self._came: set[str] = set()
        self._whole: frozenset[str] = frozenset()
        self._begun: tuple[float | None, float] = (None, 0.0)

    def _decode(self, packet: bytes) -> list[OscMessage]:
        return decode_packet(packet)

    def _begins(self, content: list[OscMessage]) -> bool:
        return any(message.address == BONE for message in content)

    def _frames(self, content: list[OscMessage], packet: bytes, arrived: float) -> Iterator[BoneFrame]:
        times = [m.values[0] for m in content if m.address == TIME and m.values and isinstance(m.values[0], float)]
        clock = next((time for time in times if math.isfinite(time)), None)
        if clock is not None and not self.is_next(packet, clock):
            return
        for message in content:
            if message.address == BONE:
                if (bone := self._bone(message)) is not None:
                    name, quat, place = bone
                    if name in self._came:
                        yield self._frame()
                    if not self._came:
                        self._begun = (self._clock, arrived)
                    self._came.add(name)
                    self._quat[name], self._place[name] = quat, place
            elif message.address == ROOT:
                if (root := self._numbers(message)) is not None:
                    self._root = root
            elif message.address == FACE:
                self._add_face(message)
            elif not message.address.startswith("/VMC/"):
                self.name_once("message_unknown", f"A message is not part of the protocol: {_shown(message.address)}.")
        if self._whole and self._came >= self._whole:
            yield self._frame()

    def _bone(self, message: OscMessage) -> tuple[str, np.ndarray, np.ndarray] | None:
        name = message.values[0] if message.values else None
        if not isinstance(name, str) or name not in JOINT_OF:
            return self.name_once("bone_unknown", f"A bone is not a Unity bone: {_shown(name)}.")
        numbers = self._numbers(message)
        return None if numbers is None else (name, *numbers)

    def _numbers(self, message: OscMessage) -> tuple[np.ndarray, np.ndarray] | None:
        """Return a message's rotation (wxyz) and position, or report invalid numbers once and return None."""
        values = [v for v in message.values[1:8] if isinstance(v, float | int) and not isinstance(v, bool)]
        numbers = np.array(values if len(values) == 7 else [math.nan], np.float64)
        length = float(np.linalg.norm(numbers[3:])) if (np.abs(numbers) < FARTHEST_M).all() else 0.0
        if not 0.5 < length < 2.0:
            what = _shown(message.values[:1])
            return self.name_once("numbers_impossible", f"The values of {what} are impossible.")
        return numbers[[6, 3, 4, 5]] / length, numbers[:3]

    def _add_face(self, message: OscMessage) -> None:
        name, value = (*message.values, None, None)[:2]
        if isinstance(name, str) and isinstance(value, float) and abs(value) < LARGEST_CHANNEL:  # NaN fails this test
            channel = name[:_LONGEST_NAME]
            if len(self._face) < MOST_CHANNELS or channel in self._face:
                self._face[channel] = value
                return
        self.name_once("face_impossible", f"A face channel is not valid, or there are too many: {_shown(name)}.")

    def _frame(self) -> BoneFrame:
        time_s = self.pass_time(*self._begun)
        self._whole = frozenset(self._came)
        self._came.clear()
        return BoneFrame(time_s, self._begun[1], dict(self._quat), dict(self._place), self._root, dict(self._face))


def _shown(name: object) -> str:
    return plain(str(name)[:_LONGEST_NAME])


_OURS_M = 1e-4  # Largest bone error, in metres, of our own body. Other bodies differ by centimetres.
_ROUNDS = 6  # Number of Gauss-Newton steps. Chosen by hand.
_PULL = 1e-11  # Weight of the mean shape in square metres. It acts where joints do not determine the shape.


def own_shape(body: Body, joints: np.ndarray) -> np.ndarray | None:
    """Find the (10,) shape with these T-pose joints (24, 3), or return None if the sender uses another body.

    Gauss-Newton steps minimise ``Σ |b_j(β) - b_j|² + λ |β|²`` over shapes β, where b_j is the sender's bone from the
    parent of joint j to joint j. If the T-pose rotates a bone, only its length is compared: ``d|b| = b/|b| · db``.
    Missing joints are NaN.
    """
    layout, count = body.layout, len(joints)
    child = np.array([j for j in range(1, count) if np.isfinite(joints[j]).all()])
    if len(child) < count - 3:  # our own program sends all bones but the knuckles
        return None
    parent = np.array(layout.parents)[child]
    wanted = joints[child] - joints[parent]
    slopes = body.joints_shapedirs[child] - body.joints_shapedirs[parent]
    still = np.abs(t_pose(layout, body.rest_joints(np.zeros(10)))[parent, 0] - 1.0) < 1e-12
    length = np.linalg.norm(wanted, axis=1)
    betas, r = np.zeros(slopes.shape[-1]), np.zeros(0)
    for _ in range(_ROUNDS):
        rest = body.rest_joints(betas)
        bones = rest[child] - rest[parent]
        reach = np.linalg.norm(bones, axis=1)
        along = np.einsum("ni,nik->nk", bones / reach[:, None], slopes)
        J = np.concatenate([slopes[still].reshape(-1, len(betas)), along[~still]])
        r = np.concatenate([(wanted - bones)[still].ravel(), (length - reach)[~still]])
        betas = betas + np.linalg.solve(J.T @ J + _PULL * np.eye(len(betas)), J.T @ r - _PULL * betas)
    return betas if np.abs(r).max() < _OURS_M else None


_LEGS = (("left_hip", "left_knee", "left_ankle"), ("right_hip", "right_knee", "right_ankle"))
_SAME = 0.005  # Largest relative difference in leg length at which the path is not scaled.


class BonesOnBody:
    """Transfer of a sender's bones to our body. The first frame determines the body's shape."""

    def __init__(self, body: Body, betas: np.ndarray | None = None) -> None:
        self.body, self.betas = body, betas
        self.news: list[EventLine] = []
        self._humanoid: Humanoid | None = None
        self._scale, self._fingers = 1.0, False

    def person(self) -> tuple[Body, np.ndarray]:
        """Return the body and its (10,) shape, as currently known."""
        return self.body, np.zeros(10) if self.betas is None else self.betas

    def proportions(self) -> tuple[BodyLayout, np.ndarray]:
        """Return the body's layout and (J, 3) rest joints."""
        return self.body.layout, self.body.rest_joints(self.person()[1])

    def pose(self, frame: BoneFrame) -> tuple[np.ndarray, np.ndarray]:
        """Convert a frame to (J, 3) rotation vectors and a (3,) translation of our body."""
        if self._humanoid is None:
            self._meet(frame)
        if not self._fingers and any(finger in bone for bone in frame.quat for finger in _FINGERS):
            self._fingers, self.body = True, with_fingers(self.body)
            self._humanoid = Humanoid(*self.proportions())
            self.news.append(event_line("fingers", "The sender moves its fingers, so the body has fingers too."))
        humanoid = self._humanoid
        assert humanoid is not None
        quat = np.array([frame.quat.get(bone, (1.0, 0.0, 0.0, 0.0)) for bone in humanoid.bones])
        root_quat, root_place = frame.root
        quat[0] = quat_multiply(root_quat, quat[0])
        hips = root_place + turned(root_quat, frame.place.get("Hips", np.zeros(3)))
        return humanoid.from_unity(quat, self._scale * hips)

    def _meet(self, frame: BoneFrame) -> None:
        rest = _t_joints(frame, self.body)
        legs = [_length(rest, self.body, chain) for chain in _LEGS]
        if self.betas is None and np.isfinite(legs).all():
            own = own_shape(self.body, rest)
            self.betas = shape_from_lengths(self.body, rest) if own is None else own
            message = "The body shape is estimated from the sender's bone lengths."
            self.news.append({**event_line("shape", message), "betas": np.round(self.betas, 6).tolist()})
        layout, ours = self.proportions()
        self._humanoid = Humanoid(layout, ours)
        wanted, given = np.mean([_length(ours, self.body, chain) for chain in _LEGS]), np.mean(legs)
        if np.isfinite(given) and given > 0 and abs(wanted / given - 1.0) > _SAME:
            self._scale = float(wanted / given)
            message = f"The sender's legs are {given:.2f} m long, and the body's {wanted:.2f} m. The path is scaled."
            self.news.append(event_line("path_scaled", message))


def pose_lines(
    found: Iterable[BoneFrame | EventLine],
    onto: BonesOnBody,
    recorder: PoseRecorder | None = None,
    face: FaceRecorder | None = None,
) -> Iterator[LiveLine]:
    """Yield output lines for the frames and events from ``listen``. Recorders, if given, store each frame first."""
    number = itertools.count()
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
        shown: dict[str, Any] = {**pose_values(rotvec, transl)}
        if item.face:
            shown["face"] = rounded_face(item.face)
        yield frame_line(next(number), item.time, "tracking", now - taken, now - item.arrived, points=0, **shown)


def _t_joints(frame: BoneFrame, body: Body) -> np.ndarray:
    """Return the (24, 3) joints of the sender's body in T-pose, NaN where missing."""
    layout, joints = body.layout, np.full((NUM_JOINTS, 3), np.nan)
    for j, name in enumerate(layout.joints[:NUM_JOINTS]):
        p, place = layout.parents[j], frame.place.get(BONE_OF.get(name, ""))
        if j == 0:
            joints[0] = 0.0
        elif place is None:  # if there is no upper chest, the neck and shoulders belong to the bone below
            joints[j] = joints[p] if name.startswith("spine") else np.nan
        elif np.linalg.norm(place) > 1e-6:
            joints[j] = joints[p] + place * (-1.0, 1.0, 1.0)
    return joints


def _length(joints: np.ndarray, body: Body, chain: tuple[str, ...]) -> float:
    places = joints[[body.layout.joints.index(name) for name in chain]]
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
