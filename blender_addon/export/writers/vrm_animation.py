"""Write VRM Animation files: glTF with a T-pose as rest pose and humanoid bones (VRMC_vrm_animation 1.0)."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..._exchange.progress import Progress
from ..._exchange.so3 import matrix_from_quat, quat_multiply
from ..._exchange.vmc.humanoid import BONE_OF, t_pose, unturned
from ...conventions.skeleton import layout_of
from ..take import ExportTake
from .blender_exporters import export_gltf

_EXTENSION = "VRMC_vrm_animation"
_THUMBS = {"ThumbProximal": "ThumbMetacarpal", "ThumbIntermediate": "ThumbProximal"}  # From Unity's to VRM 1.0's names.
_WXYZ, _XYZW = [3, 0, 1, 2], [1, 2, 3, 0]
_JSON_CHUNK = 20  # Bytes before the JSON text in binary glTF: the header, and the first chunk's length and type.


def export_vrma(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write a take as a VRM Animation, which has no mesh."""
    plain = path.with_suffix(".glb")
    export_gltf(plain, replace(take, meshes=()), progress)
    path.write_bytes(as_vrm_animation(plain.read_bytes()))
    plain.unlink()


def as_vrm_animation(content: bytes) -> bytes:
    """Convert binary glTF with the add-on's skeleton to a VRM Animation.

    The rest pose becomes a T-pose. This does not change the animation, because animated rotations replace the rest
    rotations. Only rotations of humanoid bones and the translation of the hips remain animated.
    """
    (length,) = struct.unpack("<I", content[12:16])
    scene = json.loads(content[_JSON_CHUNK : _JSON_CHUNK + length])
    nodes = scene["nodes"]
    numbers = {node["name"]: number for number, node in enumerate(nodes)}
    bones = {_vrm_name(bone): numbers[joint] for joint, bone in BONE_OF.items() if joint in numbers}
    _rest_in_t_pose(nodes, numbers)
    kept = {(number, "rotation") for number in bones.values()} | {(bones["hips"], "translation")}
    for animation in scene["animations"]:
        targets = ((channel, channel["target"]) for channel in animation["channels"])
        animation["channels"] = [c for c, target in targets if (target.get("node"), target["path"]) in kept]
    humanoid = {"humanBones": {name: {"node": number} for name, number in bones.items()}}
    scene["extensions"] = {**scene.get("extensions", {}), _EXTENSION: {"specVersion": "1.0", "humanoid": humanoid}}
    scene["extensionsUsed"] = [*scene.get("extensionsUsed", []), _EXTENSION]
    text = json.dumps(scene, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    rest = content[_JSON_CHUNK + length :]
    header = struct.pack("<4sII", b"glTF", 2, _JSON_CHUNK + len(text) + len(rest))
    return header + struct.pack("<I4s", len(text), b"JSON") + text + rest


def _vrm_name(bone: str) -> str:
    for unity, vrm in _THUMBS.items():
        if bone.endswith(unity):
            bone = bone.removesuffix(unity) + vrm
            break
    return bone[0].lower() + bone[1:]


def _rest_in_t_pose(nodes: list[dict[str, Any]], numbers: dict[str, int]) -> None:
    """Rotate the nodes' rest pose to a T-pose: world rotations G become ``T G``, with T from ``t_pose``."""
    parents = {child: number for number, node in enumerate(nodes) for child in node.get("children", ())}
    layout = layout_of(numbers)
    turned, places = dict[int, np.ndarray](), dict[int, np.ndarray]()

    def world(number: int) -> tuple[np.ndarray, np.ndarray]:
        if number not in turned:
            node = nodes[number]
            quat = np.array(node.get("rotation", (0.0, 0.0, 0.0, 1.0)))[_WXYZ]
            place = np.array(node.get("translation", (0.0, 0.0, 0.0)))
            if number in parents:
                above, at = world(parents[number])
                quat, place = quat_multiply(above, quat), at + matrix_from_quat(above) @ place
            turned[number], places[number] = quat, place
        return turned[number], places[number]

    joints = [numbers[joint] for joint in layout.joints]
    rest = np.stack([world(number)[1] for number in joints])
    tall = {n: quat_multiply(turn, turned[n]) for n, turn in zip(joints, t_pose(layout, rest), strict=True)}
    for number in joints:
        above = tall.get(parents[number], turned[parents[number]]) if number in parents else None
        own = tall[number] if above is None else quat_multiply(unturned(above), tall[number])
        nodes[number]["rotation"] = own[_XYZW].tolist()
