"""The command ``bake``: motion file in; Blender file, preview video and contact sheet out."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .errors import OutputNotWritable
from .files.body_file import default_body_path, read_body
from .files.capture_file import read_capture
from .files.motion_file import MotionFile, read_motion
from .outputs import atomic_outputs
from .progress import Progress

_CHECKED_FRAMES = 8


@dataclass(frozen=True)
class BakeJob:
    """What to bake and what to write."""

    motion: Path
    """Motion file."""
    out: Path
    """Folder of the outputs."""
    capture: Path | None = None
    """Capture file the motion was solved from."""
    body: Path | None = None
    """Body file; None for the one that ships with the add-on."""
    video: bool = True
    """Write the preview video."""
    pictures: bool = True
    """Write the contact sheet."""


def run_bake(job: BakeJob, progress: Progress) -> dict[str, Any]:
    """Bake a motion in a fresh Blender session and write ``<name>.blend``, ``.mp4`` and ``_contact.png``.

    All files are written or none; existing ones are never replaced.

    Returns:
        The ``result`` event of the progress protocol: outputs, notes, frames, seconds and deviations in millimetres.

    Raises:
        AddonError: an input is missing or wrong, an output exists, or Blender cannot render.
    """
    import bpy

    from .bake.scene import bake_take, require_body
    from .render.contact_sheet import render_contact_sheet
    from .render.preview import PreviewSettings, preview_frames, render_preview
    from .render.subject import Subject

    start = time.monotonic()
    motion = read_motion(job.motion)
    body = read_body(job.body or default_body_path())
    require_body(motion, body)
    capture = read_capture(job.capture) if job.capture is not None else None
    blend, video, sheet = f"{motion.name}.blend", f"{motion.name}.mp4", f"{motion.name}_contact.png"
    names = (blend, *([video] if job.video else []), *([sheet] if job.pictures else []))
    with atomic_outputs(job.out, names) as temporary:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        scene = bpy.context.scene
        progress("baking", 0, 1)
        take = bake_take(scene, motion, body, capture)
        baked_s = time.monotonic() - start
        progress("baking", 1, 1)
        deviation = _deviation(scene, take, body, motion)
        _save(temporary[blend])
        notes = list(take.notes)
        subject = Subject(take, motion, body, capture)
        if job.pictures:
            render_contact_sheet(temporary[sheet], subject, progress)
        if job.video:
            settings = PreviewSettings()
            shown, fps = preview_frames(motion.num_frames, motion.fps, settings)
            render_preview(temporary[video], subject, progress, settings)
            notes.extend(_cut_note(motion, len(shown) / fps))
    return {
        "event": "result",
        "outputs": [str(job.out / name) for name in names],
        "notes": notes,
        "frames": motion.num_frames,
        "fps": motion.fps,
        "baked_s": round(baked_s, 3),
        "seconds": round(time.monotonic() - start, 3),
        **deviation,
    }


def _deviation(scene: Any, take: Any, body: Any, motion: MotionFile) -> dict[str, float]:
    from .bake.deviation import measure_deviation

    frames = np.unique(np.linspace(0, motion.num_frames - 1, _CHECKED_FRAMES).round().astype(int)).tolist()
    deviation = measure_deviation(scene, take.armature, take.mesh, body, motion, take.timing, frames)
    return {
        "joints_deviation_mm": round(deviation.joints_mm, 4),
        "linear_skin_deviation_mm": round(deviation.linear_skin_mm, 4),
        "full_skin_deviation_mm": round(deviation.full_skin_mm, 4),
    }


def _save(path: Path) -> None:
    import bpy

    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True, copy=True)
    except RuntimeError as error:
        raise OutputNotWritable(f"Blender cannot save the file ({str(error).strip()}).", where=path.name) from error


def _cut_note(motion: MotionFile, shown_s: float) -> list[str]:
    whole_s = motion.num_frames / motion.fps
    if shown_s > whole_s - 0.5 / motion.fps:
        return []
    return [f"The preview video shows the first {shown_s:.1f} s of {whole_s:.1f} s."]
