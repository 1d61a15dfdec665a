"""Every format at every usual rate, from scenes of other rates: as long as the take, and joints where they were then.

The largest distance in ``docs/reference/file-formats-exports.md`` is of this test. ``pytest
--junitxml`` writes each figure as the property ``off_mm``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.motion_file import read_motion
from blender_addon.animation.deviation import evaluated_joints, evaluated_vertices
from blender_addon.conventions.timing import scene_frame_rate, set_scene_frame_rate
from blender_addon.errors import ExporterMissing
from blender_addon.export.formats import FORMATS
from blender_addon.export.take import take_of
from blender_addon.export.write import export_take
from blender_addon.scene.bake import BakeSettings, bake_take
from tests.support.addon_stand_in import Files

RATES = (24.0, 25.0, 30000 / 1001, 30.0, 60.0, 120.0)
TAKE_FPS, FRAMES = 60.0, 31
SECONDS = (FRAMES - 1) / TAKE_FPS
TOLERANCE_MM = 1.0


@dataclass(frozen=True)
class Read:
    """What a file shows to a program that reads it."""

    seconds: np.ndarray  # (F,) times of its frames from the first on.
    points: np.ndarray  # (F, P, 3) joints or vertices in metres, Z up.


def of_blender(group: str, verb: str, **settings: Any) -> Callable[[Path, float, int, Files], Read]:
    """Return what reads a file by one of Blender's importers, into an empty scene of the file's own rate."""

    def read(path: Path, fps: float, count: int, files: Files) -> Read:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        scene, operator = bpy.context.scene, getattr(getattr(bpy.ops, group), verb)
        set_scene_frame_rate(scene, whole_rate(fps) if verb == "gltf" else fps)
        assert operator(filepath=str(path), **settings) == {"FINISHED"}
        step = scene_frame_rate(scene) / fps
        rigs = [obj for obj in bpy.data.objects if obj.type == "ARMATURE"]
        if not rigs:
            [mesh] = [obj for obj in bpy.data.objects if obj.type == "MESH"]
            assert scene.frame_end - scene.frame_start == count - 1
            frames = scene.frame_start + np.arange(count)
            return Read(np.arange(count) / fps, np.stack([evaluated_vertices(scene, mesh, f) for f in frames]))
        start, end = rigs[0].animation_data.action.frame_range
        assert end - start == pytest.approx((count - 1) * step, abs=1e-3)
        frames = start + step * np.arange(count)
        return Read(np.arange(count) / fps, np.stack([evaluated_joints(scene, rigs[0], f) for f in frames]))

    return read


def whole_rate(fps: float) -> float:
    """Return the rate of a scene for importers that place keys by the rounded one."""
    return float(2 * round(fps))


def of_amass(path: Path, fps: float, count: int, files: Files) -> Read:
    """Read the parameters, and bake them as a user would."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    motion, scene = read_motion(path), bpy.context.scene
    armature = bake_take(scene, motion, files.body).armature
    assert scene_frame_rate(scene) == pytest.approx(fps, rel=1e-6)
    shown = [evaluated_joints(scene, armature, 1.0 + f) for f in range(motion.num_frames)]
    return Read(np.arange(motion.num_frames) / motion.fps, np.stack(shown))


def of_csv(path: Path, fps: float, count: int, files: Files) -> Read:
    """Read the table."""
    rows = np.genfromtxt(path, delimiter=",", skip_header=1)
    return Read(rows[:, 1], rows[:, 2:].reshape(len(rows), -1, 3))


def of_trc(path: Path, fps: float, count: int, files: Files) -> Read:
    """Read millimetres with Y up."""
    rows = np.genfromtxt(path, delimiter="\t", skip_header=6)
    x, y, z = np.moveaxis(rows[:, 2:].reshape(len(rows), -1, 3) / 1000, -1, 0)
    return Read(rows[:, 1], np.stack([x, -z, y], axis=-1))


READERS: dict[str, Callable[[Path, float, int, Files], Read]] = {
    "bvh": of_blender("import_anim", "bvh", global_scale=0.01, update_scene_fps=True, use_fps_scale=False),
    "fbx": of_blender("wm", "fbx_import"), "gltf": of_blender("import_scene", "gltf"),
    "usd": of_blender("wm", "usd_import"), "alembic": of_blender("wm", "alembic_import", set_frame_range=True),
    "amass": of_amass, "amass-x": of_amass, "trc": of_trc, "csv": of_csv,
}  # fmt: skip


SAMPLED = [name for name, item in FORMATS.items() if item.is_sampled and name != "vrma"]
"""VRM Animation has the bones of VRM's humanoid alone. ``test_vrm_animation.py`` reads it."""


def test_every_sampled_format_has_a_reader() -> None:
    """The table below is slow: a new format is reminded of its reader here."""
    assert list(READERS) == SAMPLED


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("rate", range(len(RATES)), ids=[f"{fps:.5g} fps" for fps in RATES])
@pytest.mark.parametrize("name", SAMPLED)
def test_each_format_at_each_rate(
    scene: bpy.types.Scene, files: Files, tmp_path: Path, request: pytest.FixtureRequest, name: str, rate: int
) -> None:
    """The scene's rate is another one, a different one for each format."""
    fps, other = RATES[rate], 1 + list(FORMATS).index(name) % (len(RATES) - 1)
    set_scene_frame_rate(scene, RATES[(rate + other) % len(RATES)])
    part = {key: getattr(files.motion, key)[:FRAMES] for key in ("rotvec", "transl", "joints")}
    motion = replace(files.motion, fps=TAKE_FPS, keyframes=None, keypoints3d=None, **part)
    take = bake_take(scene, motion, files.body, settings=BakeSettings(frame_start=11, set_scene=False))
    path = tmp_path / f"take{FORMATS[name].suffix}"
    sampled = take_of(scene, take.armature, fps=fps)
    try:
        export_take(sampled, name, path)
    except ExporterMissing as missing:
        pytest.skip(str(missing))
    times = 11 + np.arange(sampled.num_frames) * scene_frame_rate(scene) / fps
    shows_skin = name == "alembic"
    shown = (
        np.stack([evaluated_vertices(scene, take.mesh, time) for time in times])
        if shows_skin
        else np.stack([evaluated_joints(scene, take.armature, time) for time in times])
    )
    read = READERS[name](path, fps, sampled.num_frames, files)
    assert len(read.seconds) == sampled.num_frames
    np.testing.assert_allclose(read.seconds, np.arange(sampled.num_frames) / fps, atol=1e-6)
    assert SECONDS - 1 / fps < read.seconds[-1] <= SECONDS + 1e-6, "as long as the take, to a frame"
    off_mm = 1000 * float(np.linalg.norm(read.points - shown, axis=-1).max())
    assert off_mm < TOLERANCE_MM
    if not shows_skin:  # frames of the take that are frames of the file, too: the solver's own joints
        frames = read.seconds * TAKE_FPS
        common = np.abs(frames - np.round(frames)) < 1e-6
        solved = motion.joints[np.round(frames[common]).astype(int)]
        assert common.any()
        off_mm = max(off_mm, 1000 * float(np.linalg.norm(read.points[common] - solved, axis=-1).max()))
    assert off_mm < TOLERANCE_MM
    request.node.user_properties.append(("off_mm", off_mm))
