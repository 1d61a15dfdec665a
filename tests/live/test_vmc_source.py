"""Bones that come by the VMC protocol are our body's poses; whatever else comes is named once and changes nothing."""

from __future__ import annotations

import errno
import random
import socket
import struct
import tracemalloc
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.hands import FIRST_FINGER
from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.exchange.events import EventLine
from solver_backend.exchange.so3 import matrix_from_rotvec
from solver_backend.exchange.vmc.humanoid import Humanoid
from solver_backend.exchange.vmc.osc import FrameBundle, encode_bundle, encode_message
from solver_backend.exchange.vmc.sender import VmcAddress
from solver_backend.live.port import MOST_CHANNELS, _received, listen
from solver_backend.live.sending import PoseSender, rest_joints
from solver_backend.live.vmc_source import BoneFrame, BonesOnBody, FrameAssembly, pose_lines
from solver_backend.types import Motion
from tests.support.short_motion import short_motion
from tests.support.vmc_receiver import Avatar, Receiver, messages_of

ME, OTHER = ("127.0.0.1", 50000), ("127.0.0.1", 50001)
FRAMES = 12


@pytest.fixture(scope="module")
def motion():
    return short_motion(FRAMES)


@pytest.fixture(scope="module")
def packets(motion) -> list[bytes]:
    bundle = FrameBundle(Humanoid(motion.body_layout, rest_joints(motion)))
    vectors = np.concatenate([motion.global_orient, motion.body_pose], axis=1).reshape(FRAMES, -1, 3)
    return [bundle.encode(k / 60.0, vectors[k], motion.transl[k]) for k in range(FRAMES)]


def taken(assembly: FrameAssembly, packets: list[bytes], sender=ME, start: float = 0.0) -> list:
    return [frame for k, packet in enumerate(packets) for frame in assembly.take(packet, sender, start + k / 60.0)]


def bone(name: str, *numbers: float) -> bytes:
    return encode_message("/VMC/Ext/Bone/Pos", [name, *map(float, numbers or (0, 0, 0, 0, 0, 0, 1))])


def test_poses_come_back_as_they_were_sent(motion, packets):
    onto = BonesOnBody(load_body(), motion.betas)
    frames = taken(FrameAssembly(), packets)
    assert len(frames) == FRAMES
    for k, frame in enumerate(frames):
        rotvec, transl = onto.pose(frame)
        sent = np.concatenate([motion.global_orient[k], motion.body_pose[k]]).reshape(-1, 3)
        turned = matrix_from_rotvec(rotvec) @ np.swapaxes(matrix_from_rotvec(sent), -1, -2)
        assert np.degrees(np.linalg.norm(turned - np.eye(3), axis=(1, 2)) / 2**0.5).max() < 0.01
        assert np.abs(transl - motion.transl[k]).max() < 1e-4
        assert frame.time == pytest.approx(k / 60.0, abs=1e-6)
    assert not onto.news


def test_the_shape_of_our_own_body_comes_back(motion, packets):
    onto = BonesOnBody(load_body())
    rotvec, _ = onto.pose(taken(FrameAssembly(), packets[:2])[0])
    (event,) = onto.news
    assert event["event"] == "shape" and np.allclose(
        event["betas"], motion.betas, atol=0.3
    )  # joints know little of some
    assert np.abs(onto.proportions()[1] - load_body().rest_joints(motion.betas)).max() < 1e-5
    sent = np.concatenate([motion.global_orient[0], motion.body_pose[0]]).reshape(-1, 3)
    assert np.abs(matrix_from_rotvec(rotvec) - matrix_from_rotvec(sent)).max() < 1e-4


def test_a_person_of_another_body_gets_the_senders_lengths(motion, packets):
    longer = []
    for packet in packets[:2]:
        messages = [(address, list(values)) for address, values in messages_of(packet)]
        for address, values in messages:
            if address.endswith("Bone/Pos") and values[0] != "Hips":
                values[1:4] = [1.06 * number for number in values[1:4]]
        longer.append(encode_bundle([encode_message(address, values) for address, values in messages]))
    onto = BonesOnBody(load_body())
    onto.pose(taken(FrameAssembly(), longer)[0])
    ours, theirs = onto.proportions()[1][:24], 1.06 * rest_joints(motion)
    for a, b in ((1, 4), (4, 7), (16, 18), (18, 20)):
        assert np.linalg.norm(ours[b] - ours[a]) == pytest.approx(np.linalg.norm(theirs[b] - theirs[a]), abs=0.006)


def sent_with_fingers() -> tuple[Motion, list[bytes]]:
    """Return a motion of the body with hands, and its packets."""
    motion = short_motion(FRAMES, fingers=True)
    bundle = FrameBundle(Humanoid(motion.body_layout, rest_joints(motion)))
    return motion, [bundle.encode(k / 60.0, vectors_of(motion)[k], motion.transl[k]) for k in range(FRAMES)]


def vectors_of(motion: Motion) -> np.ndarray:
    return np.concatenate([motion.global_orient, motion.body_pose], axis=1).reshape(motion.num_frames, -1, 3)


def degrees_apart(a: np.ndarray, b: np.ndarray) -> float:
    apart = matrix_from_rotvec(a) - matrix_from_rotvec(b)
    return float(np.degrees(np.linalg.norm(apart, axis=(-1, -2)).max() / 2**0.5))


def test_fingers_come_back_as_they_were_sent():
    motion, packets = sent_with_fingers()
    onto = BonesOnBody(load_body())
    for k, frame in enumerate(taken(FrameAssembly(), packets)):
        rotvec, _ = onto.pose(frame)
        assert rotvec.shape == (SMPL_HANDS.num_joints, 3)
        assert degrees_apart(rotvec[FIRST_FINGER:], vectors_of(motion)[k, FIRST_FINGER:]) < 0.01
        assert degrees_apart(rotvec, vectors_of(motion)[k]) < 0.02
    assert [event["event"] for event in onto.news] == ["shape", "fingers"]
    assert onto.proportions()[0].joints == SMPL_HANDS.joints and onto.person()[0].id == load_body().id


def test_fingers_that_begin_later_are_taken_from_then_on_and_sent_on(packets):
    """A program may track hands only when it sees some; whoever poses are sent on to gets them, too."""
    motion, fingered = sent_with_fingers()
    found = taken(FrameAssembly(), [*packets[:3], *(fingered[k] for k in range(3, 6))])
    onto, receiver = BonesOnBody(load_body()), Receiver()
    address = VmcAddress("127.0.0.1", receiver.port)
    with PoseSender(address, onto.proportions) as sender:
        lines: list[Any] = list(sender.watched(pose_lines(found, onto)))
    bones = [len(Avatar().receive(packet).local) for packet in receiver.close()]
    assert [line["event"] for line in lines if "event" in line] == ["shape", "fingers"]
    sizes = [len(line["pose"]) // 3 for line in lines if "pose" in line]
    assert sizes == [23, 23, 23, 51, 51, 51] and bones == [23, 23, 23, 53, 53, 53]
    last = np.array([*lines[-1]["root"], *lines[-1]["pose"]]).reshape(-1, 3)
    assert degrees_apart(last[FIRST_FINGER:], vectors_of(motion)[5, FIRST_FINGER:]) < 0.01


def test_legs_of_another_length_scale_the_path(motion, packets):
    onto = BonesOnBody(load_body(), np.zeros(10))
    frames = taken(FrameAssembly(), packets)
    heights = [onto.pose(frame)[1][2] + load_body().rest_joints(np.zeros(10))[0, 2] for frame in frames]
    (event,) = onto.news
    assert event["event"] == "path_scaled" and "m long" in event["message"]
    sent = motion.transl[:, 2] + rest_joints(motion)[0, 2]
    assert np.allclose(np.array(heights) / sent, heights[0] / sent[0]) and abs(heights[0] / sent[0] - 1) > 0.005


def test_bones_in_several_packets_and_without_a_bundle_are_one_frame(packets):
    assembly, frames = FrameAssembly(), []
    for k, packet in enumerate(packets):
        messages = [encode_message(address, values) for address, values in messages_of(packet)]
        parts = [encode_bundle(messages[:10]), *messages[10:20], encode_bundle(messages[20:])]
        frames += [f for part in parts for f in assembly.take(part, ME, k / 60.0)]
    assert len(frames) == FRAMES and not assembly.counts
    assert all(len(frame.quat) == 22 for frame in frames)


def test_root_and_hips_turn_and_move_the_body_together():
    half = 0.5**0.5
    quat = (0.0, half, 0.0, half)  # Unity's Y by 90 degrees: Z becomes X
    root = encode_message("/VMC/Ext/Root/Pos", ["root", 1.0, 0.0, 0.0, *quat])
    packet = encode_bundle([root, bone("Hips", 0, 1.0, 0.5, 0, 0, 0, 1), bone("Head")])
    frame = taken(FrameAssembly(), [packet, packet])[0]
    body = load_body()
    rotvec, transl = BonesOnBody(body, np.zeros(10)).pose(frame)
    assert np.allclose(transl + body.rest_joints(np.zeros(10))[0], (-1.5, 0.0, 1.0), atol=1e-6)
    # Facing +X of Unity is facing -X of ours; the body's own front is +Z.
    assert np.allclose(matrix_from_rotvec(rotvec[0]) @ (0, 0, 1), (-1, 0, 0), atol=1e-6)


def test_late_and_doubled_packets_are_named_once_and_left_out(packets):
    assembly = FrameAssembly()
    order = [*range(6), 5, 3, 4, *range(6, FRAMES), 10, 11]
    frames = taken(assembly, [packets[k] for k in order])
    assert [round(60 * frame.time) for frame in frames] == list(range(FRAMES))
    assert [kind for kind, _ in assembly.news] == ["packet_doubled"]
    assembly = FrameAssembly()
    changed = [packet[:-1] + b"\0" for packet in packets]
    taken(assembly, [*packets[:6], changed[2], changed[3]])
    assert assembly.counts == {"packet_late": 2} and len(assembly.news) == 1


def test_a_sender_that_begins_anew_is_followed(packets):
    frames = taken(FrameAssembly(), [*packets[6:], *packets[:6]][::1])
    assert len(frames) == 6  # six tenths of a second back: late packets
    bundle = FrameBundle(Humanoid(load_body().layout, load_body().rest_joints(np.zeros(10))))
    far = [bundle.encode(1000.0 + k / 60.0, np.zeros((22, 3)), np.zeros(3)) for k in range(3)]
    frames = taken(FrameAssembly(), [*far, *packets])
    assert len(frames) == 3 + FRAMES
    assert np.allclose(np.diff([frame.time for frame in frames]), 1 / 60, atol=1e-4)


def test_two_senders_are_not_mixed(packets):
    assembly = FrameAssembly()
    mixed = [f for k, p in enumerate(packets) for who in (ME, OTHER) for f in assembly.take(p, who, k / 60.0)]
    assert len(mixed) == FRAMES and assembly.counts == {"second_sender": FRAMES}
    assert len(assembly.news) == 1
    assert not list(assembly.take(b"nonsense", OTHER, 0.2)) and assembly.counts == {"second_sender": FRAMES + 1}
    later = taken(assembly, packets, OTHER, start=5.0)
    assert len(later) == FRAMES  # the first one is gone


@pytest.mark.parametrize(
    ("message", "kind"),
    [
        (bone("Tail"), "bone_unknown"), (encode_message("/VMC/Ext/Bone/Pos"), "bone_unknown"),
        (encode_message("/VMC/Ext/Bone/Pos", [3.0]), "bone_unknown"),
        (bone("Hips", *[float("nan")] * 7), "numbers_impossible"),
        (bone("Hips", 0, 0, 0, 0, 0, 0, 0), "numbers_impossible"),
        (bone("Hips", 1e30, 0, 0, 0, 0, 0, 1), "numbers_impossible"),
        (bone("Hips", 0, 0, 0), "numbers_impossible"), (bone("Hips", 0, 0, 0, 9, 9, 9, 9), "numbers_impossible"),
        (encode_message("/VMC/Ext/Bone/Pos", ["Hips", *["a"] * 7]), "numbers_impossible"),
        (encode_message("/VMC/Ext/Root/Pos", ["root", float("inf"), *[0.0] * 6]), "numbers_impossible"),
        (encode_message("/elsewhere", [1]), "message_unknown"), (b"nonsense", "packet_invalid"),
        (encode_message("/VMC/Ext/Blend/Val", ["A", 0.5]), None),
        (encode_message("/VMC/Ext/Blend/Val", ["A", float("nan")]), "face_impossible"),
        (encode_message("/VMC/Ext/Blend/Val", [0.5]), "face_impossible"),
        (encode_message("/VMC/Ext/T", ["soon"]), None),
        (encode_message("/VMC/Ext/T", [float("nan")]), None),
    ],
)  # fmt: skip
def test_what_cannot_be_is_named_once_and_frames_go_on(packets, message, kind):
    assembly = FrameAssembly()
    spoiled = [packet for k in range(FRAMES) for packet in (packets[k], message)]
    frames = taken(assembly, spoiled)
    assert len(frames) == FRAMES and all(np.isfinite(list(frame.quat.values())).all() for frame in frames)
    assert [named for named, _ in assembly.news] == ([] if kind is None else [kind])
    assert assembly.counts == ({} if kind is None else {kind: FRAMES})


def test_channels_of_a_face_come_with_the_pose_and_their_number_has_an_end(packets):
    face = [encode_message("/VMC/Ext/Blend/Val", [f"channel {k}", 0.25]) for k in range(MOST_CHANNELS + 50)]
    assembly = FrameAssembly()
    frames = taken(assembly, [encode_bundle(face), packets[0], *face[:2], packets[1]])
    assert set(frames[0].face) == {"channel 0", "channel 1"}  # what came before any bone was nobody's
    frames = taken(assembly, [encode_bundle(face), *packets[2:4]], start=0.1)
    assert frames[-1].face["channel 3"] == 0.25 and len(frames[-1].face) == MOST_CHANNELS
    assert assembly.counts == {"face_impossible": 50}
    (line,) = [line for line in pose_lines(frames[-1:], BonesOnBody(load_body(), np.zeros(10))) if "frame" in line]
    assert line["face"]["channel 0"] == 0.25


def spoil(packet: bytes, rng: random.Random) -> bytes:
    """Return a packet with bytes changed, cut, doubled, put in, or all of its own."""
    data = bytearray(packet)
    for _ in range(rng.choice([0, 1, 1, 2, 8])):
        at = rng.randrange(len(data) + 1)
        way = rng.randrange(5)
        if way == 0 and at < len(data):
            data[at] = rng.randrange(256)
        elif way == 1:
            del data[at:]
        elif way == 2:
            data[at:at] = rng.choice([b"\0", b"#bundle\0", b"/VMC/Ext/Bone/Pos\0\0\0", bytes(4), b"\xff" * 4])
        elif way == 3 and len(data) > 8:
            data[4 * (at // 4) : 4 * (at // 4) + 4] = struct.pack(">f", rng.choice([float("nan"), 1e38, -1.0, 0.0]))
        else:
            data += data[: rng.randrange(64)]
    return bytes(data) if rng.random() > 0.05 else rng.randbytes(rng.randrange(200))


@pytest.mark.slow
def test_a_hundred_thousand_hostile_packets_change_nothing_and_take_no_memory(packets):
    rng, assembly, onto = random.Random(1), FrameAssembly(), BonesOnBody(load_body(), np.zeros(10))
    small = [encode_bundle([encode_message("/VMC/Ext/T", [0.1 * k]), bone("Hips"), bone("Head")]) for k in range(50)]
    grown, named, poses = [], set(), 0
    for number in range(100_000):
        if number == 80_000:  # following memory makes all of it slow
            tracemalloc.start()
        source = rng.choice(packets) if number % 20 == 0 else rng.choice(small)
        sender = ("127.0.0.1", rng.choice([1, 1, 1, 2, number]))
        for frame in assembly.take(spoil(source, rng), sender, number * rng.choice([1e-3, 1e-3, 1e-2])):
            rotvec, transl = onto.pose(frame)
            assert np.isfinite(rotvec).all() and np.isfinite(transl).all()
            poses += 1
        named |= {kind for kind, _ in assembly.news}
        assembly.news.clear()
        if number >= 80_000 and number % 5000 == 4999:
            grown.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert poses > 1000 and grown[-1] < grown[0] + 50_000, (poses, grown)
    assert named == set(assembly.counts) >= {
        "packet_invalid", "bone_unknown", "numbers_impossible", "message_unknown", "second_sender", "packet_doubled",
    }  # fmt: skip


def kinds(found: Iterator[BoneFrame | EventLine], count: int) -> list[str]:
    """Return what comes next, by kind."""
    return [item["event"] if isinstance(item, dict) else "frame" for item in (next(found) for _ in range(count))]


def port_of(there: socket.socket) -> VmcAddress:
    return VmcAddress("127.0.0.1", there.getsockname()[1])


def test_a_port_that_is_taken_is_named_once_and_waited_for(monkeypatch, packets):
    monkeypatch.setattr("solver_backend.live.port._RETRY_S", 0.02)
    there = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    there.bind(("127.0.0.1", 0))
    address = port_of(there)
    found = listen(address, FrameAssembly())
    assert kinds(found, 1) == ["port_busy"]
    there.close()
    assert kinds(found, 1) == ["listening"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for packet in packets[:3]:
            sender.sendto(packet, ("127.0.0.1", address.port))
        lines: Iterator[Any] = pose_lines(found, BonesOnBody(load_body()))
        assert next(lines)["event"] == "shape"
        assert [next(lines)["frame"] for _ in range(3)] == [0, 1, 2]


def test_silence_is_named_once_and_its_end(monkeypatch, packets):
    monkeypatch.setattr("solver_backend.live.port.SILENT_S", 0.05)
    monkeypatch.setattr("solver_backend.live.port._LOOK_S", 0.02)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as spare:
        spare.bind(("127.0.0.1", 0))
        address = port_of(spare)
    found = listen(address, FrameAssembly())
    assert kinds(found, 2) == ["listening", "sender_silent"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for packet in packets[:2]:
            sender.sendto(packet, ("127.0.0.1", address.port))
        assert kinds(found, 2) == ["sender_back", "frame"]


def test_a_system_that_fails_is_named_once_and_tried_again(monkeypatch, packets):
    monkeypatch.setattr("solver_backend.live.port._LOOK_S", 0.001)
    answers = [OSError(errno.ENOBUFS, "no room"), OSError(errno.ENOBUFS, "no room"), ConnectionResetError(), packets[0]]

    class Failing:
        def recvfrom(self, _: int) -> tuple[bytes, tuple[str, int]]:
            answer = answers.pop(0) if answers else packets[1]
            if isinstance(answer, OSError):
                raise answer
            return answer, ME

    found = _received(Failing(), FrameAssembly())  # type: ignore[arg-type]
    assert kinds(found, 2) == ["port_broken", "frame"]
