"""VRM Animation, read as VRM's players read it: by humanoid bone, from the T-pose of the nodes at rest."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from scipy.spatial.transform import Rotation

from blender_addon._exchange.joint_sets import SMPL_JOINTS
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.export.take import take_of
from blender_addon.export.write import export_take
from blender_addon.scene.bake import BakedTake

_LIMBS = ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")
REQUIRED = {"hips", "spine", "head", *(f"{side}{limb}" for side in ("left", "right") for limb in _LIMBS)}
"""Bones that VRM 1.0 requires of a humanoid."""


class Player:
    """A glTF scene that is posed at a frame."""

    def __init__(self, path: Path) -> None:
        content = path.read_bytes()
        magic, version, whole, length, kind = struct.unpack("<4sIII4s", content[:20])
        assert (magic, version, whole, kind) == (b"glTF", 2, len(content), b"JSON") and length % 4 == 0
        self.scene: dict[str, Any] = json.loads(content[20 : 20 + length])
        self._binary = content[28 + length :]
        self.nodes = self.scene["nodes"]
        self._parents = {child: n for n, node in enumerate(self.nodes) for child in node.get("children", ())}

    def numbers(self, accessor: int) -> np.ndarray:
        found = self.scene["accessors"][accessor]
        view = self.scene["bufferViews"][found["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[found["type"]]
        start = view.get("byteOffset", 0) + found.get("byteOffset", 0)
        return np.frombuffer(self._binary, "<f4", found["count"] * width, start).reshape(-1, width).astype(float)

    def pose(self, frame: int) -> None:
        [animation] = self.scene["animations"]
        for channel in animation["channels"]:
            values = self.numbers(animation["samplers"][channel["sampler"]]["output"])
            self.nodes[channel["target"]["node"]][channel["target"]["path"]] = values[frame].tolist()

    def world(self, number: int) -> tuple[Rotation, np.ndarray]:
        node = self.nodes[number]
        turn = Rotation.from_quat(node.get("rotation", (0, 0, 0, 1)))
        place = np.array(node.get("translation", (0.0, 0.0, 0.0)))
        if number not in self._parents:
            return turn, place
        above, at = self.world(self._parents[number])
        return above * turn, at + above.apply(place)


def test_a_player_of_vrm_animations_finds_the_take(take: BakedTake, tmp_path: Path) -> None:
    path = tmp_path / "der Gang.vrma"
    scene = bpy.context.scene
    joints = np.stack([evaluated_joints(scene, take.armature, frame) for frame in (1, 31, 60)])
    take.action.name = "Anna Take 02"
    export_take(take_of(scene, take.armature), "vrma", path)
    assert [item.name for item in tmp_path.iterdir()] == [path.name]
    player = Player(path)
    extension = player.scene["extensions"]["VRMC_vrm_animation"]
    assert extension["specVersion"] == "1.0" and "VRMC_vrm_animation" in player.scene["extensionsUsed"]
    bones = {name: bone["node"] for name, bone in extension["humanoid"]["humanBones"].items()}
    assert bones.keys() >= REQUIRED and not player.scene.get("meshes")
    [animation] = player.scene["animations"]
    assert animation["name"] == "Anna Take 02"
    for sampler in animation["samplers"]:
        assert np.allclose(player.numbers(sampler["input"])[:, 0], np.arange(60) / 30.0, atol=1e-6)
    assert {c["target"]["path"] for c in animation["channels"]} == {"rotation", "translation"}

    places = {name: player.world(node)[1] for name, node in bones.items()}  # at rest: the T-pose, facing +Z
    for side, way in (("left", 1.0), ("right", -1.0)):
        arm = places[f"{side}Hand"] - places[f"{side}UpperArm"]
        assert np.allclose(arm / np.linalg.norm(arm), [way, 0.0, 0.0], atol=1e-5)
        leg = places[f"{side}Foot"] - places[f"{side}UpperLeg"]
        assert np.allclose(leg / np.linalg.norm(leg), [0.0, -1.0, 0.0], atol=1e-5)

    columns = {"hips": 0, "leftHand": 20, "rightFoot": 8, "head": 15, "leftToes": 10}
    swap = Rotation.from_matrix([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    first: dict[str, Rotation] = {}
    for frame, expected in zip((0, 30, 59), joints, strict=True):
        player.pose(frame)
        scene.frame_set(1 + frame)
        for bone, joint in columns.items():
            shown = take.armature.matrix_world @ take.armature.pose.bones[SMPL_JOINTS[joint]].matrix
            ours = swap * Rotation.from_matrix(np.array(shown)[:3, :3]) * swap.inv()
            between = player.world(bones[bone])[0].inv() * ours  # the axes of the bone differ, but stay as they are
            assert (first.setdefault(bone, between).inv() * between).magnitude() < 2e-3, (frame, bone)
        for bone, joint in columns.items():
            x, y, z = expected[joint]
            assert np.abs(player.world(bones[bone])[1] - (x, z, -y)).max() < 1e-3, (frame, bone)
