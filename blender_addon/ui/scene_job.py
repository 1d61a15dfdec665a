"""The job of a scene's settings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy

from .._exchange.capture_file import portable_path
from .._exchange.errors import OutputNotWritable
from .._exchange.job_file import JobFile
from .._exchange.outputs import write_text
from ..body.shape import get_betas
from ..body.sliders import body_mesh
from ..conventions.file_paths import file_of
from ..conventions.timing import scene_frame_rate
from ..errors import TakeMissing
from ..review.pinning import FrameRange, resolve_of
from ..solving.take_paths import capture_folder, next_take
from .locations import files_folder, usable


def prepare_job(
    scene: bpy.types.Scene,
    frames: FrameRange | None,
    of: bpy.types.PropertyGroup | None = None,
    person: int | None = None,
) -> tuple[JobFile, Path]:
    """Return the job of the scene's settings and the path it is to be written to.

    Args:
        scene: the scene.
        frames: a range to solve again, None for the whole take.
        of: one of the scene's captures; None for the one panels are about.
        person: index of one of its people; None for the one panels are about.

    Takes go beside their capture, or where new captures go if that folder has become read-only.

    Raises:
        OutputNotWritable: takes cannot be written where they should go.
        TakeMissing: the capture, the motion to solve again, or a file of the settings is no longer on the disk.
    """
    settings = scene.mocap
    chosen = settings.capture if of is None else of
    index = chosen.person_index if person is None else person
    review, capture = chosen.review_of(index), capture_file(chosen)
    take = next_take(folder_of_takes(scene, capture.parent if chosen.file else _own_folder(scene, capture)))
    values, subject = settings.solve.values(), _subject(settings, chosen) if frames is None else None
    mesh = body_mesh(review.armature) if review.armature is not None else None
    if mesh is not None and subject is None and (settings.solve.keep_shape or frames is not None):
        values["betas"] = [round(float(v), 6) for v in get_betas(mesh)]
    layout = written_layout(chosen, take.job.with_name(take.job.name.replace(".job.json", ".layout.json")))
    told = written_told(chosen, take.job.with_name(take.job.name.replace(".job.json", ".told.json")))
    if left_out := chosen.leave_out(scene_frame_rate(scene)):
        values["leave_out"] = left_out
    if layout is not None:
        values["layout"] = layout.name
    if settings.solve.noise and not chosen.marker_items:
        values["noise"] = str(_detectors_noise(settings))
    report = take.report if settings.solve.report and chosen.file else None
    whom = chosen.people[index].key if chosen.people else None
    job = JobFile(
        capture=capture, out=take.motion, report=report, person=whom, subject=subject, told=told, settings=values
    )
    if frames is not None:
        job = replace(job, resolve=resolve_of(frames))
    return job, take.job


def _own_folder(scene: bpy.types.Scene, motion: Path) -> Path:
    """Return where takes of a motion go that came without its recording: never into the library it is from."""
    own = files_folder(scene)
    return motion.parent if motion.is_relative_to(own) else capture_folder(own, motion)


def portable_job(job: JobFile, folder: Path) -> JobFile:
    """Return a job as a file in this folder says it: what lies in the folder by its name, so that it may move."""
    resolve = job.resolve and replace(job.resolve, motion=Path(portable_path(job.resolve.motion, folder)))
    report = job.report and Path(portable_path(job.report, folder))
    subject = job.subject and Path(portable_path(job.subject, folder))
    told = job.told and Path(portable_path(job.told, folder))
    capture, out = (Path(portable_path(path, folder)) for path in (job.capture, job.out))
    return replace(job, capture=capture, out=out, report=report, subject=subject, told=told, resolve=resolve)


def capture_file(capture: bpy.types.PropertyGroup) -> Path:
    """Return the file of a capture's settings.

    Raises:
        TakeMissing: it is no longer on the disk.
    """
    path = file_of(capture.measured)
    if not path.is_file():
        raise TakeMissing("The capture file is gone.", where=str(path), hint="Import the capture again.")
    return path


def written_layout(capture: bpy.types.PropertyGroup, path: Path) -> Path | None:
    """Write what markers are attached to by hand, and return the file, None where nothing is.

    Raises:
        OutputNotWritable: see ``write_text``.
    """
    import json

    places = {item.name: item.place for item in capture.marker_items if item.place is not None}
    if not places:
        return None
    values = {"format": "manifold_mocap_labels", "version": 1, "places": places}
    return write_text(path, json.dumps(values, indent=1, ensure_ascii=False) + "\n", overwrite=True)


def written_told(capture: bpy.types.PropertyGroup, path: Path) -> Path | None:
    """Write the names that were given to points, and return the file, None where there are none.

    Raises:
        OutputNotWritable: see ``write_text``.
    """
    import json

    points = [{"point": item.point, "frame": item.frame, "marker": item.marker} for item in capture.told]
    if not points:
        return None
    values = {"format": "manifold_mocap_told_points", "version": 1, "points": points}
    return write_text(path, json.dumps(values, indent=1) + "\n", overwrite=True)


def _subject(settings: bpy.types.PropertyGroup, capture: bpy.types.PropertyGroup) -> Path | None:
    """Return the file of the calibrated person of a recording of markers, None where there is none."""
    if not settings.solve.subject or not capture.marker_items:
        return None
    path = file_of(settings.solve.subject)
    if not path.is_file():
        hint = "Calibrate the subject again, or empty the field Subject."
        raise TakeMissing("The file of the calibrated subject is gone.", where=str(path), hint=hint)
    return path


def _detectors_noise(settings: bpy.types.PropertyGroup) -> Path:
    path = file_of(settings.solve.noise)
    if not path.is_file():
        hint = "Measure it again (detector-noise), or empty the field Detector's Noise."
        raise TakeMissing("The file of the detector's noise is gone.", where=str(path), hint=hint)
    return path


def folder_of_takes(scene: bpy.types.Scene, beside_capture: Path) -> Path:
    """Return where takes of a capture go: beside it, or to the folder of captures if that cannot be written to.

    Raises:
        OutputNotWritable: neither can.
    """
    try:
        return usable(beside_capture)
    except OutputNotWritable:
        return usable(files_folder(scene) / beside_capture.name)
