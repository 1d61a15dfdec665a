"""Render characters that play one motion: ``python -m tests.benchmarks.retarget_sheets --out SHEET.png``.

Our body and every character of ``bench_retarget`` have one row each. If the recordings are next to the repository, the
human of Mesh2Motion has one too. Each is mapped automatically and seen from the front and left at the same times. Their
skin is a flat bar from bone to bone, so that twist is visible.
"""

from __future__ import annotations

import argparse
import sys
import tarfile
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np

from blender_addon._exchange.motion_file import MotionFile
from blender_addon.body.body_file import BodyFile, default_body_path, read_body
from blender_addon.conventions.timing import TakeTiming
from blender_addon.headless.process import leave
from blender_addon.render.contact_sheet import open_lettering
from blender_addon.render.picture import blend, gradient, layer_from_render, write_png
from blender_addon.render.stage import RenderQuality, open_stage
from blender_addon.render.view import View, three_quarter_view
from blender_addon.retarget.motion.figures import actor_of_motion
from blender_addon.retarget.recognition import open_scene
from blender_addon.retarget.retarget import retarget
from blender_addon.scene.bake import bake_take
from tests.support.foreign_files import CHARACTERS
from tests.support.played_character import FPS, known_clip
from tests.support.recordings import recordings_folder
from tests.support.retarget_rigs import map_of_rig, mixamo, rigify

MOMENTS, SIZE = 8, (190, 250)  # Poses per row, and width and height of a picture in pixels.
_LOOK = RenderQuality(shrink=2, cavity=True, shadows=True)
_BAR_M = (0.045, 0.02)
"""Half the width and half the thickness of a bar in metres."""
_HUMAN = "mesh2motion_cc0/app_fork_glb/static/rigs/rig-human.glb"
_FORWARD = -np.pi / 2
"""Initial direction of the motion in radians from +X about Z."""


def main() -> int:
    """Render the sheet."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.retarget_sheets", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, metavar="SHEET.png")
    out = parser.parse_args().out
    motion, body = known_clip(), read_body(default_body_path())
    with TemporaryDirectory() as name:
        rows = [row(title, figure, motion, Path(name)) for title, figure in figures(motion, body, Path(name))]
    write_png(out, np.concatenate(rows))
    sys.stdout.write(f"{out}: {len(rows)} rows\n")
    return 0


def figures(motion: MotionFile, body: BodyFile, folder: Path) -> Iterator[tuple[str, bpy.types.Object]]:
    """Yield each figure with its name, alone in the open file, while it plays the motion."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    yield "our body", bake_take(bpy.context.scene, motion, body).armature
    for name, make in makers(folder).items():
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        rig = make()
        rig_map = map_of_rig(rig)
        draw_bars(rig, set(rig_map.bones.values()))
        retarget(actor_of_motion(motion, body), rig, bpy.context.scene, rig_map, TakeTiming(1, FPS))
        yield name, rig


def makers(folder: Path) -> dict[str, Callable[[], bpy.types.Object]]:
    """Return a function that creates each character."""
    found: dict[str, Callable[[], bpy.types.Object]] = {
        "Mixamo": lambda: mixamo()[0], "Rigify": lambda: rigify()[0],
        **{name: lambda character=character: character(folder)[0] for name, character in CHARACTERS.items()},
    }  # fmt: skip
    archive = recordings_folder() / "mesh2motion_cc0.tar.xz"
    if archive.is_file():
        found["Mesh2Motion"] = lambda: human(archive, folder)
    return found


def human(archive: Path, folder: Path) -> bpy.types.Object:
    """Open Mesh2Motion's human."""
    with tarfile.open(archive) as members:
        members.extract(_HUMAN, folder, filter="data")
    return next(obj for obj in open_scene(folder / _HUMAN).objects if obj.type == "ARMATURE")


def draw_bars(rig: bpy.types.Object, mapped: set[str]) -> None:
    """Replace a rig's skin by bars from the head of each bone to the heads of its children.

    Bones with skin weights are drawn. If the mapped bones themselves have the skin, these and the bones between are
    drawn.
    """
    drawn = {bone.name for bone in rig.data.bones if bone.use_deform}
    if len(drawn & mapped) > len(mapped) / 2:
        drawn = {name for name in drawn if name in mapped or _is_between(rig.data.bones[name], mapped)}
    for obj in [obj for obj in bpy.context.scene.objects if obj.type == "MESH" and obj.find_armature() == rig]:
        obj.hide_render = True
    points, faces, names = [], [], []
    for bone in rig.data.bones:
        for child in bone.children if bone.name in drawn else ():
            corners = _bar(bone, child)
            if corners is not None and child.name in drawn:
                faces += [tuple(len(points) + corner for corner in face) for face in _SIDES]
                points += corners.tolist()
                names += [bone.name] * len(corners)
    mesh = bpy.data.meshes.new("Bars")
    mesh.from_pydata(points, [], faces)
    skin = bpy.data.objects.new("Bars", mesh)
    bpy.context.scene.collection.objects.link(skin)
    skin.parent = rig
    for v, name in enumerate(names):
        (skin.vertex_groups.get(name) or skin.vertex_groups.new(name=name)).add([v], 1.0, "REPLACE")
    skin.modifiers.new("Armature", "ARMATURE").object = rig


def _is_between(bone: bpy.types.Bone, mapped: set[str]) -> bool:
    above, below = ({other.name for other in others} for others in (bone.parent_recursive, bone.children_recursive))
    return bool(mapped & above and mapped & below)


_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def _bar(bone: bpy.types.Bone, child: bpy.types.Bone) -> np.ndarray | None:
    """Return the (8, 3) corners of a bar between two heads at rest, wide along the bone's x, or None without length."""
    start, end = np.array(bone.head_local), np.array(child.head_local)
    scale = 1.0 / _size_m(bone)
    along = end - start
    if np.linalg.norm(along) < 0.01 * scale:
        return None
    axis = np.array(bone.matrix_local)[:3, 0]
    across = axis - along * (axis @ along) / (along @ along)
    across /= max(float(np.linalg.norm(across)), 1e-9)
    up = np.cross(along, across) / np.linalg.norm(along)
    ends = [(start, 1.0), (end, 0.6)]
    return np.array([
        point + scale * taper * (x * _BAR_M[0] * across + z * _BAR_M[1] * up)
        for point, taper in ends for x in (-1, 1) for z in (-1, 1)
    ])  # fmt: skip


def _size_m(bone: bpy.types.Bone) -> float:
    """Return the metres per unit of a rig. Its height is assumed to be 1.6 m."""
    rig = bone.id_data
    heights = [other.head_local for other in rig.bones]
    return 1.6 / max(float(np.ptp(np.array(heights), axis=0).max()), 1e-9)


def row(title: str, figure: bpy.types.Object, motion: MotionFile, folder: Path) -> np.ndarray:
    """Return a row of pictures of a figure at the chosen times."""
    scene, width = bpy.context.scene, SIZE[0]
    shown = bpy.data.collections.new("Shown")
    for obj in (figure, *figure.children_recursive):
        if obj.type in ("MESH", "ARMATURE") and not obj.hide_render:
            shown.objects.link(obj)
    picture = gradient(MOMENTS * width, SIZE[1])
    frames = np.linspace(1, motion.num_frames, MOMENTS).round().astype(int)
    with open_lettering(folder, 16) as letters:
        for k, frame in enumerate(frames.tolist()):
            scene.frame_set(frame)
            heads = np.array([figure.matrix_world @ bone.head for bone in figure.pose.bones if bone.bone.use_deform])
            view = View(three_quarter_view(heads, _FORWARD, SIZE), SIZE)
            with open_stage("figure", (shown,), view, _LOOK, folder) as stage:
                blend(picture, layer_from_render(stage.render(float(frame)), _LOOK.shrink), k * width, 0)
        letters.write(picture, title, 8, 8)
    return picture


if __name__ == "__main__":
    leave(main())
