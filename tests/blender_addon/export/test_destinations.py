"""What each program gets: unit, root motion, fingers, a skeleton without scale, and Blender the rig itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.body_layout import SMPL_HANDS
from blender_addon._exchange.so3 import matrix_from_rotvec, rotvec_from_matrix
from blender_addon.animation.deviation import evaluated_joints, evaluated_vertices
from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.errors import NothingToExport
from blender_addon.export.formats import DESTINATIONS, FORMATS, FileLayout
from blender_addon.export.take import ExportTake, take_of
from blender_addon.export.write import export_take
from blender_addon.scene.bake import BakedTake, BakeSettings, bake_take
from tests.support.moving_fingers import FRAMES, moving_fingers

WALK = np.linspace(0.0, 3.0, 60)[:, None] * [0.6, -0.8, 0.0]  # Travel over the ground, metres.


@pytest.fixture
def walk(scene: bpy.types.Scene, files: Any) -> BakedTake:
    """Return a take that travels five metres and turns by a quarter."""
    turned = files.motion.rotvec.copy()
    up = np.linspace(0.0, np.pi / 2, 60)
    R = matrix_from_rotvec(up[:, None] * [0.0, 0.0, 1.0]) @ matrix_from_rotvec(turned[:, 0])
    turned[:, 0] = rotvec_from_matrix(R)
    return bake_take(scene, replace(files.motion, rotvec=turned, transl=files.motion.transl + WALK), files.body)


def written(take: BakedTake, name: str, folder: Path) -> tuple[Path, np.ndarray]:
    """Write a take for a program, and return the file and the joints as they were, (60, 24, 3) metres."""
    scene, program = bpy.context.scene, DESTINATIONS[name]
    joints = np.stack([evaluated_joints(scene, take.armature, frame) for frame in range(1, 61)])
    path = folder / f"der Gang{FORMATS[program.format].suffix}"
    export_take(replace(take_of(scene, take.armature), layout=program.layout), program.format, path)
    return path, joints


def read(path: Path) -> bpy.types.Object:
    """Read a file into an empty scene and return its armature."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.scene.render.fps = 30
    if path.suffix == ".fbx":
        bpy.ops.import_scene.fbx(filepath=str(path), automatic_bone_orientation=False, ignore_leaf_bones=False)
    else:
        bpy.ops.import_scene.gltf(filepath=str(path))
    [rig] = [obj for obj in bpy.data.objects if obj.type == "ARMATURE"]
    return rig


def places(rig: bpy.types.Object, bone: str) -> np.ndarray:
    """Return (60, 3) world places of a bone's head on the clip's frames."""
    scene, start = bpy.context.scene, rig.animation_data.action.frame_range[0]
    found = []
    for frame in range(60):
        scene.frame_set(round(start) + frame)
        found.append(tuple(rig.matrix_world @ rig.pose.bones[bone].head))
    return np.array(found)


def skin_turns(rig: bpy.types.Object, first: int) -> dict[str, np.ndarray]:
    """Return how each bone turns its skin from rest in three frames, (3, 3, 3) in the world, whatever its axes are."""
    world, found = rig.matrix_world.to_quaternion().to_matrix(), dict[str, list[np.ndarray]]()
    for frame in (first, first + 30, first + 59):
        bpy.context.scene.frame_set(frame)
        for bone in rig.pose.bones:
            turn = bone.matrix.to_quaternion() @ bone.bone.matrix_local.to_quaternion().inverted()
            found.setdefault(bone.name, []).append(np.array(world @ turn.to_matrix() @ world.transposed()))
    return {name: np.stack(turns) for name, turns in found.items()}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["unreal", "unity", "maya", "godot", "three.js"])
def test_the_motion_arrives_as_it_was_with_no_scale_on_the_skeleton(walk: BakedTake, tmp_path: Path, name: str) -> None:
    before = skin_turns(walk.armature, 1)
    path, joints = written(walk, name, tmp_path)
    rig = read(path)
    after = skin_turns(rig, round(rig.animation_data.action.frame_range[0]))
    assert len(before.keys() & after.keys()) >= 22 and after.keys() - before.keys() <= {"root"}
    assert max(np.abs(after[bone] - before[bone]).max() for bone in after.keys() - {"root"}) < 2e-3
    assert np.abs(places(rig, "left_wrist") - joints[:, 20]).max() < 2e-3
    assert np.abs(places(rig, "right_foot") - joints[:, 11]).max() < 2e-3
    scale = 0.01 if DESTINATIONS[name].layout.unit == "cm" else 1.0
    assert np.allclose(rig.matrix_world.to_scale(), scale, rtol=1e-4), "the reader's own conversion alone"
    assert np.isclose(rig.data.bones["pelvis"].head_local.length * scale, 0.93, atol=0.15)
    assert np.isclose(np.ptp(rig.animation_data.action.frame_range), 59, atol=0.01), "at 30 frames per second"
    up, head = (
        rig.matrix_world @ rig.data.bones["head"].head_local,
        rig.matrix_world @ rig.data.bones["pelvis"].head_local,
    )
    left = rig.matrix_world @ rig.data.bones["left_wrist"].head_local
    assert up.z > head.z + 0.4 and left.x > 0.4, "at rest it stands and faces -Y"


@pytest.mark.parametrize("name", ["unreal", "godot"])
def test_a_root_bone_carries_the_travel(walk: BakedTake, tmp_path: Path, name: str) -> None:
    path, _ = written(walk, name, tmp_path)
    rig = read(path)
    assert rig.data.bones["root"].parent is None and rig.data.bones["pelvis"].parent == rig.data.bones["root"]
    root = places(rig, "root")
    assert np.abs(root[:, 2]).max() < 1e-3, "it stays on the ground"
    assert np.linalg.norm(root[-1] - root[0]) > 2.5
    assert np.linalg.norm((places(rig, "pelvis") - root)[:, :2], axis=1).max() < 0.25
    if name == "unreal":
        assert rig.name == "Armature", "Unreal's importer passes over an object of this name"


def test_in_place_leaves_the_travel_out(walk: BakedTake, tmp_path: Path) -> None:
    scene, path = bpy.context.scene, tmp_path / "place.fbx"
    export_take(replace(take_of(scene, walk.armature), layout=FileLayout(root="place")), "fbx", path)
    pelvis = places(read(path), "pelvis")
    assert np.abs(pelvis[:, :2]).max() < 0.25 and pelvis[:, 2].min() > 0.3


@pytest.mark.slow
def test_everything_of_the_scene_stays_and_the_console_quiet(
    walk: BakedTake, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    other = bpy.data.objects.new("Armature", bpy.data.armatures.new("Armature"))
    bpy.context.scene.collection.objects.link(other)
    before = {obj.name: obj for obj in bpy.data.objects}
    actions, files_of_take = set(bpy.data.actions), dict(walk.action.items())
    for name in DESTINATIONS:
        written(walk, name, tmp_path / name)
    assert "Failed to add relation" not in "".join(capfd.readouterr()), "constraints go before their bones"
    assert {obj.name: obj for obj in bpy.data.objects} == before
    assert set(bpy.data.actions) == actions and list(dict(walk.action.items())) == list(files_of_take)


def test_blender_gets_the_rig_with_its_controls_and_the_take(
    walk: BakedTake, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(NothingToExport, match="keeps the keys of the take"):
        export_take(take_of(bpy.context.scene, walk.armature, fps=12.0), "blend", tmp_path / "slow.blend")
    assert not list(tmp_path.iterdir())
    collections = set(bpy.data.collections)
    path, joints = written(walk, "blender", tmp_path)
    assert set(bpy.data.collections) == collections and "rror" not in "".join(capfd.readouterr())
    name, rig_name = walk.action.name, walk.armature.name
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.scene.render.fps = 30
    with bpy.data.libraries.load(str(path)) as (there, wanted):
        wanted.objects = [rig_name, *(obj for obj in there.objects if obj != rig_name and "Controls" not in obj)]
        assert name in there.actions and not there.scenes
    for obj in wanted.objects:
        bpy.context.scene.collection.objects.link(obj)
    rig = bpy.data.objects[rig_name]
    assert rig.animation_data.action.name == name and "left_hand_ik" in rig.pose.bones
    found = np.stack([evaluated_joints(bpy.context.scene, rig, frame) for frame in (1, 30, 60)])
    assert np.abs(found - joints[[0, 29, 59]]).max() < 1e-4


@pytest.mark.slow
def test_fingers_can_be_left_out_and_hands_carry_their_skin(scene: bpy.types.Scene, tmp_path: Path) -> None:
    body, motion = read_body(default_body_path(), SMPL_HANDS), moving_fingers()
    take = bake_take(scene, motion, body, settings=BakeSettings(floor=False))
    wrist = np.stack([evaluated_joints(scene, take.armature, 1 + f) for f in range(FRAMES)])[
        :, SMPL_HANDS.joints.index("left_wrist")
    ]
    path = tmp_path / "hands.fbx"
    chosen: ExportTake = replace(take_of(scene, take.armature), layout=FileLayout(fingers=False))
    export_take(chosen, "fbx", path)
    rig = read(path)
    names = set(rig.data.bones.keys())
    assert not {name for name in names if "index" in name or "thumb" in name}
    [mesh] = [obj for obj in bpy.data.objects if obj.type == "MESH"]
    assert not {group.name for group in mesh.vertex_groups} - names
    weights = np.array([sum(item.weight for item in vertex.groups) for vertex in mesh.data.vertices])
    assert np.abs(weights - 1).max() < 1e-2
    start = rig.animation_data.action.frame_range[0]
    bpy.context.scene.frame_set(round(start) + FRAMES - 1)
    there = np.array(rig.matrix_world @ rig.pose.bones["left_wrist"].head)
    assert np.abs(there - wrist[-1]).max() < 2e-3
    skin = evaluated_vertices(bpy.context.scene, mesh, round(start) + FRAMES - 1)
    group = mesh.vertex_groups["left_wrist"].index
    led = [v.index for v in mesh.data.vertices if any(g.group == group and g.weight > 0.9 for g in v.groups)]
    assert np.linalg.norm(skin[led] - there, axis=1).max() < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["unreal", "unity", "godot", "three.js"])
def test_a_clip_is_called_as_its_take(scene: bpy.types.Scene, walk: BakedTake, tmp_path: Path, name: str) -> None:
    """The FBX's and the glTF's animation are read back; Blender's importers put the rig's name before an FBX's."""
    walk.action.name = scene.name = "Anna Take 02"
    scene.name = "Room"
    other = bpy.data.scenes.new("Anna Take 02")
    path, _ = written(walk, name, tmp_path)
    assert scene.name == "Room" and other.name == walk.action.name
    read(path)
    clips = {action.name.removesuffix("_Armature").split("|")[-1] for action in bpy.data.actions}
    assert clips == {"Anna Take 02"}
