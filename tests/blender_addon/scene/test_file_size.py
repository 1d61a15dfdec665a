"""How large a take's file is, saved as Blender's users do: uncompressed before Blender 5, compressed since."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from blender_addon._exchange.capture_file import read_capture
from blender_addon._exchange.motion_file import read_motion
from blender_addon.body.body_file import BodyFile, default_body_path
from blender_addon.scene.bake import bake_take
from tests.support.addon_stand_in import capture_arrays, motion_arrays

COMPRESSED = bpy.app.version >= (5, 0, 0)
_LIMIT_BYTES = 1.8e6 if COMPRESSED else 5.6e6
"""The looks take 0.5 MB.

Pose correctives as shape keys made it 25 MB, as a table of the whole body 6.3; compressed it is 1.51 (5.3)."""


def test_two_seconds_of_the_whole_body_stay_small(body: BodyFile, tmp_path: Path) -> None:
    arrays = motion_arrays(default_body_path())
    np.savez(tmp_path / "take.npz", **arrays)
    np.savez(tmp_path / "capture.npz", **capture_arrays(arrays["joints"]))
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    motion, capture = read_motion(tmp_path / "take.npz"), read_capture(tmp_path / "capture.npz")
    bake_take(bpy.context.scene, motion, body, capture)
    out = tmp_path / "take.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(out), compress=COMPRESSED, copy=True)
    assert motion.fps * 2 == len(motion.transl)
    assert 1e6 < out.stat().st_size < _LIMIT_BYTES
