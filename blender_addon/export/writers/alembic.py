"""Alembic by Blender's exporter: the skinned vertices of every frame. Metres, Y up as Alembic has it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from struct import Struct

import bpy
import numpy as np

from ..._exchange.outputs import temporary_folder
from ..._exchange.progress import Progress
from ...body.mesh import positions
from ...conventions.timing import go_to_frame
from ...errors import NothingToExport
from ..plain_take import swap_names, temporary_copies
from ..take import ExportTake, chosen
from .blender_exporters import require_space, require_whole, run_exporter

_CACHE = "vertices_{}.pc2"
_HEADER = Struct("<12siiffi")  # Signature, version, points, first frame, frames per sample and samples.


@contextmanager
def sampled_meshes(take: ExportTake) -> Iterator[ExportTake]:
    """Yield a take on the scene's frames in metres: itself, or temporary copies of its meshes.

    Copies play the sampled vertices from a point cache, one sample per scene frame, under the meshes' names.
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
    """Write the world's vertices in metres of each mesh to a file (PC2, as 3ds Max has it)."""
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


_BYTES_PER_VERTEX = 14  # Of each frame: three floats, and a little more.


def export_alembic(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write the meshes as they move. Alembic holds no bones.

    Raises:
        NothingToExport: the armature deforms no mesh.
        OSError: the disk is too full for it.
    """
    if not take.meshes:
        hint = "Alembic holds vertices: choose a format with bones."
        raise NothingToExport("The armature deforms no mesh.", where=take.name, hint=hint)
    vertices = sum(len(mesh.data.vertices) for mesh in take.meshes)
    require_space(path, _BYTES_PER_VERTEX * vertices * take.num_frames)
    with sampled_meshes(take) as sampled, chosen(sampled):
        frames = {"start": sampled.frame_start, "end": sampled.frame_end, "as_background_job": False}
        parts = {"selected": True, "global_scale": 1.0, "uvs": True, "normals": True, "face_sets": True}
        run_exporter(bpy.ops.wm.alembic_export, path, {**frames, **parts})
    require_whole(path)
