"""``bake`` and ``render``: motion file in; Blender file, preview video and contact sheet out."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .._exchange.capture_file import read_capture
from .._exchange.motion_file import MotionFile, read_motion
from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress
from ..body.body_choice import body_path_of, require_body
from ..body.body_file import read_body
from ..conventions.naming import PERSON_LOOK
from .result import TimedResult

if TYPE_CHECKING:
    import bpy

    from ..animation.takes import SolveFiles
    from ..render.subject import RenderedTake

_CHECKED_FRAMES = 8
"""Frames of a bake that are compared with the motion; chosen by hand."""
_TOLERATED_MM = 1.0


@dataclass(frozen=True)
class BakeRequest:
    """What to bake and what to write."""

    motion: Path
    """Motion file."""
    out: Path
    """Folder of the outputs."""
    capture: Path | None = None
    """Capture file the motion was solved from."""
    body: Path | None = None
    """Body file; None for the one the motion was solved for."""
    blend: bool = True
    """Write the Blender file."""
    video: bool = True
    """Write the preview video."""
    pictures: bool = True
    """Write the contact sheet."""
    keys_per_second: float | None = None
    """About how many of the solver's keys to keep; None for a key on every frame."""
    tolerance_mm: float | None = None
    """How far any joint may be from the full take, with as few keys as that needs; None for no thinning by it."""
    fps: float | None = None
    """Frame rate of the file's scene; None for the motion's own."""
    asset: bool = False
    """Mark the action as an asset."""
    overwrite: bool = False
    """Replace files that are there."""
    look: str = PERSON_LOOK
    """One of ``conventions.looks``."""
    footage_from: tuple[Path, ...] = ()
    """Folders that footage may lie in, beside the capture's own; of a file, the folder it is in."""


class BakeResult(TimedResult):
    """Of ``bake`` and ``render``."""

    baked_s: float


def run_bake(request: BakeRequest, progress: Progress) -> BakeResult:
    """Bake a motion into a new file and write ``<name>.blend``, ``<name>.mp4`` and ``<name>_contact.png``.

    All files are written or none.

    Returns:
        The ``result`` event of the progress protocol: outputs, notes, frames, seconds and deviations in millimetres.

    Raises:
        MocapError: an input is missing or wrong, an output exists, or Blender cannot render.
    """
    from ..animation.takes import PERSON, person_of
    from ..body.looks import show_look
    from ..render.subject import RenderedTake
    from ..scene.bake import BakeSettings, bake_take
    from ..scene.footage import near_footage
    from ..scene.session import frame_viewports, fresh_scene, save_file

    start = time.monotonic()
    motion = read_motion(request.motion)
    body = read_body(request.body or body_path_of(motion.provenance), motion.body_layout)
    require_body(motion, body)
    capture = read_capture(request.capture) if request.capture is not None else None
    refused: tuple[str, ...] = ()
    if capture is not None and request.capture is not None:
        allowed = (path if path.is_dir() else path.parent for path in (request.capture, *request.footage_from))
        capture, refused = near_footage(capture, tuple(allowed))
    names = _names(request, motion)
    with atomic_outputs(request.out, tuple(names.values()), overwrite=request.overwrite) as temporary:
        scene = fresh_scene()
        progress("baking", 0, 1)
        baking = time.monotonic()
        settings = BakeSettings(
            keys_per_second=request.keys_per_second, tolerance_mm=request.tolerance_mm, asset=request.asset,
            scene_fps=request.fps,
        )  # fmt: skip
        take = bake_take(scene, motion, body, capture, settings)
        _files_of(request).write(take.action, request.out.absolute())
        if person := person_of(motion.provenance):
            take.action[PERSON] = person
        baked_s = time.monotonic() - baking
        progress("baking", 1, 1)
        subject = RenderedTake(take, motion, body, capture)
        deviation = _deviation(scene, subject)
        show_look(take.mesh, request.look)
        frame_viewports(tuple(subject.joints[0, 0].tolist()))
        if request.blend:
            save_file(temporary[names["blend"]])
        is_full = request.keys_per_second is None and request.tolerance_mm is None
        notes = [*take.notes, *refused, *(_deviation_notes(deviation) if is_full else [])]
        notes += _write_pictures({kind: temporary[name] for kind, name in names.items()}, subject, progress)
    return {
        "event": "result",
        "outputs": [str(request.out / name) for name in names.values()],
        "notes": notes,
        "frames": motion.num_frames,
        "fps": motion.fps,
        "baked_s": round(baked_s, 3),
        "seconds": round(time.monotonic() - start, 3),
        "joints_deviation_mm": deviation["joints_deviation_mm"],
        "skin_deviation_mm": deviation["skin_deviation_mm"],
    }


def _files_of(request: BakeRequest) -> SolveFiles:
    """Return the files of a take, its report and its job where they lie beside the motion."""
    from ..animation.takes import SolveFiles

    motion = request.motion.absolute()
    pages = (motion.with_suffix(".html"), motion.with_name("report.html"))
    report = next((page for page in pages if page.is_file()), None)
    job = motion.with_suffix(".job.json")
    capture = None if request.capture is None else request.capture.absolute()
    return SolveFiles(motion, capture, report, job if job.is_file() else None)


def _names(request: BakeRequest, motion: MotionFile) -> dict[str, str]:
    """Return the output's name of each kind."""
    names = {"blend": f"{motion.name}.blend"} if request.blend else {}
    if request.video:
        names["video"] = f"{motion.name}.mp4"
    if request.pictures:
        names["sheet"] = f"{motion.name}_contact.png"
    return names


def _write_pictures(paths: dict[str, Path], subject: RenderedTake, progress: Progress) -> list[str]:
    """Write the contact sheet and the video, if wanted, and return notes on what they leave out."""
    from ..render.contact_sheet import render_contact_sheet
    from ..render.preview import PreviewSettings, preview_frames, render_preview

    if "sheet" in paths:
        render_contact_sheet(paths["sheet"], subject, progress)
    if "video" not in paths:
        return []
    settings, motion = PreviewSettings(), subject.motion
    render_preview(paths["video"], subject, progress, settings)
    frames, fps = preview_frames(motion.num_frames, motion.fps, settings)
    shown_s, whole_s = len(frames) / fps, motion.num_frames / motion.fps
    cut = shown_s < whole_s - 0.5 / motion.fps
    return [f"The preview video shows the first {shown_s:.1f} s of {whole_s:.1f} s."] if cut else []


def _deviation(scene: bpy.types.Scene, subject: RenderedTake) -> dict[str, float]:
    """Return how far Blender's body is from NumPy's on some frames, in millimetres."""
    from ..animation.deviation import measure_deviation

    take, last = subject.take, subject.motion.num_frames - 1
    frames = np.unique(np.linspace(0, last, _CHECKED_FRAMES).round().astype(int)).tolist()
    deviation = measure_deviation(scene, take.armature, take.mesh, subject.body, subject.motion, take.timing, frames)
    return {
        "joints_deviation_mm": round(deviation.joints_mm, 4),
        "skin_deviation_mm": round(deviation.skin_mm, 4),
    }


def _deviation_notes(deviation: dict[str, float]) -> list[str]:
    joints_mm = deviation["joints_deviation_mm"]
    if joints_mm <= _TOLERATED_MM:
        return []
    return [
        f"The armature's joints are up to {joints_mm:.1f} mm from the motion file's: "
        "it was solved for another body of this name."
    ]
