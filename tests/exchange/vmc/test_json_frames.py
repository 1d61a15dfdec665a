"""JSON for Unreal: a receiver that composes the bones in its own axes finds the joints of the motion."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solver_backend.cli.main import main
from solver_backend.exchange.vmc.json_frames import JsonFrames
from solver_backend.io.native.motion_file import write_motion
from solver_backend.live.sending import rest_joints
from tests.support.short_motion import short_motion
from tests.support.vmc_receiver import Receiver


def _places(packet: bytes) -> dict[str, np.ndarray]:
    """Return the world places of all bones in Unreal's centimetres, by its rule parent * child."""
    [(subject, bones)] = json.loads(packet).items()
    assert subject == "manifold"
    turns, places = list[Rotation](), list[np.ndarray]()
    for number, bone in enumerate(bones):
        own, place, parent = Rotation.from_quat(bone["Rotation"]), np.array(bone["Location"]), bone["Parent"]
        assert parent < number and bone["Scale"] == [1, 1, 1] and (parent < 0) == (number == 0)
        turns.append(own if parent < 0 else turns[parent] * own)
        places.append(place if parent < 0 else places[parent] + turns[parent].apply(place))
    return {bone["Name"]: place for bone, place in zip(bones, places, strict=True)}


def test_a_receiver_finds_the_joints(tmp_path: Path) -> None:
    motion, receiver = short_motion(8), Receiver()
    write_motion(tmp_path / "walk.npz", motion)
    address = receiver.address.replace("vmc://", "json://")
    lines = str(tmp_path / "poses.jsonl")
    assert main(["live stream", str(tmp_path / "walk.npz"), "--send", address, "--lines", lines]) == 0
    packets = receiver.close()
    assert len(packets) == 8
    for packet, joints in zip(packets, motion.joints, strict=True):
        for name, place in zip(motion.body_layout.joints, joints, strict=True):
            assert _places(packet)[name] == pytest.approx(100 * place * [1, -1, 1], abs=0.05)


def test_a_body_at_rest_stands_and_faces_y() -> None:
    motion = short_motion(1)
    frames = JsonFrames(motion.body_layout, rest_joints(motion))
    standing = frames.encode(0.0, np.array([[np.pi / 2, 0.0, 0.0]]), np.zeros(3))
    bones = json.loads(standing)["manifold"]
    assert np.allclose([bone["Rotation"] for bone in bones], [0.0, 0.0, 0.0, 1.0], atol=1e-6)
    places = _places(standing)
    assert places["head"][2] > places["pelvis"][2] + 40
    assert places["left_foot"][1] > places["left_ankle"][1] + 5 and places["left_wrist"][0] > 30
    assert len(standing) < 65507
