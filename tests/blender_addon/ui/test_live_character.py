"""Live: a character's rig moves as the body does while poses come, and what cannot be is named before a run begins."""

from __future__ import annotations

import time
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon.retarget.live_rig import LiveRig
from blender_addon.retarget.recognition import map_rig
from blender_addon.retarget.retarget import RetargetSettings
from blender_addon.ui.operators.live import live
from solver_backend.io.native.motion_file import write_motion
from tests.support.foreign_namings import NAMINGS
from tests.support.foreign_rigs import foreign_rig
from tests.support.foreign_skeletons import draw
from tests.support.narrow_layout import draw_panel
from tests.support.short_motion import short_motion

_LONGEST_S = 120.0


def until(done) -> None:
    """Tick as Blender's timer would, until something is so."""
    end = time.monotonic() + _LONGEST_S
    while not done():
        assert time.monotonic() < end, (live.failure, live.run and list(live.run.log))
        live.tick()
        time.sleep(0.02)


@pytest.fixture
def driven(mocap, tmp_path: Path):
    """Return the settings of a scene with a character, and a motion with fingers that would be replayed."""
    write_motion(tmp_path / "walk.npz", short_motion(20, fingers=True))
    mocap.live.source, mocap.live.drive = str(tmp_path / "walk.npz"), True
    rig, _ = foreign_rig(draw(NAMINGS["mixamo"]))
    mocap.retarget.target = rig
    yield mocap
    live.abandon()


def heads(rig: bpy.types.Object) -> np.ndarray:
    bpy.context.view_layer.update()
    return np.array([rig.matrix_world @ bone.head for bone in rig.pose.bones])


def test_the_target_moves_as_the_poses_that_come_fingers_too(driven):
    rig = driven.retarget.target
    drawn = draw_panel(bpy.types.VIEW3D_PT_mocap_live, 200)
    assert not drawn.cut and "Drive Character" in " ".join(drawn.drawn)
    assert bpy.ops.mocap.live_start() == {"FINISHED"}
    run, figure = live.run, live.figure
    assert run is not None and figure is not None
    until(lambda: run.finished)
    assert live.failure == "" and run.latest is not None and run.latest.rotvec is not None
    moved = heads(rig)
    twin, _ = foreign_rig(draw(NAMINGS["mixamo"]))
    again = LiveRig(twin, bpy.context.scene, map_rig(twin), RetargetSettings(), figure.body, figure.betas)
    assert np.abs(heads(twin) - moved).max() > 0.1
    again.pose(run.latest.rotvec, run.latest.transl)
    assert np.abs(heads(twin) - moved).max() < 1e-4
    assert len(run.latest.rotvec) == 52


def test_without_the_switch_no_rig_is_touched(driven):
    driven.live.drive = False
    rig = driven.retarget.target
    before = heads(rig)
    assert bpy.ops.mocap.live_start() == {"FINISHED"} and live.character is None
    until(lambda: live.run is None)
    assert np.array_equal(heads(rig), before)


def test_a_character_that_is_taken_away_ends_the_run_with_a_sentence(driven):
    assert bpy.ops.mocap.live_start() == {"FINISHED"}
    bpy.data.objects.remove(driven.retarget.target)
    until(lambda: not live.busy)
    assert "character was deleted" in live.failure


def test_a_shape_that_does_not_suit_the_rig_ends_the_run_with_its_reason(driven):
    assert bpy.ops.mocap.live_start() == {"FINISHED"}
    assert live.run is not None
    live.run.betas = np.full(10, 1e5)
    live.tick()
    assert "times as large" in live.failure or "is ambiguous" in live.failure
    until(lambda: not live.busy)


def test_no_target_or_one_that_cannot_play_starts_no_run(driven):
    driven.retarget.target = None
    with pytest.raises(RuntimeError, match="no target"):
        bpy.ops.mocap.live_start()
    driven.retarget.target = rig = foreign_rig(draw(NAMINGS["mixamo"]))[0]
    rig.pose.bones[map_rig(rig).bones["left_thigh"]].lock_rotation = (True, True, True)
    with pytest.raises(RuntimeError, match="Locked channels"):
        bpy.ops.mocap.live_start()
    assert not live.busy and not any(collection.name == "Live" for collection in bpy.data.collections)
