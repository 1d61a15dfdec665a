"""Files with characters and clips, opened as a scene: Blender's own, FBX, glTF, VRM and BVH."""

from __future__ import annotations

from pathlib import Path

import bpy

from .._exchange.errors import FileDamaged, FileMissing
from ..conventions.timing import set_scene_frame_rate
from .gltf_header import frame_rate, humanoid, read_header
from .recognition import state_humanoid

SUFFIXES = (".blend", ".fbx", ".glb", ".gltf", ".vrm", ".bvh")
"""What is read."""


def open_scene(path: Path) -> bpy.types.Scene:
    """Open a file and return its scene, in place of what was open; other formats than Blender's come into an empty one.

    The scene has the frame rate of the file's clips.

    Raises:
        FileMissing, FileDamaged: it is not there, its format is not read, or Blender cannot open it.
    """
    if not path.is_file():
        raise FileMissing("There is no such file.", where=str(path), hint="Check the path.")
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        hint = f"Export it as FBX or glTF; {', '.join(SUFFIXES)} are read."
        raise FileDamaged(f"Not supported: {suffix or 'files without an ending'}.", where=str(path), hint=hint)
    rate: float | None = None
    stated: dict[str, str] = {}
    if suffix in (".glb", ".gltf", ".vrm"):
        header = read_header(path)
        rate, stated = frame_rate(header), humanoid(header)
    try:
        _open(path, suffix, rate)
    except (RuntimeError, AttributeError, TypeError, ValueError, KeyError, IndexError, AssertionError) as error:
        # Importers are Python add-ons: on damaged files they break in ways of their own.
        first = next((line for line in reversed(str(error).strip().splitlines()) if line.strip()), "it is damaged")
        raise FileDamaged(f"Blender cannot open the file: {first.strip()}", where=str(path)) from error
    for rig in (o for o in bpy.data.objects if o.type == "ARMATURE" and stated):
        state_humanoid(rig, stated)
    return bpy.context.scene


def _open(path: Path, suffix: str, rate: float | None) -> None:
    name = str(path.resolve())
    if suffix == ".blend":
        bpy.ops.wm.open_mainfile(filepath=name, load_ui=False, use_scripts=False)
        return
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    if rate is not None:
        set_scene_frame_rate(bpy.context.scene, rate)
    if suffix == ".fbx":
        bpy.ops.import_scene.fbx(filepath=name)
    elif suffix == ".bvh":
        bpy.ops.import_anim.bvh(filepath=name, update_scene_fps=True, use_fps_scale=False)
    else:
        bpy.ops.import_scene.gltf(filepath=name)
