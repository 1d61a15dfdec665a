"""Animations of a glTF binary file as recorded clips."""

from __future__ import annotations

import json
import struct
import tarfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged, FileMissing
from solver_backend.geometry.interpolation import slerp
from solver_backend.geometry.rotations import rotvec_from_quat
from solver_backend.io.motions.recorded_clip import RecordedClip

TPOSE = "T-Pose"
"""Name of the animation that holds the T-pose."""
_FPS = 30.0
"""Frames a second at which curves are read; chosen by hand."""
_COMPONENTS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
"""Numbers of an element by its type (glTF 2.0, section 5.1.3)."""


@dataclass(frozen=True)
class _Scene:
    """A file's JSON and its binary chunk."""

    content: dict[str, Any]
    buffer: bytes

    def array(self, number: int) -> np.ndarray:
        """Return a float accessor, (count, components)."""
        accessor = self.content["accessors"][number]
        view = self.content["bufferViews"][accessor["bufferView"]]
        width = _COMPONENTS[accessor["type"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        values = np.frombuffer(self.buffer, dtype="<f4", count=accessor["count"] * width, offset=start)
        return values.reshape(-1, width).astype(np.float64)


def read_archive_clips(archive: Path) -> list[RecordedClip]:
    """Read every animation of the ``.glb`` files in a tar archive whose file has a T-pose, in order of name.

    Raises:
        FileMissing: there is no such archive.
        FileDamaged: it cannot be read.
    """
    if not archive.is_file():
        raise FileMissing("The archive of animations is missing.", where=archive.name)
    clips: list[RecordedClip] = []
    try:
        with tarfile.open(archive) as tar:
            members = sorted((m for m in tar if m.isfile() and m.name.endswith(".glb")), key=lambda m: m.name)
            for member in members:
                stream = tar.extractfile(member)
                clips += gltf_clips(stream.read() if stream else b"", member.name)
    except (tarfile.TarError, EOFError, OSError) as error:
        raise FileDamaged("The archive of animations cannot be read.", where=archive.name) from error
    return clips


def gltf_clips(data: bytes, where: str = "") -> list[RecordedClip]:
    """Return the animations of a ``.glb`` at 30 Hz; none if no animation is called ``T-Pose``.

    Raises:
        FileDamaged: the bytes are no glTF binary file.
    """
    scene = _parse(data, where)
    nodes, animations = scene.content["nodes"], scene.content.get("animations", [])
    order, parents = _tree(nodes)
    names = [str(nodes[i].get("name", f"node{i}")) for i in order]
    rest = np.array([nodes[i].get("rotation", (0.0, 0.0, 0.0, 1.0)) for i in order], dtype=np.float64)
    rotvecs = {str(a["name"]): _rotvecs(scene, a, order, rest) for a in animations}
    if TPOSE not in rotvecs:
        return []
    tpose = rotvecs.pop(TPOSE)[0]
    return [RecordedClip(name, names, parents, rotvec, tpose, _FPS) for name, rotvec in sorted(rotvecs.items())]


def _parse(data: bytes, where: str) -> _Scene:
    try:
        magic, _, _, length, kind = struct.unpack("<4sII I4s", data[:20])
        if magic != b"glTF" or kind != b"JSON":
            raise ValueError("no glTF header")
        return _Scene(json.loads(data[20 : 20 + length]), data[28 + length :])
    except (struct.error, ValueError) as error:
        raise FileDamaged("The file is not a glTF binary file.", where=where) from error


def _tree(nodes: list[dict[str, Any]]) -> tuple[list[int], np.ndarray]:
    """Return node numbers with parents before children, and each one's parent's place (-1 at roots)."""
    parent_of = {child: i for i, node in enumerate(nodes) for child in node.get("children", ())}
    order = [i for i in range(len(nodes)) if i not in parent_of]
    for i in order:
        order.extend(nodes[i].get("children", ()))
    place = {node: number for number, node in enumerate(order)}
    return order, np.array([place[parent_of[i]] if i in parent_of else -1 for i in order])


def _rotvecs(scene: _Scene, animation: dict[str, Any], order: list[int], rest: np.ndarray) -> np.ndarray:
    """Return (F, J, 3) local rotation vectors at 30 Hz; nodes without a channel keep their rest rotation."""
    channels = {
        c["target"]["node"]: animation["samplers"][c["sampler"]]
        for c in animation["channels"]
        if c["target"]["path"] == "rotation"
    }
    times = {node: scene.array(sampler["input"])[:, 0] for node, sampler in channels.items()}
    first, last = min(t[0] for t in times.values()), max(t[-1] for t in times.values())
    at = first + np.arange(round((last - first) * _FPS) + 1) / _FPS
    xyzw = np.repeat(rest[None], len(at), axis=0)
    for number, node in enumerate(order):
        if node in channels:
            xyzw[:, number] = _sampled(times[node], scene.array(channels[node]["output"]), at)
    return rotvec_from_quat(xyzw[..., [3, 0, 1, 2]])


def _sampled(times: np.ndarray, quats: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return quaternions of any component order at other times, along the shorter way."""
    before = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 1)
    after = np.minimum(before + 1, len(times) - 1)
    gap = times[after] - times[before]
    share = np.clip(np.where(gap > 0, (at - times[before]) / np.where(gap > 0, gap, 1.0), 0.0), 0.0, 1.0)
    unit = quats / np.linalg.norm(quats, axis=-1, keepdims=True)
    a, b = unit[before], unit[after]
    return slerp(a, np.where((a * b).sum(-1, keepdims=True) < 0, -b, b), share)
