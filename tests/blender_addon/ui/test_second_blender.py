"""Heavy work on a body runs in a second Blender, from a file that holds the body alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon.animation.curves import action_curves
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.animation.takes import PATHS
from blender_addon.scene.bake import thinned_take
from blender_addon.ui.operators import export, takes
from tests.support.solved_capture import SolvedCapture


@pytest.fixture
def apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the operators start a second Blender, which they spare themselves without a window."""
    for module in (export, takes):
        monkeypatch.setattr(module, "works_here", lambda *of: False)


def test_keys_are_reduced_there_as_they_are_here(apart: None, mocap: Any, solved_take: Any) -> None:
    armature, scenes, name = mocap.review.armature, len(bpy.data.scenes), solved_take.name
    files = [solved_take.get(key) for key in PATHS]
    assert bpy.ops.mocap.thin_take(by="TOLERANCE", tolerance_mm=5.0) == {"FINISHED"}
    made = mocap.review.take
    assert made.name == f"{name} reduced keys" and made.users > 0 and len(bpy.data.scenes) == scenes
    assert [made.get(key) for key in PATHS] == files
    found = evaluated_joints(bpy.context.scene, armature, 10.0)
    bpy.ops.mocap.show_take(name=name)
    solved = evaluated_joints(bpy.context.scene, armature, 10.0)
    assert 1e-5 < np.linalg.norm(found - solved, axis=1).max() <= 5.1e-3
    here = thinned_take(bpy.context.scene, solved_take, armature, None, 5.0)
    for a, b in zip(action_curves(made), action_curves(here), strict=True):
        assert a.data_path == b.data_path and len(a.keyframe_points) == len(b.keyframe_points)


def test_an_export_holds_the_body_alone_and_says_where_it_is(
    apart: None, mocap: Any, solved: SolvedCapture, solved_take: Any, tmp_path: Path
) -> None:
    path, here = tmp_path / "ein Gang ü.bvh", tmp_path / "here.bvh"
    assert bpy.ops.mocap.export_take(filepath=str(path), format="bvh", use_range=True, first=3, last=12) == {"FINISHED"}
    assert "Wrote 10 frames" in mocap.exported and str(tmp_path) in mocap.exported
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(export, "works_here", lambda *of: True)
        assert bpy.ops.mocap.export_take(filepath=str(here), format="bvh", use_range=True, first=3, last=12)
    assert path.read_text(encoding="utf-8") == here.read_text(encoding="utf-8")
