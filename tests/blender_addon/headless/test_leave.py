"""A Blender file with a driver in Python does not keep its process from ending."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
_MAKE = """
import sys, bpy
from blender_addon.headless.process import leave
bpy.ops.wm.read_factory_settings(use_empty=True)
armature = bpy.data.objects.new("rig", bpy.data.armatures.new("rig"))
bpy.context.scene.collection.objects.link(armature)
bpy.context.view_layer.objects.active = armature
bpy.ops.object.mode_set(mode="EDIT")
armature.data.edit_bones.new("hips").tail = (0, 0, 1)
bpy.ops.object.mode_set(mode="OBJECT")
for frame in (1, 9):
    armature.location.x = frame
    armature.keyframe_insert("location", frame=frame)
armature.driver_add("pass_index").driver.expression = "len(str(frame))"
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
print("saved")
leave(7)
"""


@pytest.mark.slow
def test_export_of_a_driven_scene_ends(tmp_path: Path) -> None:
    path = tmp_path / "driven.blend"
    made = subprocess.run(
        [sys.executable, "-c", _MAKE, str(path)], capture_output=True, text=True, check=False, cwd=ROOT, timeout=60
    )
    assert made.returncode == 7 and "saved" in made.stdout
    command = [sys.executable, "-m", "blender_addon", "export", str(path), "--format", "bvh", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, timeout=60)
    assert done.returncode == 0 and done.stdout.splitlines()[-1] == str(tmp_path / "driven.bvh")
