"""glTF animations as clips: order of the tree, sampling in time, and files that are none."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, FileMissing
from solver_backend.geometry.rotations import log_so3
from solver_backend.io.motions.recorded_clip import body_rotations
from training.data.sources.clips import gltf_clips, read_archive_clips


def quat_z(angle: float) -> list[float]:
    return [0.0, 0.0, float(np.sin(angle / 2)), float(np.cos(angle / 2))]


def glb(animations: dict[str, tuple[list[float], list[float]]]) -> bytes:
    """Two nodes, the child stored first; each animation turns the child about z."""
    values, views, accessors, listed = b"", [], [], []
    for name, (times, angles) in animations.items():
        for array, kind in ((np.array(times), "SCALAR"), (np.array([quat_z(a) for a in angles]), "VEC4")):
            raw = array.astype("<f4").tobytes()
            views.append({"byteOffset": len(values), "byteLength": len(raw)})
            accessors.append({"bufferView": len(views) - 1, "count": len(array), "type": kind, "componentType": 5126})
            values += raw
        sampler = {"input": len(accessors) - 2, "output": len(accessors) - 1}
        target = {"node": 0, "path": "rotation"}
        listed.append({"name": name, "samplers": [sampler], "channels": [{"sampler": 0, "target": target}]})
    nodes = [{"name": "child"}, {"name": "parent", "children": [0], "rotation": quat_z(0.3)}]
    content = {"nodes": nodes, "animations": listed, "accessors": accessors, "bufferViews": views}
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    header = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(values))
    return (
        header + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(values), b"BIN\0") + values
    )  # fmt: skip


def test_rotations_are_sampled_in_time() -> None:
    (clip,) = gltf_clips(glb({"T-Pose": ([0.0], [0.5]), "Turn": ([0.0, 0.1, 0.2], [0.0, 1.0, -1.0])}))
    assert clip.name == "Turn" and clip.joint_names == ["parent", "child"] and clip.fps == 30.0
    np.testing.assert_array_equal(clip.parents, [-1, 0])
    np.testing.assert_allclose(clip.tpose_rotvec[:, 2], [0.3, 0.5], atol=1e-6)
    expected = np.interp(np.arange(7) / 30.0, [0.0, 0.1, 0.2], [0.0, 1.0, -1.0])
    np.testing.assert_allclose(clip.rotvec[:, 1, 2], expected, atol=1e-6)
    np.testing.assert_allclose(clip.rotvec[:, 0, 2], 0.3, atol=1e-6)


def test_files_without_tpose_give_no_clips() -> None:
    assert gltf_clips(glb({"Turn": ([0.0, 0.1], [0.0, 1.0])})) == []


def test_bad_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileDamaged, match=r"not a glTF binary file.*x\.glb"):
        gltf_clips(b"something else entirely", "x.glb")
    path = tmp_path / "clips.tar.xz"
    with pytest.raises(FileMissing, match="clips.tar.xz"):
        read_archive_clips(path)
    path.write_bytes(b"no archive")
    with pytest.raises(FileDamaged, match="clips.tar.xz"):
        read_archive_clips(path)


@pytest.mark.shared
def test_keyed_people_sit_and_lie(shared_data: Path) -> None:
    clips = {clip.name: clip for clip in read_archive_clips(shared_data / "mesh2motion_cc0.tar.xz")}
    assert {"Roll", "Sitting_Idle_Loop", "Swim_Fwd_Loop", "Walk_Loop"} <= clips.keys()
    sitting = log_so3(body_rotations(clips["Sitting_Idle_Loop"])[:, [1, 2, 4, 5]])[..., 0]
    assert (np.abs(np.degrees(sitting[:, :2].mean(0)) + 85) < 25).all()
    assert (np.abs(np.degrees(sitting[:, 2:].mean(0)) - 85) < 25).all()
    lying = body_rotations(clips["Death01"])[-1, 0]
    assert abs(lying[1, 1]) < 0.3
