"""The job of a scene's settings."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import bpy

from .._exchange.capture_file import portable_path
from .._exchange.errors import OutputNotWritable
from .._exchange.job_file import JobFile, JobRange
from .._exchange.outputs import write_text
from ..body.shape import body_mesh, get_betas
from ..conventions.file_paths import file_of
from ..conventions.timing import scene_frame_rate
from ..errors import TakeMissing
from ..review.ranges import SceneRange, resolve_of
from ..solving.take_paths import TakeFiles, capture_folder, next_take
from .project_files import files_folder, usable

_SUBJECT = ("the calibrated subject", "Calibrate the subject again")
_NOISE = ("the detector's noise", "Measure it again (detector-noise)")
"""What is missing where such a file is gone, and how it is made anew."""


@dataclass(frozen=True)
class SolveRequest:
    """What a scene wants solved."""

    scene: bpy.types.Scene
    capture: bpy.types.PropertyGroup
    """One of the scene's captures."""
    person: int
    """Index of one of its people."""
    frames: SceneRange | None
    """A range to solve again, None for the whole take."""


@dataclass(frozen=True)
class CheckedFiles:
    """The files that a solve reads; each was there when it was looked for."""

    capture: Path
    subject: Path | None
    """Of the calibrated person, None where markers are calibrated on the take itself."""
    noise: Path | None
    """Of the detector's noise, None for none."""
    resolve: JobRange | None
    """What is solved again, None for the whole take."""


def prepare_job(
    scene: bpy.types.Scene,
    frames: SceneRange | None,
    of: bpy.types.PropertyGroup | None = None,
    person: int | None = None,
) -> tuple[JobFile, Path]:
    """Return the job of the scene's settings and the path it is to be written to, after writing the files it names.

    Args:
        scene: the scene.
        frames: a range to solve again, None for the whole take.
        of: one of the scene's captures; None for the one panels are about.
        person: index of one of its people; None for the one panels are about.

    Raises:
        OutputNotWritable: takes cannot be written where they should go.
        TakeMissing: the capture, the motion to solve again, or a file of the settings is no longer on the disk.
    """
    capture = scene.mocap.capture if of is None else of
    request = SolveRequest(scene, capture, capture.person_index if person is None else person, frames)
    files = check_files(request)
    take = name_take(request, files.capture)
    layout, labels = write_inputs(capture, take)
    return build_job(request, files, take, layout, labels), take.job


def check_files(request: SolveRequest) -> CheckedFiles:
    """Return the files that a solve reads.

    Raises:
        TakeMissing: one of them is no longer on the disk.
    """
    settings, capture, frames = request.scene.mocap.solve, request.capture, request.frames
    markers = bool(capture.marker_items)
    return CheckedFiles(
        capture=capture_file(capture),
        subject=_file_of(settings, "subject", *_SUBJECT) if markers and frames is None else None,
        noise=None if markers else _file_of(settings, "noise", *_NOISE),
        resolve=None if frames is None else resolve_of(frames),
    )


def name_take(request: SolveRequest, capture: Path) -> TakeFiles:
    """Return the files of the next take: beside its capture, or where new captures go if that is read-only.

    A motion that came without its recording gets a folder of its own: nothing goes into the library it is from.

    Raises:
        OutputNotWritable: takes cannot be written there.
    """
    folder = capture.parent
    if not request.capture.file:
        own = files_folder(request.scene)
        folder = folder if capture.is_relative_to(own) else capture_folder(own, capture)
    return next_take(folder_of_takes(request.scene, folder))


def write_inputs(capture: bpy.types.PropertyGroup, take: TakeFiles) -> tuple[Path | None, Path | None]:
    """Write the layout and the names that were set by hand beside a take; None for what there is none of.

    Raises:
        OutputNotWritable: see ``write_text``.
    """
    beside = (take.motion.with_suffix(f".{what}.json") for what in ("layout", "labels"))
    return write_layout(capture, next(beside)), write_labels(capture, next(beside))


def build_job(
    request: SolveRequest, files: CheckedFiles, take: TakeFiles, layout: Path | None, labels: Path | None
) -> JobFile:
    """Return the job of a request, from its scene's settings.

    Args:
        request: what is to be solved.
        files: what it reads.
        take: what it writes.
        layout: the marker layout set by hand, None for none.
        labels: the names of points set by hand, None for none.
    """
    capture, solve = request.capture, request.scene.mocap.solve
    armature = capture.review_of(request.person).armature
    mesh = body_mesh(armature) if armature is not None else None
    keeps_shape = files.subject is None and (solve.keep_shape or request.frames is not None)
    more = {
        "betas": [round(float(v), 6) for v in get_betas(mesh)] if mesh is not None and keeps_shape else None,
        "layout": layout and layout.name,
        "leave_out": capture.leave_out(scene_frame_rate(request.scene)),
        "noise": files.noise and str(files.noise),
    }
    values = {name: value for name, value in solve.values().items() if name not in more}
    return JobFile(
        capture=files.capture, out=take.motion, report=take.report if solve.report and capture.file else None,
        person=capture.people[request.person].key if capture.people else None, subject=files.subject, labels=labels,
        settings=values | {name: value for name, value in more.items() if value}, resolve=files.resolve,
    )  # fmt: skip


def portable_job(job: JobFile, folder: Path) -> JobFile:
    """Return a job as a file in this folder states it: what lies in the folder by its name, so that it may move."""
    resolve = job.resolve and replace(job.resolve, motion=Path(portable_path(job.resolve.motion, folder)))
    report = job.report and Path(portable_path(job.report, folder))
    subject = job.subject and Path(portable_path(job.subject, folder))
    labels = job.labels and Path(portable_path(job.labels, folder))
    capture, out = (Path(portable_path(path, folder)) for path in (job.capture, job.out))
    return replace(job, capture=capture, out=out, report=report, subject=subject, labels=labels, resolve=resolve)


def capture_file(capture: bpy.types.PropertyGroup) -> Path:
    """Return the file of a capture's settings.

    Raises:
        TakeMissing: it is no longer on the disk.
    """
    path = file_of(capture.measured)
    if not path.is_file():
        raise TakeMissing("The capture file no longer exists.", where=str(path), hint="Import the capture again.")
    return path


def write_layout(capture: bpy.types.PropertyGroup, path: Path) -> Path | None:
    """Write what markers are attached to by hand, and return the file, None where nothing is.

    Raises:
        OutputNotWritable: see ``write_text``.
    """
    places = {item.name: item.place for item in capture.marker_items if item.place is not None}
    if not places:
        return None
    values = {"format": "manifold_mocap_labels", "version": 1, "places": places}
    return write_text(path, json.dumps(values, indent=1, ensure_ascii=False) + "\n", overwrite=True)


def write_labels(capture: bpy.types.PropertyGroup, path: Path) -> Path | None:
    """Write the names that were given to points, and return the file, None where there are none.

    Raises:
        OutputNotWritable: see ``write_text``.
    """
    points = [{"point": item.point, "frame": item.frame, "marker": item.marker} for item in capture.told]
    if not points:
        return None
    values = {"format": "manifold_mocap_user_labels", "version": 1, "points": points}
    return write_text(path, json.dumps(values, indent=1) + "\n", overwrite=True)


def _file_of(settings: bpy.types.PropertyGroup, name: str, what: str, again: str) -> Path | None:
    """Return the file that a property names, None where it is empty.

    Args:
        settings: the property group.
        name: of the property.
        what: is in the file, for the message.
        again: how to make it anew, for the hint.

    Raises:
        TakeMissing: it is no longer on the disk.
    """
    if not getattr(settings, name):
        return None
    path, label = file_of(getattr(settings, name)), settings.bl_rna.properties[name].name
    if not path.is_file():
        hint = f"{again}, or empty the field {label}."
        raise TakeMissing(f"The file of {what} no longer exists.", where=str(path), hint=hint)
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
