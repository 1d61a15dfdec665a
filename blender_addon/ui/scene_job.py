"""Make job files from a scene's settings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .._exchange.capture_file import portable_path
from .._exchange.errors import JobInvalid, OutputNotWritable
from .._exchange.job_file import JobFile
from .._exchange.outputs import write_text
from ..body.mesh import positions
from ..body.shape import body_mesh, get_betas
from ..conventions.file_paths import file_of
from ..conventions.timing import scene_frame_rate
from ..errors import TakeMissing
from ..review.ranges import SceneRange, resolve_of
from ..scene.session import alone, go_to_frame
from ..solving.take_paths import capture_folder, next_take, safe_name
from .project_files import files_folder, usable

_SAMPLES, _REST_M = 8, 1e-3  # Frames checked for movement, and the largest movement in metres that is ignored.


def prepare_job(
    scene: bpy.types.Scene,
    frames: SceneRange | None,
    of: bpy.types.PropertyGroup | None = None,
    person: int | None = None,
) -> tuple[JobFile, Path]:
    """Return the job that solves a person with the scene's settings, and the path for its job file.

    Marker labels, the marker layout and the contact mesh are written next to it. ``frames`` is a range to solve again.
    Raises ``MocapError`` if the folder cannot be written, or if a file named in the settings does not exist.
    """
    settings, capture = scene.mocap.solve, scene.mocap.capture if of is None else of
    person = capture.person_index if person is None else person
    source, markers = capture_file(capture), bool(len(capture.marker_items))
    is_calibrated, is_noisy = markers and frames is None, not markers
    subject = _file_of(settings, "subject", "Calibrate the subject again") if is_calibrated else None
    noise = _file_of(settings, "noise", "Measure it again (cameras noise)") if is_noisy else None
    chosen = settings.contact_mesh
    objects = None if chosen else _file_of(settings, "objects", "Choose the file again")
    starts = frames is None and capture.takes_network
    network = _file_of(capture, "network", "Choose the file again") if starts else None
    resolve = None if frames is None else resolve_of(frames)
    take = next_take(_take_folder(scene, capture, source))
    layout = write_layout(capture, take.motion.with_suffix(".layout.json"))
    armature = capture.review_of(person).armature
    mesh = body_mesh(armature) if armature is not None else None
    shape = chosen and _write_mesh(scene, chosen, armature, take.motion)
    keeps_shape = subject is None and (settings.keep_shape or frames is not None)
    more = {
        "betas": [round(float(v), 6) for v in get_betas(mesh)] if mesh is not None and keeps_shape else None,
        "layout": layout and layout.name,
        "leave_out": capture.leave_out(scene_frame_rate(scene)),
        "noise": noise and str(noise),
        "objects": shape.name if shape else objects and str(objects),
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
    """Return the path of a capture's file. Raises ``TakeMissing`` if it no longer exists."""
    path = file_of(capture.measured)
    if not path.is_file():
        raise TakeMissing("The capture file no longer exists.", where=str(path), hint="Import it again.")
    return path


def write_layout(capture: bpy.types.PropertyGroup, path: Path) -> Path | None:
    """Write the bones that the user assigned to markers. Return the file, or None without assignments."""
    places = {item.name: item.place for item in capture.marker_items if item.place is not None}
    values = {"format": "manifold_mocap_labels", "version": 1, "places": places}
    return _write(path, values) if places else None


def _write_labels(capture: bpy.types.PropertyGroup, path: Path) -> Path | None:
    points = [{"point": item.point, "frame": item.frame, "marker": item.marker} for item in capture.point_labels]
    return _write(path, {"format": "manifold_mocap_user_labels", "version": 1, "points": points}) if points else None


def _write_mesh(
    scene: bpy.types.Scene, chosen: bpy.types.Object, armature: bpy.types.Object | None, motion: Path
) -> Path:
    """Write a contact mesh, as shown in the viewport, to an OBJ file in metres relative to the body.

    Raises ``JobInvalid`` if the object is hidden in the viewport, has no faces, or moves.
    """
    label, depsgraph = f"{chosen.name} in the Contact Mesh field", bpy.context.evaluated_depsgraph_get()
    if chosen not in [*scene.objects]:
        raise JobInvalid(f"{label} is not in the scene.", hint="Choose another object, or clear the field.")
    if chosen not in {block.original for block in depsgraph.ids}:
        raise JobInvalid(f"{label} is disabled in viewports.", hint="Enable the object and its collection.")
    if chosen.mode == "EDIT":
        raise JobInvalid(f"{label} is in Edit Mode.", hint="Leave Edit Mode.")
    T_world_body = np.eye(4) / scene.unit_settings.scale_length if armature is None else np.array(armature.matrix_world)
    T_world_body[3, 3] = 1.0
    points, faces = _shown_mesh(chosen, depsgraph)
    if not len(faces):
        raise JobInvalid(f"{label} has no faces.", hint="Choose a closed mesh.")
    if not np.linalg.det(T_world_body) or not np.linalg.det(chosen.matrix_world):
        raise JobInvalid(f"{label}, or the body, has a scale of 0.", hint="Change the scale, or choose another object.")
    if _moves(chosen, scene):
        hint = "The object must not move during the take. Remove its animation, or choose another object."
        raise JobInvalid(f"{label} moves.", hint=hint)
    R, t = np.split(np.linalg.inv(T_world_body)[:3], [3], axis=1)
    rows = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points @ R.T + t.T]
    rows += ["f " + " ".join(str(1 + corner) for corner in face) for face in faces]
    path = motion.with_name(f"{motion.stem}_{safe_name(chosen.name)}.obj")
    return write_text(path, "\n".join(rows) + "\n", overwrite=True)


def _shown_mesh(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> tuple[np.ndarray, np.ndarray]:
    """Return an evaluated object's vertices (V, 3) in world coordinates and its triangles (T, 3)."""
    shown = obj.evaluated_get(depsgraph)
    mesh = shown.to_mesh()
    try:
        mesh.calc_loop_triangles()
        R, t = np.split(np.array(shown.matrix_world)[:3], [3], axis=1)
        faces = np.array([face.vertices for face in mesh.loop_triangles], dtype=int).reshape(-1, 3)
        return positions(mesh.vertices) @ R.T + t.T, faces
    finally:
        shown.to_mesh_clear()


def _moves(obj: bpy.types.Object, scene: bpy.types.Scene) -> bool:
    """Return whether physics moves an object, or whether a vertex moves during ``_SAMPLES`` frames of the scene."""
    if obj.rigid_body is not None and obj.rigid_body.type == "ACTIVE":
        return True
    seen = list[np.ndarray]()
    with alone(obj, scene) as (stage, depsgraph):
        for frame in np.linspace(scene.frame_start, scene.frame_end, _SAMPLES).round():
            go_to_frame(stage, float(frame))
            seen.append(_shown_mesh(obj, depsgraph)[0])
    first, rest = seen[0], _REST_M / scene.unit_settings.scale_length
    return any(len(points) != len(first) or np.abs(points - first).max(initial=0) > rest for points in seen)


def _write(path: Path, values: dict[str, Any]) -> Path:
    return write_text(path, json.dumps(values, indent=1, ensure_ascii=False) + "\n", overwrite=True)


def _file_of(settings: bpy.types.PropertyGroup, name: str, remedy: str) -> Path | None:
    """Return the file that a property names, or None if it is empty. Raise ``TakeMissing`` for a lost file."""
    if not getattr(settings, name):
        return None
    path, label = file_of(getattr(settings, name)), settings.bl_rna.properties[name].name
    if not path.is_file():
        hint = f"{remedy}, or clear the {label} field."
        raise TakeMissing(f"The file for {label} no longer exists.", where=str(path), hint=hint)
    return path


def folder_of_takes(scene: bpy.types.Scene, preferred: Path) -> Path:
    """Return a writable folder for takes: the preferred one if possible."""
    try:
        return usable(preferred)
    except OutputNotWritable:
        return usable(files_folder(scene) / preferred.name)
