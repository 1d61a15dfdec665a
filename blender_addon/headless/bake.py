"""``bake`` and ``render``: write a Blender file, a preview video and a contact sheet of a motion."""

from __future__ import annotations

import time
from argparse import Namespace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .._exchange.capture_file import read_capture
from .._exchange.motion_file import read_motion
from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress
from ..animation.deviation import measure_deviation
from ..animation.takes import PERSON, SolveFiles, person_of
from ..body.body_file import body_path_of, read_body, require_body
from ..body.looks import show_look
from ..conventions.naming import PERSON_LOOK
from ..render.contact_sheet import render_contact_sheet
from ..render.preview import PreviewSettings, preview_frames, render_preview
from ..render.subject import RenderedTake
from ..scene.bake import BakeSettings, bake_take
from ..scene.cameras import near_footage
from ..scene.session import frame_viewports, fresh_scene, save_file
from .result import CommandResult

_CHECKED_FRAMES = 8  # Number of baked frames that are compared with the motion. Chosen by hand.
_TOLERATED_MM = 1.0
_PICTURES = {"video": ".mp4", "sheet": "_contact.png"}
"""File name ending of each type of picture."""


def run_bake(args: Namespace, progress: Progress) -> CommandResult:
    """Bake a motion into a Blender file, a video and a contact sheet."""
    kinds = {"blend": ".blend"}
    if not args.no_pictures:
        kinds |= _PICTURES if not args.no_video else {"sheet": _PICTURES["sheet"]}
    thinning = {"keys_per_second": args.keys_per_second, "tolerance_mm": args.keys_within}
    return _bake(args, kinds, {**thinning, "asset": args.asset, "scene_fps": args.fps}, progress)


def run_render(args: Namespace, progress: Progress) -> CommandResult:
    """Render only the preview video and the contact sheet of a motion."""
    return _bake(args, _PICTURES, {}, progress)


def _bake(args: Namespace, kinds: dict[str, str], settings: dict[str, Any], progress: Progress) -> CommandResult:
    motion = read_motion(args.motion)
    body = read_body(args.body or body_path_of(motion.provenance), motion.body_layout)
    require_body(motion, body)
    capture, refused = None, tuple[str, ...]()
    if args.capture is not None:
        allowed = (path if path.is_dir() else path.parent for path in (args.capture, *args.footage_from))
        capture, refused = near_footage(read_capture(args.capture), tuple(allowed))
    names = {kind: f"{motion.name}{ending}" for kind, ending in kinds.items()}
    with atomic_outputs(args.out, tuple(names.values()), overwrite=args.overwrite) as temporary:
        scene = fresh_scene()
        progress("baking", 0, 1)
        baking = time.monotonic()
        take = bake_take(scene, motion, body, capture, BakeSettings(**settings))
        _files_of(args).write(take.action, args.out.absolute())
        if person := person_of(motion.provenance):
            take.action[PERSON] = person
        baked_s = time.monotonic() - baking
        progress("baking", 1, 1)
        subject = RenderedTake(take, motion, body, capture)
        joints_mm, skin_mm = _deviation(scene, subject)
        show_look(take.mesh, args.look or PERSON_LOOK)
        frame_viewports(tuple(subject.joints[0, 0].tolist()))
        if "blend" in names:
            save_file(temporary[names["blend"]])
        notes = [*take.notes, *refused]
        is_full = settings.get("keys_per_second") is None and settings.get("tolerance_mm") is None
        if is_full and joints_mm > _TOLERATED_MM:
            notes.append(
                f"The armature's joints are up to {joints_mm:.1f} mm from the motion file, which may come from "
                "another body of the same name."
            )
        notes += _write_pictures({kind: temporary[name] for kind, name in names.items()}, subject, progress)
    length = {"frames": motion.num_frames, "fps": motion.fps, "baked_s": round(baked_s, 3)}
    off = {"joints_deviation_mm": joints_mm, "skin_deviation_mm": skin_mm}
    return {"outputs": [str(args.out / name) for name in names.values()], "notes": notes, **length, **off}


def _files_of(args: Namespace) -> SolveFiles:
    motion = args.motion.absolute()
    pages = (motion.with_suffix(".html"), motion.with_name("report.html"))
    report = next((page for page in pages if page.is_file()), None)
    job = motion.with_suffix(".job.json")
    capture = None if args.capture is None else args.capture.absolute()
    return SolveFiles(motion, capture, report, job if job.is_file() else None)


def _write_pictures(paths: dict[str, Path], subject: RenderedTake, progress: Progress) -> list[str]:
    """Write the requested pictures. Return a note if the video had to be shortened."""
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


def _deviation(scene: bpy.types.Scene, subject: RenderedTake) -> tuple[float, float]:
    """Return how far in mm Blender's joints and skin are from the positions that NumPy computes."""
    take, last = subject.take, subject.motion.num_frames - 1
    frames = np.unique(np.linspace(0, last, _CHECKED_FRAMES).round().astype(int)).tolist()
    found = measure_deviation(scene, take.armature, take.mesh, subject.body, subject.motion, take.timing, frames)
    return round(found.joints_mm, 4), round(found.skin_mm, 4)
