"""Rigs that are linked, overridden, or not alone in their file: named with what to do, or played."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon.animation.curves import current_action
from blender_addon.headless.main import main
from tests.support.foreign_namings import NAMINGS
from tests.support.foreign_rigs import foreign_rig
from tests.support.foreign_skeletons import draw
from tests.support.keyed_walk import play


@pytest.fixture
def walk(scene: bpy.types.Scene, tmp_path: Path) -> Path:
    """Write a file with a rig that walks."""
    scene.render.fps = 30
    play(foreign_rig(draw(NAMINGS["mixamo"]))[0])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "walk.blend"))
    return tmp_path / "walk.blend"


@pytest.fixture
def two(walk: Path) -> Path:
    """Write a file with two rigs, ``Foreign`` and ``Foreign.001``."""
    new_file()
    for naming in ("mixamo", "unreal_4"):
        foreign_rig(draw(NAMINGS[naming]))
    bpy.ops.wm.save_as_mainfile(filepath=str(walk.with_name("two.blend")))
    return walk.with_name("two.blend")


def new_file() -> None:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def linked(two: Path) -> bpy.types.Object:
    """Link the first rig of a file into a new one and return it."""
    new_file()
    with bpy.data.libraries.load(str(two), link=True) as (theirs, ours):
        ours.objects = [name for name in theirs.objects if name == "Foreign"]
    rig = ours.objects[0]
    bpy.context.scene.collection.objects.link(rig)
    return rig


def retargeted(walk: Path, target: Path, capfd: Any, *options: str) -> tuple[int, dict[str, Any], Path]:
    out = target.with_name("out.blend")
    code = main(["retarget", str(walk), "--target", str(target), "--out", str(out), "--json", *options])
    return code, json.loads(capfd.readouterr().out.splitlines()[-1]), out


def test_a_file_with_two_armatures_asks_for_one_by_name(walk: Path, two: Path, capfd: Any) -> None:
    code, said, out = retargeted(walk, two, capfd)
    assert code == 3 and said["code"] == "target_unsuitable" and not out.exists()
    assert "Exactly one armature is needed" in said["message"] and "--object: Foreign, Foreign.001" in said["hint"]
    code, said, _ = retargeted(walk, two, capfd, "--object", "Foreign.002")
    assert code == 3 and "no armature 'Foreign.002'" in said["message"]
    code, said, out = retargeted(walk, two, capfd, "--object", "Foreign.001")
    assert code == 0 and "Unreal" in said["map"] and out.is_file()
    bpy.ops.wm.open_mainfile(filepath=str(out))
    assert current_action(bpy.data.objects["Foreign.001"]) is not None
    assert current_action(bpy.data.objects["Foreign"]) is None, "the other is left alone"


def test_a_linked_rig_is_refused_with_what_to_do(walk: Path, two: Path, capfd: Any) -> None:
    linked(two)
    bpy.ops.wm.save_as_mainfile(filepath=str(two.with_name("linked.blend")))
    code, said, out = retargeted(walk, two.with_name("linked.blend"), capfd)
    assert code == 3 and said["code"] == "target_unsuitable" and not out.exists()
    assert "linked and cannot be keyed" in said["message"] and "Library Override" in said["hint"]


@pytest.mark.slow
def test_an_overridden_rig_plays_as_its_original(walk: Path, two: Path, capfd: Any) -> None:
    linked(two).override_create(remap_local_usages=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(two.with_name("override.blend")))
    heads = []
    for target, options in ((two.with_name("override.blend"), ()), (two, ("--object", "Foreign"))):
        code, said, out = retargeted(walk, target, capfd, "--overwrite", *options)
        assert code == 0, said
        bpy.ops.wm.open_mainfile(filepath=str(out))
        rig = next(
            o for o in bpy.context.scene.objects if o.type == "ARMATURE" and o.library is None and current_action(o)
        )
        bpy.context.scene.frame_set(12)
        heads.append([bone.head[:] for bone in rig.pose.bones])
    assert np.ptp(heads[0], axis=0).max() > 0.5 and np.abs(np.array(heads[0]) - heads[1]).max() < 1e-4
