"""Linked bodies and their library overrides are exported as local ones are, and nothing is left behind."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon.animation.deviation import evaluated_joints
from blender_addon.body.controls.limbs import LIMBS
from blender_addon.conventions.timing import TakeTiming
from blender_addon.errors import TargetUnsuitable
from blender_addon.export.formats import FORMATS
from blender_addon.export.take import take_of
from blender_addon.export.write import export_take
from blender_addon.retarget.motion.figures import actor_of_motion
from blender_addon.retarget.motion.transfer import TransferSettings
from blender_addon.retarget.retarget import RetargetSettings, retarget
from blender_addon.retarget.rig_actor import read_actor
from blender_addon.scene.bake import BakeSettings, bake_take
from blender_addon.scene.limb_modes import pose_by_joints, pose_from_ends
from tests.support.addon_stand_in import Files
from tests.support.library_override import override_linked
from tests.support.mixamo_rig import mixamo_rig
from tests.support.retarget_rigs import map_of_rig


@pytest.fixture(scope="module")
def library(files: Files, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a .blend file with a baked body."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bake_take(bpy.context.scene, files.motion, files.body, None, BakeSettings(floor=False))
    path = tmp_path_factory.mktemp("Bibliothek") / "take.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def linked(library: Path, name: str) -> bpy.types.Collection:
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.collections = [name]
    return bpy.data.collections[name]


@pytest.fixture
def override(scene: bpy.types.Scene, library: Path, files: Files) -> bpy.types.Object:
    collection = linked(library, files.motion.name)
    override_linked(collection)
    return next(obj for obj in scene.objects if obj.type == "ARMATURE" and obj.override_library)


def everything() -> list[tuple[str, str]]:
    kinds = ("objects", "meshes", "armatures", "actions", "collections", "scenes")
    return sorted((kind, item.name_full) for kind in kinds for item in getattr(bpy.data, kind))


@pytest.mark.slow
@pytest.mark.parametrize("format", ["bvh", "trc", "amass", "fbx", "gltf", "usd", "alembic"])
def test_an_override_is_exported_and_leaves_nothing_behind(scene, override, tmp_path: Path, format: str) -> None:
    before = everything()
    path = tmp_path / f"take{FORMATS[format].suffix}"
    export_take(take_of(scene, override), format, path)
    assert path.stat().st_size > 1000 and everything() == before


def test_an_overrides_motion_is_the_takes(scene, override, files: Files, tmp_path: Path) -> None:
    path = tmp_path / "take.npz"
    export_take(take_of(scene, override), "amass", path)
    with np.load(path) as stored:
        assert np.abs(stored["trans"] - files.motion.transl).max() < 1e-4


def test_an_overrides_limbs_go_to_ik_and_back(scene, override) -> None:
    action = override.animation_data.action
    override.animation_data.action = action.copy()  # the library's own cannot be changed
    before = evaluated_joints(scene, override, 20.0)
    pose_from_ends(override, scene, LIMBS)
    assert override.pose.bones["root"]["left_leg_ik"] == 1.0
    np.testing.assert_allclose(evaluated_joints(scene, override, 20.0), before, atol=1e-3)
    pose_by_joints(override, scene, LIMBS)
    np.testing.assert_allclose(evaluated_joints(scene, override, 20.0), before, atol=1e-3)


def test_a_linked_body_without_override_is_exported_too(scene, library: Path, files: Files, tmp_path: Path) -> None:
    collection = linked(library, files.motion.name)
    scene.collection.children.link(collection)
    armature = next(obj for obj in collection.all_objects if obj.type == "ARMATURE")
    before = everything()
    export_take(take_of(scene, armature), "fbx", tmp_path / "take.fbx")
    assert (tmp_path / "take.fbx").stat().st_size > 1000 and everything() == before


def test_a_copying_that_breaks_leaves_nothing_behind(scene, override, tmp_path: Path, monkeypatch) -> None:
    before = everything()
    monkeypatch.setattr("blender_addon.export.plain_take.shape_shifts", lambda _: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        export_take(take_of(scene, override), "fbx", tmp_path / "take.fbx")
    assert everything() == before


@pytest.fixture(scope="module")
def rig_library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a .blend file with a character."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    rig = mixamo_rig("Character")
    home = bpy.data.collections.new("Character")
    home.objects.link(rig)
    bpy.context.scene.collection.children.link(home)
    path = tmp_path_factory.mktemp("Figuren") / "character.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def test_an_override_plays_what_is_laid_on_it_and_a_linked_rig_is_named(
    scene, rig_library: Path, library: Path, files: Files
) -> None:
    collection = linked(rig_library, "Character")
    scene.collection.children.link(collection)
    rig = collection.all_objects[0]
    actor = actor_of_motion(files.motion, files.body)
    with pytest.raises(TargetUnsuitable, match="override"):
        retarget(actor, rig, scene, map_of_rig(rig), TakeTiming(1, 30.0), RetargetSettings("fk", TransferSettings()))
    scene.collection.children.unlink(collection)
    made = override_linked(collection)
    rig = made.all_objects[0]
    done = retarget(actor, rig, scene, map_of_rig(rig), TakeTiming(1, 30.0), RetargetSettings("fk", TransferSettings()))
    assert rig.animation_data.action is not None and done.deviation_mm < 1.0
    # An actor that is an override itself is read as the body of its file.
    body = linked(library, files.motion.name)
    override_linked(body)
    armature = next(obj for obj in scene.objects if obj.override_library and "rest_pelvis" in obj)
    overridden, _ = read_actor(armature, scene)
    assert np.abs(overridden.joints - actor.joints).max() < 1e-3
