"""BVH files give the skeleton and the motion that other programs see in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, JobInvalid, MotionInvalid, NonFiniteData
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.motions.bvh import bvh_skeleton, read_bvh

HEAD = """HIERARCHY
ROOT Hips
{{
  OFFSET 1 2 3
  CHANNELS 6 Xposition Yposition Zposition {root}
  JOINT Left Knee {{
    OFFSET 0 -40 0
    CHANNELS {knee}
    End Site
    {{
      OFFSET 0 -40 5
    }}
  }}
  JOINT Spine
  {{
    OFFSET 0 50 0
    CHANNELS 0
    JOINT Head
    {{
      OFFSET 0 20 0
      CHANNELS 3 Yrotation Xrotation Zrotation
      End Site
      {{ OFFSET 0 10 0 }}
    }}
  }}
}}
MOTION
Frames: {frames}
Frame Time: 0.02
"""
ROOT = "Zrotation Xrotation Yrotation"
KNEE = "3 Xrotation Zrotation Yrotation"


def write(path: Path, rows: Sequence[Sequence[float]], root: str = ROOT, knee: str = KNEE, ending: str = "\n") -> Path:
    text = HEAD.format(root=root, knee=knee, frames=len(rows))
    text += "\n".join(" ".join(map(str, row)) for row in rows) + "\n"
    path.write_bytes(text.replace("\n", ending).encode())
    return path


def turned(order: str, degrees: list[float]) -> np.ndarray:
    R = np.eye(3)
    for axis, angle in zip(order, degrees, strict=True):
        R = R @ np.asarray(exp_so3(np.radians(angle) * np.eye(3)["XYZ".index(axis)]))
    return R


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
def test_any_order_of_rotations(tmp_path: Path, order: str, ending: str) -> None:
    row = [10, 100, -20, 30, 40, 50, -25, 10, 5, 60, -70, 80]
    root = " ".join(f"{axis}rotation" for axis in order)
    path = write(tmp_path / "x.bvh", [row, [0] * 12], root, KNEE, ending)
    clip = read_bvh(path, metres_per_unit=0.01, up_axis="z")
    assert clip.names == ("Hips", "Left Knee", "Spine", "Head")
    assert clip.parents.tolist() == [-1, 0, 0, 2]
    assert clip.fps == pytest.approx(50)
    np.testing.assert_allclose(clip.rotations[0, 0], turned(order, [30, 40, 50]), atol=1e-12)
    np.testing.assert_allclose(clip.rotations[0, 1], turned("XZY", [-25, 10, 5]), atol=1e-12)
    np.testing.assert_allclose(clip.rotations[0, 3], turned("YXZ", [60, -70, 80]), atol=1e-12)
    np.testing.assert_array_equal(clip.rotations[:, 2], np.tile(np.eye(3), (2, 1, 1)))
    np.testing.assert_allclose(clip.root_positions, [[0.1, 1.0, -0.2], [0, 0, 0]])
    np.testing.assert_allclose(clip.offsets, [[0.01, 0.02, 0.03], [0, -0.4, 0], [0, 0.5, 0], [0, 0.2, 0]])
    np.testing.assert_allclose(clip.end_offsets["Left Knee"], [0, -0.4, 0.05])
    np.testing.assert_allclose(clip.end_offsets["Head"], [0, 0.1, 0])
    R, p = clip.rotations[0, 0], clip.positions()
    np.testing.assert_allclose(p[0, 3], clip.root_positions[0] + R @ [0, 0.7, 0], atol=1e-12)
    np.testing.assert_allclose(p[1], [[0, 0, 0], [0, -0.4, 0], [0, 0.5, 0], [0, 0.7, 0]], atol=1e-12)


def test_y_up_becomes_z_up(tmp_path: Path) -> None:
    path = write(tmp_path / "x.bvh", [[10, 100, -20, 30, 40, 50, -25, 10, 5, 60, -70, 80]])
    raw, clip = read_bvh(path, up_axis="z").positions(), read_bvh(path).positions()
    np.testing.assert_allclose(clip, np.stack([raw[..., 0], -raw[..., 2], raw[..., 1]], axis=-1), atol=1e-12)
    with pytest.raises(JobInvalid, match="Unknown up axis"):
        read_bvh(path, up_axis="up")


def test_position_channels_of_joints_replace_their_offsets(tmp_path: Path) -> None:
    knee = "6 Xposition Yposition Zposition Xrotation Zrotation Yrotation"
    path = write(tmp_path / "x.bvh", [[0] * 6 + [1, -32, 3, 0, 0, 0] + [0] * 3], knee=knee)
    clip = read_bvh(path, metres_per_unit=1.0, up_axis="z")
    np.testing.assert_allclose(clip.positions()[0], [[0, 0, 0], [1, -32, 3], [0, 50, 0], [0, 70, 0]])


def test_position_channels_that_are_small_shifts_are_added(tmp_path: Path) -> None:
    knee = "6 Xposition Yposition Zposition Xrotation Zrotation Yrotation"
    path = write(tmp_path / "x.bvh", [[0] * 6 + [1, -2, 3, 0, 0, 0] + [0] * 3], knee=knee)
    clip = read_bvh(path, metres_per_unit=1.0, up_axis="z")
    np.testing.assert_allclose(clip.positions()[0], [[0, 0, 0], [1, -42, 3], [0, 50, 0], [0, 70, 0]])


@pytest.mark.parametrize(
    ("old", "new", "error", "text"),
    [
        ("HIERARCHY", "XIERARCHY", FileDamaged, "HIERARCHY and MOTION are expected"),
        ("MOTION", "NOTION", FileDamaged, "HIERARCHY and MOTION are expected"),
        ("Frames: 2", "Frames: 3", FileDamaged, "contains 24 numbers, but 3 frames of 12 channels need 36"),
        ("Frames: 2", "Frames: x", FileDamaged, "MOTION is truncated or contains something other than numbers"),
        ("Frame Time: 0.02", "Frame Time: 0", FileDamaged, "2 frames of 0 s"),
        ("Frame Time: 0.02", "", FileDamaged, "MOTION is truncated"),
        ("OFFSET 0 50 0", "OFFSET 0 50", FileDamaged, r"'OFFSET 0 50' in HIERARCHY is not understood: three numbers"),
        ("CHANNELS 3 Yrotation", "CHANNELS 2 Yrotation", FileDamaged, "channels are Xposition"),
        ("CHANNELS 3 Yrotation", "CHANNELS 3 Wrotation", FileDamaged, "channels are Xposition"),
        ("{ OFFSET 0 10 0 }", "{ OFFSET 0 10 0", FileDamaged, "closed brackets"),
        ("JOINT Spine", "JOINT {", FileDamaged, "a joint needs a name"),
        ("OFFSET 0 50 0", "OFFSET 0 1e30 0", NonFiniteData, "OFFSET contains 1e"),
        ("0.5", "oops", FileDamaged, "could not convert"),
        ("0.5", "nan", NonFiniteData, "NaN or infinite"),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, old: str, new: str, error: type[Exception], text: str) -> None:
    path = write(tmp_path / "x.bvh", [[0.5] * 12, [1] * 12])
    content = path.read_text()
    assert old in content
    path.write_text(content.replace(old, new, 1))
    with pytest.raises(error, match=text):
        read_bvh(path)


def test_truncation_is_named(tmp_path: Path) -> None:
    content = write(tmp_path / "x.bvh", [[0.5] * 12, [1] * 12]).read_text()
    for size in range(0, len(content) - 3, 11):
        (tmp_path / "cut.bvh").write_text(content[:size])
        with pytest.raises(FileDamaged):
            read_bvh(tmp_path / "cut.bvh")


@pytest.mark.shared
@pytest.mark.parametrize(
    ("bvh", "npz", "unit"),
    [
        ("cmu_mb2_02_01", "mb2/02_01", 0.0564444), ("cmu_mb2_09_01", "mb2/09_01", 0.0564444),
        ("cmu_max_131_03", "max/131_03", 0.0564444), ("cmu_daz_martial_07", "daz/martial_07", 0.01),
    ],
)  # fmt: skip
def test_recordings_agree_with_another_reader(shared_data: Path, bvh: str, npz: str, unit: float) -> None:
    clip = read_bvh(shared_data / "bvh_samples" / f"{bvh}.bvh", metres_per_unit=unit, up_axis="z")
    with np.load(shared_data / "motion_cmu" / f"{npz}.npz") as data:
        names, offsets = data["names"].tolist(), data["offsets"]
        rotations, root = np.asarray(exp_so3(data["rotvec"].astype(float))), data["root"]
    joints = [i for i, name in enumerate(names) if not name.endswith("_end")]
    here = [clip.names.index(names[i]) for i in joints]
    assert len(joints) > 20
    np.testing.assert_allclose(clip.offsets[here][1:], offsets[joints][1:], atol=2e-6)
    for i in set(range(len(names))) - set(joints):
        np.testing.assert_allclose(clip.end_offsets[names[i][:-4]], offsets[i], atol=2e-6)
    # The other reader keeps every second frame, from the T-pose or the frame after it.
    start = next(k for k in range(4) if np.abs(clip.root_positions[k::2][: len(root)] - root).max() < 1e-4)
    np.testing.assert_allclose(clip.rotations[start::2][: len(root), here], rotations[:, joints], atol=2e-5)


@pytest.mark.shared
def test_poses_with_positions_in_every_joint(shared_data: Path) -> None:
    path = shared_data / "poses_makehuman_cc0" / "makehuman_data_poses_tpose.bvh"
    clip = read_bvh(path, metres_per_unit=0.1, up_axis="z")
    points = clip.positions()[0]
    assert 1.4 < np.ptp(points[:, 2]) < 1.9
    left, right = (points[clip.names.index(f"wrist.{side}")] for side in "LR")
    np.testing.assert_allclose(left, right * [-1, 1, 1], atol=0.01)
    assert np.linalg.norm(left - right) > 1.0


def test_a_single_joint(tmp_path: Path) -> None:
    path = tmp_path / "one.bvh"
    head = "HIERARCHY\nROOT Hips {\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n}\n"
    path.write_text(head + "MOTION\nFrames: 2\nFrame Time: 0.1\n1 2 3 4 5 6\n")
    np.testing.assert_allclose(read_bvh(path).positions()[:, 0], [[0.01, -0.03, 0.02], [0.04, -0.06, 0.05]])


def test_a_joint_may_not_be_called_as_the_end_of_another(tmp_path: Path) -> None:
    """Names are what a skeleton's parents are known by: two of one name made a ring of them."""
    path = write(tmp_path / "x.bvh", [[0.5] * 12, [1] * 12])
    clip = read_bvh(path)
    names = (f"{next(iter(clip.end_offsets))} end", *clip.names[1:])
    with pytest.raises(MotionInvalid, match="Several joints are called"):
        bvh_skeleton(replace(clip, names=names))
