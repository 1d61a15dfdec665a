"""Write FBX, glTF, USD and Alembic with Blender's exporters, and write .blend files."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from struct import Struct
from typing import Any

import bpy
import numpy as np

from ..._exchange.outputs import temporary_folder
from ..._exchange.progress import Progress
from ...animation.curves import current_action, is_take, same_rate
from ...animation.takes import PATHS, take_file
from ...body.mesh import positions
from ...conventions.timing import go_to_frame
from ...errors import ExporterMissing, ExportFailed, NothingToExport
from ...scene.session import why_not_written
from ..plain_take import plain_take, swap_names, temporary_copies
from ..take import ExportTake, chosen

_DISK = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.EROFS, errno.EACCES)


def run_exporter(
    operator: Any, path: Path, settings: dict[str, Any], newer_settings: dict[str, Any] | None = None
) -> None:
    """Run one of Blender's exporters. ``newer_settings`` are used only if this Blender version knows them."""
    try:
        known = {prop.identifier for prop in operator.get_rna_type().properties}
    except KeyError as error:
        message = f"This version of Blender cannot write {path.suffix[1:].upper()}."
        hint = "Enable the format's add-on in the preferences, or use a Blender that was built with it."
        raise ExporterMissing(message, where=f"Blender {bpy.app.version_string}", hint=hint) from error
    fitting = {name: value for name, value in (newer_settings or {}).items() if name in known}
    try:
        done = operator(filepath=os.path.abspath(path), check_existing=False, **settings, **fitting)
    except RuntimeError as error:
        _raise_if_disk(str(error), error)
        raise ExportFailed(f"Blender's exporter failed: {str(error).strip()}", where=path.name) from error
    if done != {"FINISHED"} or not path.is_file():
        hint = "See its messages in the console."
        raise ExportFailed("Blender's exporter wrote nothing.", where=path.name, hint=hint)


def _raise_if_disk(text: str, error: RuntimeError) -> None:
    """Raise ``OSError`` if the exporter's message contains a disk error."""
    for number in _DISK:
        if os.strerror(number) in text:
            raise OSError(number, os.strerror(number)) from error


_RESERVE = 2**20  # Bytes to leave free in addition to the estimate. Chosen by hand.
_OGAWA, _FROZEN = b"Ogawa", 0xFF
_CRATE = b"PXR-USDC"


def require_space(path: Path, estimate: int) -> None:
    """Raise ``OSError`` unless a file of about ``estimate`` bytes fits on its disk."""
    free = shutil.disk_usage(path.parent).free
    if free < estimate + _RESERVE:
        mib = f"about {estimate / 2**20:.0f} MiB are needed, {free / 2**20:.0f} MiB are free"
        raise OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}, {mib}")


def require_whole(path: Path) -> None:
    """Check that an Alembic (Ogawa) or USD (crate) file is complete.

    The sixth byte of an Ogawa archive is 255 once the archive is closed. The header of a crate ends with the offset of
    a table of contents, which is written last. Raises ``OSError`` if the file is incomplete.
    """
    with path.open("rb") as stream:
        head = stream.read(24)
    is_whole = {
        _OGAWA: head[5:6] == bytes([_FROZEN]),
        _CRATE[:5]: head[:8] == _CRATE and 0 < int.from_bytes(head[16:24], "little") < path.stat().st_size,
    }
    if not is_whole.get(head[:5], False):
        raise OSError(errno.ENOSPC, "the exporter stopped while writing the file. The disk may be full")


_FORWARD = {"Y": "-Z", "Z": "Y"}  # Axis in the file to which Blender's Y is mapped, for each up axis.


def export_fbx(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write FBX in metres or centimetres, with deforming bones, without leaf bones, and with a key at every frame."""
    settings = {
        "use_selection": True,
        "object_types": {"ARMATURE", "MESH"},
        "use_mesh_modifiers": False,
        "add_leaf_bones": False,
        "use_armature_deform_only": True,
        "apply_scale_options": "FBX_SCALE_ALL",  # the file declares the unit, so that no object is scaled
        "axis_forward": _FORWARD[take.layout.up],
        "axis_up": take.layout.up,
        "bake_anim": True,
        "bake_anim_use_nla_strips": False,
        "bake_anim_use_all_actions": False,
        "bake_anim_force_startend_keying": True,
        "bake_anim_simplify_factor": 0.0,
    }
    with plain_take(take, progress) as plain, chosen(plain):
        for modifier in [m for mesh in plain.meshes for m in mesh.modifiers if plain.is_plain]:
            modifier.show_viewport = False  # the exporter visits each frame, but reads the skin in its rest pose
        run_exporter(bpy.ops.export_scene.fbx, path, settings)


def export_gltf(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write binary glTF in metres, Y up, with a key at every frame."""
    settings = {"use_selection": True, "export_format": "GLB", "export_yup": True, "export_def_bones": True}
    settings |= {"use_active_scene": True}
    settings |= {"export_influence_nb": 4, "export_animations": True, "export_animation_mode": "SCENE"}
    settings |= {"export_anim_scene_split_object": False, "export_anim_slide_to_zero": True}
    settings |= {"export_force_sampling": True, "export_optimize_animation_size": False}
    with plain_take(take, progress) as plain, chosen(plain) as scene:
        # The exporter uses fps * fps_base as the frame rate, but the rate is fps / fps_base.
        scene.render.fps_base = 1 / scene.render.fps_base
        run_exporter(bpy.ops.export_scene.gltf, path, settings, {"export_leaf_bone": False})


_BYTES_PER_VERTEX, _BYTES_PER_FRAME = 250, 2000
_UNWRITABLE = "betas"
"""Custom property of a body that USD cannot store. Blender would print a warning about it in each frame."""


def export_usd(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write USD in metres, Z up, with a skeleton of the deforming bones and a sample at every frame."""
    settings = {"selected_objects_only": True, "export_animation": True, "export_materials": True}
    newer = {"export_armatures": True, "only_deform_bones": True, "export_shapekeys": True, "allow_unicode": True}
    newer |= {"convert_orientation": False, "convert_world_material": False, "root_prim_path": "/root"}
    vertices = sum(len(mesh.data.vertices) for mesh in take.meshes)
    require_space(path, _BYTES_PER_VERTEX * vertices + _BYTES_PER_FRAME * take.num_frames)
    with plain_take(take, progress) as plain, chosen(plain):
        if plain.is_plain:
            plain.armature.pop(_UNWRITABLE, None)
        run_exporter(bpy.ops.wm.usd_export, path, settings, newer)
    require_whole(path)


def export_blend(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write the armature and its meshes as a collection with the armature's name, without the scene."""
    action = current_action(take.armature)
    if action is not None and is_take(action) and not same_rate(take.fps, float(action["fps"])):
        hint = "Omit the frame rate, or choose another format."
        raise NothingToExport(
            "A Blender file keeps the keys of the take, so it cannot change the frame rate.", where=take.name, hint=hint
        )
    collection = bpy.data.collections.new(take.name)
    try:
        for obj in (take.armature, *take.meshes):
            collection.objects.link(obj)
        with _whole_paths(take):
            # Without a collection, Blender finds shape keys before their mesh and reports it.
            bpy.data.libraries.write(
                str(path.resolve()), {collection}, path_remap="ABSOLUTE", fake_user=True, compress=True
            )
    except OSError as error:
        raise OSError(errno.EIO, why_not_written(error)) from error
    finally:
        bpy.data.collections.remove(collection)


@contextmanager
def _whole_paths(take: ExportTake) -> Iterator[None]:
    action = current_action(take.armature)
    if action is None or not action.is_editable:
        yield
        return
    kept = {key: action[key] for key in PATHS if action.get(key)}
    try:
        for key in kept:
            action[key] = str(take_file(action, key).resolve())
        yield
    finally:
        for key, value in kept.items():
            action[key] = value


_CACHE = "vertices_{}.pc2"
_HEADER = Struct("<12siiffi")  # Signature, version, points, first frame, frames per sample, and samples.


@contextmanager
def sampled_meshes(take: ExportTake) -> Iterator[ExportTake]:
    """Yield the take unchanged, or with copies of its meshes that play a point cache.

    A point cache is needed if frames of the take are between scene frames, or if a Blender unit is not one metre.
    """
    if take.is_on_frames and take.metres_a_unit == 1.0:
        yield take
        return
    names = [mesh.name for mesh in take.meshes]
    with temporary_folder() as folder, temporary_copies(take.scene, take.meshes) as collection:
        files = [folder / _CACHE.format(number) for number in range(len(names))]
        _sample(take, files)
        copies = [_player(mesh, path, take, collection) for mesh, path in zip(take.meshes, files, strict=True)]
        swap_names(take.meshes, copies, names)
        yield replace(take, meshes=tuple(copies), first=take.frame_start, step=1.0, is_plain=True)


def _sample(take: ExportTake, files: list[Path]) -> None:
    """Write each mesh's vertices, in world metres, to a PC2 file (3ds Max's point cache format)."""
    scene, shown = take.scene, (take.scene.frame_current, take.scene.frame_subframe)
    with ExitStack() as stack:
        stack.callback(scene.frame_set, shown[0], subframe=shown[1])
        streams = [stack.enter_context(path.open("wb")) for path in files]
        for f, time in enumerate(take.times):
            go_to_frame(scene, float(time))
            depsgraph = bpy.context.evaluated_depsgraph_get()
            for mesh, stream in zip(take.meshes, streams, strict=True):
                evaluated = mesh.evaluated_get(depsgraph)
                world = take.metres_a_unit * np.array(evaluated.matrix_world)[:3]
                vertices = positions(evaluated.data.vertices) @ world[:, :3].T + world[:, 3]
                if f == 0:
                    stream.write(_HEADER.pack(b"POINTCACHE2", 1, len(vertices), take.frame_start, 1.0, take.num_frames))
                stream.write(vertices.astype("<f4").tobytes())


def _player(mesh: bpy.types.Object, path: Path, take: ExportTake, collection: bpy.types.Collection) -> bpy.types.Object:
    evaluated = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
    copy = bpy.data.objects.new(mesh.name, bpy.data.meshes.new_from_object(evaluated))
    collection.objects.link(copy)
    cache = copy.modifiers.new("Samples", "MESH_CACHE")
    cache.cache_format, cache.filepath = "PC2", str(path)
    cache.frame_start = take.frame_start
    return copy


_BYTES_PER_SAMPLE = 14  # Bytes per vertex and frame: three floats plus a reserve.


def export_alembic(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write the moving meshes to Alembic, which does not store bones."""
    if not take.meshes:
        hint = "Alembic stores meshes. Choose a format that stores bones."
        raise NothingToExport("The armature does not deform a mesh.", where=take.name, hint=hint)
    vertices = sum(len(mesh.data.vertices) for mesh in take.meshes)
    require_space(path, _BYTES_PER_SAMPLE * vertices * take.num_frames)
    with sampled_meshes(take) as sampled, chosen(sampled):
        frames = {"start": sampled.frame_start, "end": sampled.frame_end, "as_background_job": False}
        parts = {"selected": True, "global_scale": 1.0, "uvs": True, "normals": True, "face_sets": True}
        run_exporter(bpy.ops.wm.alembic_export, path, {**frames, **parts})
    require_whole(path)
