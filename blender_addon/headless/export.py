"""``export``: write a motion file, or the takes in a Blender file, in other formats."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import replace

import bpy

from .._exchange.diagnostics import sentence
from .._exchange.errors import FileMissing
from .._exchange.motion_file import read_motion
from .._exchange.progress import Progress
from ..body.body_file import body_path_of, read_body
from ..body.looks import show_look
from ..body.shape import body_mesh
from ..errors import NothingToExport
from ..export.formats import FileLayout
from ..export.take import take_of
from ..export.write import export_take, file_names
from ..retarget.recognition import open_scene
from ..scene.bake import BakeSettings, bake_take
from ..scene.session import fresh_scene, request_of
from .foreign_file import limits_of, open_foreign_scene
from .result import CommandResult, refuse_replacing


def run_export(args: Namespace, progress: Progress) -> CommandResult:
    """Write one file per format, named after the take, and report the warnings of its solve."""
    names = file_names(args.source.stem, tuple(dict.fromkeys(args.formats)))
    if not args.source.is_file():
        raise FileMissing("There is no such file.", where=str(args.source), hint="Check the path.")
    paths = {name: args.out / file_name for name, file_name in names.items()}
    refuse_replacing(list(paths.values()), args.source, overwrite=args.overwrite)
    is_blend = args.source.suffix.lower() == ".blend"
    scene, armature = open_body(args) if is_blend else _baked(args, progress)
    if args.look and (mesh := body_mesh(armature)) is not None:
        show_look(mesh, args.look)
    request = request_of(scene) if is_blend else {}
    take = take_of(scene, armature, request.get("frames"), args.fps)
    take = replace(take, layout=FileLayout(**request.get("layout", {})))
    for name, path in paths.items():
        export_take(take, name, path, overwrite=args.overwrite, progress=progress)
    notes = [sentence(item, take.fps) for item in take.warnings]
    about = {"frames": take.num_frames, "fps": take.fps, "diagnostics": [item.as_dict() for item in take.warnings]}
    return {"outputs": [str(path) for path in paths.values()], "notes": notes, **about}


def _baked(args: Namespace, progress: Progress) -> tuple[bpy.types.Scene, bpy.types.Object]:
    motion = read_motion(args.source)
    body = read_body(args.body or body_path_of(motion.provenance), motion.body_layout)
    scene = fresh_scene()
    progress("baking", 0, 1)
    take = bake_take(scene, motion, body, settings=BakeSettings(floor=False))
    progress("baking", 1, 1)
    return scene, take.armature


def open_body(args: Namespace) -> tuple[bpy.types.Scene, bpy.types.Object]:
    """Open a Blender file. Return its scene and the armature ``args.armature``, or the only animated armature."""
    scene = open_scene(args.source) if args.own else open_foreign_scene(args.source, limits_of(args))
    found = {o.name: o for o in scene.objects if o.type == "ARMATURE" and (args.own or o.animation_data is not None)}
    chosen = [args.armature] if args.armature else list(found)
    if len(chosen) != 1 or chosen[0] not in found:
        name = args.armature
        message = f"There is no animated armature '{name}'." if name else "Exactly one animated armature is needed."
        hint = f"Specify one with --armature: {', '.join(found) or 'the file has none'}."
        raise NothingToExport(message, where=str(args.source), hint=hint)
    return scene, found[chosen[0]]
