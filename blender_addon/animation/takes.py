"""Play, find and store takes. A take is a solved action on a body, on an NLA track or in the asset browser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy

from .._exchange.diagnostics import Diagnostic, DiagnosticValues, read_diagnostics, warnings_in
from ..body.controls.limbs import LIMBS, follow_mode, has_limbs, switch_path
from ..body.shape import body_mesh, set_betas
from ..conventions.file_paths import file_of, stored
from ..conventions.kept_findings import findings_in, value_in
from .curves import action_curves, play_action
from .layers import keep_users_action, lay_aside, restore_place

PATHS = ("motion_file", "capture_file", "report_file", "job_file")
"""Custom properties of an action that store the paths of the files of its solve."""
PERSON = "person"  # Custom property of an action: the person it shows, if the capture shows several.
ERROR = "error_text"  # Custom property of an action: the median error of its solve, as text.
DIAGNOSTICS = "diagnostics"  # Custom property of an action: the diagnostics of its solve, as JSON text.
WARNINGS = "warnings"  # Custom property of an action: the warnings of its solve, one per line.
_HALF = 0.5  # Threshold of a limb's switch between FK (0) and IK (1).
BETAS = "betas"  # Custom property of an action: the shape with which it was solved.


@dataclass(frozen=True)
class SolveFiles:
    """Paths of the files that a solve has read and written."""

    motion: Path
    capture: Path | None
    report: Path | None
    job: Path | None

    def write(self, action: bpy.types.Action, folder: Path | None = None) -> None:
        """Store the paths in a take, relative to ``folder`` or to the folder of the open .blend file."""
        for key, path in zip(PATHS, (self.motion, self.capture, self.report, self.job), strict=True):
            action[key] = stored(path or "", folder)


@dataclass(frozen=True)
class SolvedAgain:
    """The frame range of a take that was solved again."""

    take: str  # Name of the action.
    first: int  # First capture frame, counted from 0.
    last: int  # Last capture frame.


def take_file(action: bpy.types.Action, key: str) -> Path:
    """Return the path that a take stores under a key in ``PATHS``, or an empty path if the key is missing."""
    return file_of(action.get(key) or "", action.library)


def person_of(provenance: str) -> str:
    """Return the person named in a motion's provenance (JSON text), or "" if there is only one."""
    person = value_in(provenance, "person")
    return person if isinstance(person, str) else ""


def found_in(provenance: str) -> list[DiagnosticValues]:
    """Return the diagnostics stored in a motion's provenance (JSON text), as plain JSON values."""
    return [item.as_dict() for item in read_diagnostics(value_in(provenance, "diagnostics"))]


def warnings_of_take(action: bpy.types.Action) -> Sequence[Diagnostic]:
    """Return the warnings stored in a take."""
    return warnings_in(findings_in(str(action.get(DIAGNOSTICS, ""))))


def takes_of(capture_file: str, person: str = "", original: str = "") -> list[bpy.types.Action]:
    """Return the takes made from a capture file, or from ``original``, the same capture before Refine Calibration."""
    if not capture_file:
        return []
    files = [file for file in (capture_file, original) if file]
    found = [action for action in bpy.data.actions if any(_is_of(action, file) for file in files)]
    return [action for action in found if not person or action.get(PERSON, person) == person]


def show_take(armature: bpy.types.Object, action: bpy.types.Action) -> None:
    """Play a take on a body, with the take's body shape and below the user's layers."""
    with keep_users_action(armature):
        play_action(armature, action)
    restore_place(armature, action)
    _show_controls(armature, action)
    mesh = body_mesh(armature)
    if mesh is not None and BETAS in action:
        set_betas(mesh, action[BETAS])


def _show_controls(armature: bpy.types.Object, action: bpy.types.Action) -> None:
    if not has_limbs(armature) or not armature.data.is_editable:
        return
    curves = {curve.data_path: curve for curve in action_curves(action)}
    for limb in LIMBS:
        if (curve := curves.get(switch_path(limb))) is not None:
            follow_mode(armature, limb, from_end=curve.evaluate(action.frame_range[0]) > _HALF)


def push_down(obj: bpy.types.Object) -> bpy.types.NlaStrip | None:
    """Move the object's current action to a strip on a new, muted NLA track."""
    animation = obj.animation_data
    if animation is None or animation.action is None:
        return None
    action, slot = animation.action, getattr(animation, "action_slot", None)
    animation.action = None
    return lay_aside(obj, action, slot)


def mark_as_asset(action: bpy.types.Action) -> None:
    """Add an action made by ``bake_action`` to the asset browser, with a description."""
    action.asset_mark()
    start, end = action.frame_range
    data = action.asset_data
    data.description = f"Solved take: {end - start + 1:g} frames, solved at {action['fps']:g} fps"
    for tag in ("motion capture", "take"):
        data.tags.new(tag, skip_if_exists=True)


def measured_key(action: bpy.types.Action) -> str:
    """Return the key in ``PATHS`` of the file that a take was made from: its capture, or else its motion."""
    return "capture_file" if action.get("capture_file") else "motion_file"


def _is_of(action: bpy.types.Action, capture_file: str) -> bool:
    key = measured_key(action)
    own = action.get(key)
    return bool(own) and (own == capture_file or take_file(action, key) == file_of(capture_file))
