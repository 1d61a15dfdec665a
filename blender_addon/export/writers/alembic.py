"""Alembic by Blender's exporter: the skinned vertices of every frame; metres, Y up as Alembic has it."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..._exchange.progress import Progress
from ...errors import NothingToExport
from ..take import ExportTake, chosen
from .blender_exporters import run_exporter
from .whole_files import require_space, require_whole

_BYTES_PER_VERTEX = 14
"""Of each frame: three floats, and a little more."""


def export_alembic(path: Path, take: ExportTake, progress: Progress) -> None:
    """Write the meshes as they move; Alembic holds no bones.

    Raises:
        NothingToExport: the armature deforms no mesh.
        OSError: the disk is too full for it.
    """
    if not take.meshes:
        raise NothingToExport(
            "The armature deforms no mesh.", where=take.name, hint="Alembic holds vertices: choose a format with bones."
        )
    progress("exporting Alembic", 0, 1)
    vertices = sum(len(mesh.data.vertices) for mesh in take.meshes)
    require_space(path, _BYTES_PER_VERTEX * vertices * take.num_frames)
    with chosen(take):
        run_exporter(
            bpy.ops.wm.alembic_export,
            path,
            {
                "selected": True,
                "start": take.frame_start,
                "end": take.frame_end,
                "global_scale": 1.0,
                "uvs": True,
                "normals": True,
                "face_sets": True,
                "as_background_job": False,
            },
        )
    require_whole(path)
    progress("exporting Alembic", 1, 1)
