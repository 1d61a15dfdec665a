"""A Blender file with the body alone: rig, controls, skin and take, to be appended or linked."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy

from ..._exchange.progress import Progress
from ...animation.curves import current_action, is_take, same_rate
from ...animation.takes import PATHS, take_file
from ...errors import NothingToExport
from ...scene.session import why_not_written
from ..take import ExportTake


def export_blend(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write the armature and its meshes as a collection of the armature's name, without their scene.

    Raises:
        NothingToExport: another frame rate than the take's is asked for.
        OSError: Blender cannot write it.
    """
    action = current_action(take.armature)
    if action is not None and is_take(action) and not same_rate(take.fps, float(action["fps"])):
        hint = "Leave the frame rate out, or choose another format."
        raise NothingToExport("A Blender file holds the keys that the take has.", where=take.name, hint=hint)
    collection = bpy.data.collections.new(take.name)
    try:
        for obj in (take.armature, *take.meshes):
            collection.objects.link(obj)
        with _whole_paths(take):
            # A collection: Blender finds shape keys before their mesh among loose objects, and reports it.
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
