"""Make job files from a scene's settings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from .._exchange.capture_file import portable_path
from .._exchange.errors import OutputNotWritable
from .._exchange.job_file import JobFile
from .._exchange.outputs import write_text
from ..body.shape import body_mesh, get_betas
from ..conventions.file_paths import file_of
from ..conventions.timing import scene_frame_rate
from ..errors import TakeMissing
from ..review.ranges import SceneRange, resolve_of
from ..solving.take_paths import capture_folder, next_take
from .project_files import files_folder, usable


def prepare_job(
    scene: bpy.types.Scene,
    frames: SceneRange | None,
    of: bpy.types.PropertyGroup | None = None,
    person: int | None = None,
) -> tuple[JobFile, Path]:
    """Write the files of a person's job, and return the job and its path.

    ``frames`` is a range to solve again. Raises ``MocapError`` if takes cannot be written, or a file in the settings
    does not exist.
    """
    settings, capture = scene.mocap.solve, scene.mocap.capture if of is None else of
    person = capture.person_index if person is None else person
    source, markers = capture_file(capture), bool(len(capture.marker_items))
    is_calibrated, is_noisy = markers and frames is None, not markers
    subject = _file_of(settings, "subject", "Calibrate the subject again") if is_calibrated else None
    noise = _file_of(settings, "noise", "Measure it again (cameras noise)") if is_noisy else None
    objects = _file_of(settings, "objects", "Choose the file again")
    starts = frames is None and capture.takes_network
    network = _file_of(capture, "network", "Choose the file again") if starts else None
    resolve = None if frames is None else resolve_of(frames)
    take = next_take(_take_folder(scene, capture, source))
    layout = write_layout(capture, take.motion.with_suffix(".layout.json"))
    armature = capture.review_of(person).armature
    mesh = body_mesh(armature) if armature is not None else None
    keeps_shape = subject is None and (settings.keep_shape or frames is not None)
    more = {
        "betas": [round(float(v), 6) for v in get_betas(mesh)] if mesh is not None and keeps_shape else None,
        "layout": layout and layout.name,
        "leave_out": capture.leave_out(scene_frame_rate(scene)),
        "noise": noise and str(noise),
        "objects": objects and str(objects),
    }
    values = {name: value for name, value in settings.values().items() if name not in more}
    job = JobFile(
        capture=source,
        out=take.motion,
        report=take.report if settings.report and capture.file else None,
        person=capture.people[person].key if len(capture.people) else None,
        subject=subject,
        start_from=() if network is None else (str(network),),
        labels=_write_labels(capture, take.motion.with_suffix(".labels.json")),
        settings=values | {name: value for name, value in more.items() if value},
        resolve=resolve,
    )
    return job, take.job


def _take_folder(scene: bpy.types.Scene, capture: bpy.types.PropertyGroup, source: Path) -> Path:
    folder = source.parent
    if not capture.file:
        own = files_folder(scene)
        folder = folder if source.is_relative_to(own) else capture_folder(own, source)
    return folder_of_takes(scene, folder)


def portable_job(job: JobFile, folder: Path) -> JobFile:
    """Return a job with paths relative to its folder where possible, so that the folder can be moved."""

    def portable(path: Path | None) -> Any:
        return path and Path(portable_path(path, folder))

    resolve = job.resolve and replace(job.resolve, motion=portable(job.resolve.motion))
    moved = {name: portable(getattr(job, name)) for name in ("capture", "out", "report", "subject")}
    starts = tuple(str(portable(Path(text))) for text in job.start_from)
    return replace(job, **moved, start_from=starts, labels=portable(job.labels), resolve=resolve)


def capture_file(capture: bpy.types.PropertyGroup) -> Path:
    """Return the file of a capture. Raises ``TakeMissing`` if it no longer exists."""
    path = file_of(capture.measured)
    if not path.is_file():
        raise TakeMissing("The capture file no longer exists.", where=str(path), hint="Import it again.")
    return path


def write_layout(capture: bpy.types.PropertyGroup, path: Path) -> Path | None:
    """Write the bones that the user assigned to markers, and return the file or None."""
    places = {item.name: item.place for item in capture.marker_items if item.place is not None}
    values = {"format": "manifold_mocap_labels", "version": 1, "places": places}
    return _write(path, values) if places else None


def _write_labels(capture: bpy.types.PropertyGroup, path: Path) -> Path | None:
    points = [{"point": item.point, "frame": item.frame, "marker": item.marker} for item in capture.point_labels]
    return _write(path, {"format": "manifold_mocap_user_labels", "version": 1, "points": points}) if points else None


def _write(path: Path, values: dict[str, Any]) -> Path:
    return write_text(path, json.dumps(values, indent=1, ensure_ascii=False) + "\n", overwrite=True)


def _file_of(settings: bpy.types.PropertyGroup, name: str, remedy: str) -> Path | None:
    """Return the file in a property, None if it is empty. A missing file is an error."""
    if not getattr(settings, name):
        return None
    path, label = file_of(getattr(settings, name)), settings.bl_rna.properties[name].name
    if not path.is_file():
        hint = f"{remedy}, or clear the field {label}."
        raise TakeMissing(f"The file of {label} no longer exists.", where=str(path), hint=hint)
    return path


def folder_of_takes(scene: bpy.types.Scene, preferred: Path) -> Path:
    """Return a writable folder for takes, by preference the chosen one."""
    try:
        return usable(preferred)
    except OutputNotWritable:
        return usable(files_folder(scene) / preferred.name)
