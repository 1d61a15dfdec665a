"""Motion of any rig on any rig: read from bones, files of other programs, fingers, clips by name."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.errors import FileDamaged
from blender_addon.animation.curves import action_curves, current_action
from blender_addon.errors import ActorMissing, TargetUnsuitable
from blender_addon.headless.main import main
from blender_addon.retarget import recognition
from blender_addon.retarget.recognition import frame_rate, humanoid, map_rig, open_scene, read_header
from blender_addon.retarget.retarget import Retargeted, retarget
from blender_addon.retarget.rig_actor import _on_floor, read_rig_actor
from tests.support.foreign_characters import state_humanoid_in, write_character
from tests.support.foreign_namings import NAMINGS
from tests.support.foreign_rigs import foreign_rig
from tests.support.foreign_skeletons import draw
from tests.support.keyed_walk import FRAMES, play


def carry_over(source: bpy.types.Object, target: bpy.types.Object) -> Retargeted:
    scene = bpy.context.scene
    actor, timing, _ = read_rig_actor(source, scene, map_rig(source))
    return retarget(actor, target, scene, map_rig(target), timing)


def compared(rig: bpy.types.Object) -> dict[str, str]:
    """Return the bones by role but a second one of the neck, which shares the first one's bend and the head's."""
    return {role: b for role, b in map_rig(rig).bones.items() if role not in ("root", "neck_2")}


def shown(rig: bpy.types.Object, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Return heads (B, 3) and rotations since rest (B, 3, 3) of the compared bones in the world."""
    bpy.context.scene.frame_set(frame)
    posed = rig.evaluated_get(bpy.context.evaluated_depsgraph_get())
    bones = list(compared(rig).values())
    world = np.array([posed.matrix_world @ posed.pose.bones[b].matrix for b in bones])
    rest = np.array([rig.data.bones[b].matrix_local for b in bones])[:, :3, :3]
    axes = world[:, :3, :3] / np.linalg.norm(world[:, :3, :3], axis=1, keepdims=True)
    return world[:, :3, 3], axes @ rest.swapaxes(-1, -2)


@pytest.mark.parametrize(("naming", "arms_down"), [("mixamo", 0.0), ("unreal_5", 50.0), ("vrm_own_names", 20.0)])
def test_a_rig_onto_its_own_copy_is_the_same_motion(scene: Any, naming: str, arms_down: float) -> None:
    rigs = [foreign_rig(draw(NAMINGS[naming], arms_down), sole=0.0)[0] for _ in range(2)]
    play(rigs[0])
    done = carry_over(*rigs)
    assert done.scale == pytest.approx(1.0, abs=1e-4)
    is_leg = np.array([any(part in role for part in ("thigh", "shin")) for role in compared(rigs[0])])
    for frame in (1, 7, FRAMES // 2, FRAMES):
        (heads, turns), (own_heads, own_turns) = (shown(rig, frame) for rig in rigs)
        assert np.linalg.norm(heads - own_heads, axis=1).max() < 0.0125, "but for the hold of standing feet"
        angles = np.arccos(np.clip((np.trace(turns.swapaxes(-1, -2) @ own_turns, axis1=1, axis2=2) - 1) / 2, -1, 1))
        assert np.degrees(angles)[~is_leg].max() < 1.0, "straight arms bend a little"
        assert np.degrees(angles)[is_leg].max() < 4.0, "straight legs bend most for the hold of a foot"


def test_units_axes_and_motion_of_the_object_do_not_matter(scene: Any) -> None:
    skeleton, ends = draw(NAMINGS["mixamo"]), []
    for unit, y_up, on_object in ((1.0, False, False), (0.01, True, True)):
        source, _ = foreign_rig(skeleton, unit=unit, y_up=y_up)
        target, _ = foreign_rig(skeleton)
        source.location = (0.0, 0.0, 0.0)
        play(source, on_object=on_object)
        carry_over(source, target)
        start, end = (shown(target, frame)[0][0] for frame in (1, FRAMES))
        ends.append(end - start)
    way = np.array([0.3, 0.2, 0.5]) * (FRAMES - 1) / FRAMES
    assert np.linalg.norm(ends[1] - way) < 0.02, "the object's way is the world's"
    assert np.linalg.norm(ends[0]) == pytest.approx(np.linalg.norm(way), abs=0.02)


def test_the_unit_of_an_actor_does_not_matter(scene: Any) -> None:
    """A clip in centimetres that was imported as metres is a giant, and its speed is a person's for its size."""
    skeleton, ways = draw(NAMINGS["mixamo"]), []
    for size in (1.0, 100.0):
        rig, _ = foreign_rig(skeleton.placed(lambda place, size=size: size * place))
        play(rig)
        action = current_action(rig)
        assert action is not None
        for curve in action_curves(action):
            for point in curve.keyframe_points if curve.data_path.endswith("location") else ():
                point.co[1], point.interpolation = size * point.co[1], "LINEAR"
        actor, _, notes = read_rig_actor(rig, scene, map_rig(rig))
        assert not any("m/s" in note for note in notes)
        ways.append(actor.joints[:, 0] / size)
    assert np.linalg.norm(ways[0][-1] - ways[0][0]) > 0.5
    np.testing.assert_allclose(ways[1], ways[0], atol=1e-3)


def test_a_first_frame_far_below_leaves_a_short_clip_on_its_floor(scene: Any) -> None:
    """Some programs write a T-pose with the hips at the origin before the motion."""
    rig, _ = foreign_rig(draw(NAMINGS["mixamo"]))
    play(rig)
    actor = read_rig_actor(rig, scene, map_rig(rig))[0]
    joints = actor.joints[:30].copy()
    joints[0, :, 2] -= 0.9
    stands, notes = _on_floor(replace(actor, joints=joints))
    assert notes == () and stands.joints is joints


def test_fingers_of_other_rest_poses_end_up_pointing_alike(scene: Any) -> None:
    source, _ = foreign_rig(draw(NAMINGS["mixamo"], 10.0))
    target, _ = foreign_rig(draw(NAMINGS["unreal_5"], 45.0, legs=0.9))
    play(source)
    carry_over(source, target)
    for frame in (1, FRAMES // 2):
        bpy.context.scene.frame_set(frame)
        ways = []
        for rig in (source, target):
            bones, roles = rig.pose.bones, map_rig(rig).bones
            hand = bones[roles["left_hand"]]
            knuckles = [bones[roles[f"left_{f}_1"]].head for f in ("index", "pinky")]
            forward = (knuckles[0] + knuckles[1]) / 2 - hand.head
            tip = bones[roles["left_middle_3"]].head - bones[roles["left_middle_2"]].head
            ways.append(forward.normalized() @ tip.normalized())
        assert ways[0] == pytest.approx(ways[1], abs=0.05)
    assert ways[0] < 0.995, "the finger is bent on the frame that is compared"


def test_an_actor_that_plays_nothing_or_is_nobody_is_named(scene: Any) -> None:
    rig, _ = foreign_rig(draw(NAMINGS["mixamo"]))
    with pytest.raises(ActorMissing, match="has no action"):
        read_rig_actor(rig, scene, map_rig(rig))
    play(rig)
    with pytest.raises(ActorMissing, match="pelvis was not found"):
        read_rig_actor(rig, scene, map_rig(rig).renamed({}))
    rig.scale = (1.0, 1.0, 2.0)
    bpy.context.view_layer.update()
    with pytest.raises(ActorMissing, match="stretched"):
        read_rig_actor(rig, scene, map_rig(rig))


def test_poses_empty_actions_and_absurd_sizes_are_named(scene: Any) -> None:
    skeleton = draw(NAMINGS["mixamo"])
    rig, _ = foreign_rig(skeleton)
    rig.pose.bones["mixamorig:LeftLeg"].keyframe_insert("rotation_quaternion", frame=1)
    actor, timing, notes = read_rig_actor(rig, scene, map_rig(rig))
    assert actor.num_frames == 1 and notes == ("The clip has one frame, so it is a pose.",)
    for size in (1e-6, 1e6):
        other, _ = foreign_rig(skeleton.placed(lambda place, size=size: size * place))
        with pytest.raises(TargetUnsuitable, match="times as large as the actor"):
            retarget(actor, other, scene, map_rig(other), timing)
    huge, _ = foreign_rig(skeleton.placed(lambda place: 100.0 * place))
    assert retarget(actor, huge, scene, map_rig(huge), timing).scale == pytest.approx(100.0, rel=1e-3)
    assert rig.animation_data is not None
    rig.animation_data.action = bpy.data.actions.new("empty")
    with pytest.raises(ActorMissing, match="'empty' has no keys"):
        read_rig_actor(rig, scene, map_rig(rig))


def test_files_of_other_programs_are_source_and_target(scene: Any, tmp_path: Path, capfd: Any) -> None:
    source, target = tmp_path / "walk.glb", tmp_path / "hero.vrm"
    rig, _ = foreign_rig(draw(NAMINGS["unreal_4"], 45.0))
    play(rig)
    bpy.context.scene.render.fps = 30
    bpy.ops.export_scene.gltf(filepath=str(source), export_animations=True, export_force_sampling=True)
    write_character(target, draw(NAMINGS["vrm_own_names"]), unit=0.01, sole=-0.02)
    assert frame_rate(read_header(source)) == pytest.approx(30.0, rel=0.01)
    assert humanoid(read_header(target))["leftUpperArm"] == "H.Ude"
    out = tmp_path / "out.blend"
    given = ["retarget", str(source), "--target", str(target), "--out", str(out), "--json"]
    assert main(given) == 0
    result = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert result["map"] == "VRM humanoid of the file" and result["soles_from"] == "mesh"
    assert result["hands_and_feet_deviation_mm"] < 1.0 and result["fps"] == pytest.approx(30.0, rel=0.01)
    assert main([*given, "--overwrite", "--action", "Gone"]) == 3
    assert "There is no action 'Gone'" in json.loads(capfd.readouterr().out.splitlines()[-1])["message"]


def test_a_vrm_animation_is_the_motion_of_its_nodes(scene: Any, tmp_path: Path) -> None:
    """The file has nodes and keys alone. Its humanoid shows the bones, whose names say nothing."""
    skeleton = draw(NAMINGS["vrm_own_names"])
    rig, _ = foreign_rig(skeleton)
    play(rig)
    scene.render.fps = 30
    known, _, _ = read_rig_actor(rig, scene, map_rig(rig))
    glb = tmp_path / "wave.glb"
    bpy.ops.export_scene.gltf(filepath=str(glb), export_animations=True, export_force_sampling=True)
    vrma = state_humanoid_in(glb, skeleton, "VRMC_vrm_animation").rename(tmp_path / "wave.vrma")
    assert "skins" not in read_header(vrma) and "meshes" not in read_header(vrma)
    opened = open_scene(vrma)
    source = next(o for o in opened.objects if o.type == "ARMATURE")
    assert map_rig(source).bones["left_upper_arm"] == "H.Ude"
    actor, _, _ = read_rig_actor(source, opened, map_rig(source))
    assert actor.num_frames == known.num_frames and actor.fps == pytest.approx(30.0, rel=0.01)
    assert np.abs(actor.joints - known.joints)[:, :22].max() < 0.01
    damaged = tmp_path / "none.vrma"
    damaged.write_bytes(vrma.read_bytes().replace(b"VRMC_vrm_animation", b"VRMC_vrm_animatiom"))
    with pytest.raises(FileDamaged, match="no humanoid bones"):
        open_scene(damaged)


def test_a_torn_line_of_a_clip_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blender's importer, which leaves the file open, is replaced by its error."""

    def fail(*_: object) -> None:
        raise RuntimeError("Error: Python: Traceback\nIndexError: list index out of range\nLocation: ops.py:109")

    monkeypatch.setattr(recognition, "_open", fail)
    channels = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
    hierarchy = f"HIERARCHY\nROOT Hips\n{{\nOFFSET 0 0 0\n{channels}\nEnd Site\n{{\nOFFSET 0 1 0\n}}\n}}\n"
    rows = "MOTION\nFrames: 3\nFrame Time: 0.04\n0 0 0 0 0 0\n0 0 0\n0 0 0 0 0 0\n"
    (tmp_path / "torn.bvh").write_text(hierarchy + rows)
    with pytest.raises(FileDamaged, match="file: IndexError: list") as caught:
        open_scene(tmp_path / "torn.bvh")
    assert caught.value.where.endswith("line 15, which has 3 words instead of 6 numbers")


def test_files_that_hold_no_scene_are_named(scene: Any, tmp_path: Path) -> None:
    from blender_addon._exchange.errors import FileDamaged, FileMissing

    (tmp_path / "bad.glb").write_bytes(b"glTF" + bytes(40))
    (tmp_path / "bad.fbx").write_bytes(b"Kaydara FBX Binary  \x00" + bytes(40))
    (tmp_path / "clip.bip").write_bytes(b"x")
    for name in ("bad.glb", "bad.fbx"):
        with pytest.raises(FileDamaged):
            open_scene(tmp_path / name)
    with pytest.raises(FileDamaged, match=r"not supported \(\.bip\)"):
        open_scene(tmp_path / "clip.bip")
    with pytest.raises(FileMissing):
        open_scene(tmp_path / "gone.fbx")


@pytest.mark.parametrize(
    "wrong", [{"count": 10**400}, {"min": [None]}, {"max": ["a"]}, {"max": [10**400]}, {"count": "9"}]
)
def test_a_header_with_odd_numbers_gives_no_rate(wrong: dict[str, Any]) -> None:
    sound = {"count": 31, "min": [0.0], "max": [1.0]}
    header = {"accessors": [sound | wrong], "animations": [{"samplers": [{"input": 0}]}]}
    assert frame_rate({**header, "accessors": [sound]}) == 30.0 and frame_rate(header) is None


@pytest.mark.parametrize(("count", "rate"), [(7, 24.0), (16, 25.0), (31, 10.0), (355, 118.0)])
def test_sparse_keys_are_on_frames_of_a_film(count: int, rate: float) -> None:
    for start in np.linspace(0.0, 1.0, 31):  # glTF has times of single precision
        ends = {"min": [float(np.float32(start))], "max": [float(np.float32(start + 3.0))]}
        header = {"accessors": [{"count": count} | ends], "animations": [{"samplers": [{"input": 0}]}]}
        assert frame_rate(header) == rate
