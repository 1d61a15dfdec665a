"""Write confidence and contacts as animated custom properties of the bones and the armature."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from typing import Any

import bpy
import numpy as np

from .._exchange.contact_parts import CONTACT_PARTS
from .._exchange.motion_file import FLAG_UNSEEN, FLAG_UNSURE, MotionFile
from ..conventions.kept_findings import value_in
from .curves import (
    CurveTarget,
    action_curves,
    current_action,
    key_points,
    key_type_values,
    remove_curves,
    write_curves,
)

HALF_AT_M = 0.03  # Standard deviation at which confidence is one half.
_UNSURE_AT_MOST = 0.3  # Highest confidence that a flagged frame can have (0 to 1). Chosen by hand.


def joint_confidence(sigma_m: np.ndarray, flags: np.ndarray | None) -> np.ndarray:
    """Convert standard deviations of joints in metres to confidences from 0 to 1.

    The confidence is ``1 / (1 + (sigma / 3 cm)²)``, but 0 in interpolated frames and at most 0.3 in unsure frames.
    """
    confidence = 1.0 / (1.0 + (np.asarray(sigma_m, np.float64) / HALF_AT_M) ** 2)
    if flags is not None:
        unsure, unseen = (flags & FLAG_UNSURE) > 0, (flags & FLAG_UNSEEN) > 0
        confidence[unsure] = np.minimum(confidence[unsure], _UNSURE_AT_MOST)
        confidence[unseen] = 0.0
    return confidence


def sigma_of(confidence: float) -> float:
    """Convert a confidence in (0, 1] back to a standard deviation in metres."""
    return float(HALF_AT_M * np.sqrt(1.0 / max(confidence, 1e-6) - 1.0))


PROPERTY, RESTING, CONTACT = "confidence", "resting", "contact"  # Custom properties of bones.
EDITS = "contact_edits"  # Custom property of an action: the contacts that the user added or removed, as JSON.
FORGETS = "contact_edits_cleared"  # Custom property of an action: the next solve must ignore earlier contact edits.
_TOUCHES = "1 where this part of the body touches the floor"
_PATH = f'["{PROPERTY}"]'
_OF_JOINT = "Confidence of the joint at this bone's head, 0 to 1"
_OF_ALL = "Confidence of the least certain joint, 0 to 1"
_GROUP = "Confidence"


def write_lanes(
    target: CurveTarget, armature: bpy.types.Object, motion: MotionFile, frames: np.ndarray, times: np.ndarray
) -> None:
    """Write curves of confidence, resting joints and floor contacts for a motion's frames.

    Resting joints have no measurement and need no review, so they do not lower the confidence of the whole armature.
    """
    bones, at, resting = armature.pose.bones, times[frames], motion.resting
    for bone in bones:
        for name in (RESTING, CONTACT):
            if name in bone:
                del bone[name]  # a value from another take, which no curve would change
    types = key_type_values(motion.keyframes, motion.num_frames)[frames]

    def write(joint: int, name: str, value: float, description: str, values: np.ndarray) -> None:
        bone = motion.body_layout.joints[joint]
        if bone in bones:
            _declare(bones[bone], name, value, description)
            write_curves(target, f'pose.bones["{bone}"]["{name}"]', bone, at, values[:, None], types)

    if motion.joint_sigma is not None:
        confidence = joint_confidence(motion.joint_sigma, motion.flags)[frames]
        worst = confidence if resting is None else np.where(resting[frames], 1.0, confidence)
        _declare(armature, PROPERTY, 1.0, _OF_ALL)
        write_curves(target, _PATH, _GROUP, at, worst.min(axis=1, keepdims=True), types)
        for j in range(motion.body_layout.num_joints):
            write(j, PROPERTY, 1.0, _OF_JOINT, confidence[:, j])
    touching = motion.contacts if motion.touches is None else motion.touches
    for joints, values in zip(CONTACT_PARTS.values(), () if touching is None else touching.T, strict=False):
        if values.any() and joints[0] in motion.body_layout.joints:
            write(motion.body_layout.joints.index(joints[0]), CONTACT, 0.0, _TOUCHES, values[frames].astype(np.float64))
    if resting is None:
        return
    for j in np.flatnonzero(resting.any(axis=0)):
        write(j, RESTING, 0.0, "1 where the joint was not measured", resting[frames, j].astype(np.float64))


def edit_contact(
    target: CurveTarget, armature: bpy.types.Object, part: str, scene_frames: tuple[int, int], edit: Sequence[object]
) -> None:
    """Add or remove a body part's floor contact in a range of scene frames, and store the edit for the next solve.

    ``edit`` contains the body part, the first and last capture frames, and whether the part touches the floor.
    """
    action, bone = target.action, armature.pose.bones[CONTACT_PARTS[part][0]]
    path = f'pose.bones["{bone.name}"]["{CONTACT}"]'
    curve = next((curve for curve in target.container.fcurves if curve.data_path == path), None)
    times = np.arange(np.floor(action.frame_range[0]), np.ceil(action.frame_range[1]) + 1)
    values = np.array([0.0 if curve is None else curve.evaluate(time) for time in times])
    values[(times >= scene_frames[0]) & (times <= scene_frames[1])] = float(bool(edit[-1]))
    remove_curves(target, path)
    _declare(bone, CONTACT, 0.0, _TOUCHES)
    write_curves(target, path, bone.name, times, values[:, None], key_type_values(None, len(times)))
    action[EDITS] = json.dumps([*contact_edits(action), list(edit)])


def clear_contact_edits(action: bpy.types.Action) -> None:
    """Forget a take's contact edits, so that the next solve of a range detects all contacts again."""
    action[EDITS], action[FORGETS] = "[]", True


def has_contact_edits(action: bpy.types.Action) -> bool:
    """Return whether the user has edited a take's contacts, including edits that an earlier solve used."""
    if contact_edits(action):
        return True
    solves = None if action.get(FORGETS) else value_in(action.get("provenance", ""), "resolved")
    return any(solve.get("contacts") for solve in solves or ())


def contact_edits(action: bpy.types.Action) -> list[list[Any]]:
    """Return the user's contact edits: body part, first and last capture frame, and whether the part has contact."""
    return list(json.loads(action.get(EDITS, "[]")))


def _declare(owner: bpy.types.Object | bpy.types.PoseBone, name: str, value: float, description: str) -> None:
    owner[name] = value
    owner.id_properties_ui(name).update(min=0.0, max=1.0, description=description)


def _bone_curves(action: bpy.types.Action | None, name: str) -> Iterator[tuple[str, bpy.types.FCurve]]:
    """Yield each curve that animates the custom property ``name`` of a bone, with the bone's name."""
    for curve in action_curves(action) if action is not None else ():
        if match := re.fullmatch(rf'pose\.bones\["([^"]+)"\]\["{name}"\]', curve.data_path):
            yield match[1], curve


def read_lane(action: bpy.types.Action) -> tuple[np.ndarray, np.ndarray] | None:
    """Return a take's (F,) scene frames and the lowest joint confidence in each frame, or None without confidence."""
    curve = next((c for c in action_curves(action) if c.data_path == _PATH), None)
    if curve is None:
        return None
    frames, confidence = key_points(curve).astype(np.float64).T
    return frames, confidence


def confidence_at(action: bpy.types.Action | None, frame: float) -> dict[str, float]:
    """Return the confidence of each bone that has a confidence curve, at a scene frame."""
    return {bone: curve.evaluate(frame) for bone, curve in _bone_curves(action, PROPERTY)}


def current_confidence(armature: bpy.types.Object) -> dict[str, float]:
    """Return the confidence of each bone that has a confidence value, at the scene's current frame."""
    return {bone.name: float(bone[PROPERTY]) for bone in armature.pose.bones if PROPERTY in bone}


def resting_at(action: bpy.types.Action | None, times: np.ndarray) -> dict[str, np.ndarray]:
    """Return an (F,) mask for each bone. It is True in frames without a measurement of its joint."""
    curves = _bone_curves(action, RESTING)
    return {bone: np.array([curve.evaluate(float(t)) > 0.0 for t in times], dtype=bool) for bone, curve in curves}


def resting_bones(armature: bpy.types.Object, frame: float) -> frozenset[str]:
    """Return the bones with a joint that was not measured at a scene frame of the armature's take."""
    found = resting_at(current_action(armature), np.array([frame]))
    return frozenset(name for name, rests in found.items() if rests[0])
