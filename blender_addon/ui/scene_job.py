"""The job of a scene's settings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy

from .._exchange.errors import OutputNotWritable
from .._exchange.job_file import JobFile
from ..body.shape import get_betas
from ..body.sliders import body_mesh
from ..errors import TakeMissing
from ..review.pinning import FrameRange, resolve_of
from ..solving.take_paths import next_take
from .locations import files_folder, usable


def prepare_job(scene: bpy.types.Scene, frames: FrameRange | None) -> tuple[JobFile, Path]:
    """Return the job of the scene's settings and the path it is to be written to.

    Takes go beside their capture, or where new captures go if that folder has become read-only.

    Raises:
        OutputNotWritable: takes cannot be written where they should go.
        TakeMissing: the capture, or the motion to solve again, is no longer on the disk.
    """
    settings = scene.mocap
    capture = Path(settings.capture.file)
    if not capture.is_file():
        raise TakeMissing("The capture file is gone.", where=str(capture), hint="Import the capture again.")
    take = next_take(_folder_of_takes(scene, capture.parent))
    values = settings.solve.values()
    mesh = body_mesh(settings.review.armature) if settings.review.armature is not None else None
    if mesh is not None and (settings.solve.keep_shape or frames is not None):
        values["betas"] = [round(float(v), 6) for v in get_betas(mesh)]
    job = JobFile(
        capture=capture, out=take.motion, report=take.report if settings.solve.report else None, settings=values
    )
    if frames is not None:
        job = replace(job, resolve=resolve_of(frames, scene))
    return job, take.job


def _folder_of_takes(scene: bpy.types.Scene, beside_capture: Path) -> Path:
    try:
        return usable(beside_capture)
    except OutputNotWritable:
        return usable(files_folder(scene) / beside_capture.name)
