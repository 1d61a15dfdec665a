"""Frame ranges of a take to review or to solve again, and colours that show confidence."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import bpy
import numpy as np
from numpy.typing import ArrayLike

from .._exchange.job_file import JobContact, JobPin, JobRange
from ..animation.action import read_pose
from ..animation.curves import current_action, laid_rate
from ..animation.lanes import FORGETS, confidence_at, contact_edits, read_lane, resting_bones
from ..animation.layers import without_layers
from ..animation.takes import BETAS, take_file
from ..body.armature import deform_bone
from ..body.body_file import body_path_of, read_body
from ..body.mesh import positions
from ..body.shape import body_mesh, get_betas
from ..errors import TakeMissing


def doubtful_ranges(take: bpy.types.Action, below: float) -> list[tuple[int, int]]:
    """Return the first and last scene frame of each range with a confidence below a limit, in order."""
    lane = read_lane(take)
    if lane is None:
        return []
    frames, confidence = lane
    return [(round(frames[first]), round(frames[last])) for first, last in bad_ranges(confidence, below)]


def bad_ranges(confidence: np.ndarray, below: float, *, bridge: int = 3) -> list[tuple[int, int]]:
    """Return the frame ranges with an (F,) confidence below a limit. Gaps of up to ``bridge`` frames are closed."""
    frames = np.flatnonzero(np.asarray(confidence) < below)
    if not len(frames):
        return []
    breaks = np.flatnonzero(np.diff(frames) > bridge + 1)
    firsts, lasts = frames[np.r_[0, breaks + 1]], frames[np.r_[breaks, len(frames) - 1]]
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))


def next_range(ranges: list[tuple[int, int]], frame: int, *, backwards: bool = False) -> tuple[int, int] | None:
    """Return the next range after (or before) a frame, or None if there are no ranges. The search wraps around."""
    if not ranges:
        return None
    if backwards:
        return next((r for r in reversed(ranges) if r[0] < frame), ranges[-1])
    return next((r for r in ranges if r[0] > frame), ranges[0])


@dataclass(frozen=True)
class SceneRange:
    """A frame range of a take to solve again, in scene frames, and its pinned poses."""

    action: bpy.types.Action  # Action of the take.
    first: int
    last: int
    pins: tuple[tuple[float, str], ...] = ()  # Scene frame and ``pinned_values`` of each pinned pose.


def resolve_of(frames: SceneRange) -> JobRange:
    """Describe a range for a job file, with the pinned poses and edited contacts inside it."""
    motion = take_file(frames.action, "motion_file")
    if not motion.is_file():
        hint = "Solve the whole capture again."
        raise TakeMissing("The motion file of this take no longer exists.", where=str(motion), hint=hint)
    first, last = capture_range(frames.action, frames.first, frames.last)
    pins = [(capture_frame(frames.action, frame), values) for frame, values in frames.pins]
    kept = tuple(JobPin(frame, **json.loads(values)) for frame, values in pins if first <= frame <= last)
    edits = [(part, max(a, first), min(b, last), touches) for part, a, b, touches in contact_edits(frames.action)]
    contacts = tuple(JobContact(*edit) for edit in edits if edit[1] <= edit[2])
    return JobRange(motion, first, last, kept, contacts, bool(frames.action.get(FORGETS)))


def capture_range(take: bpy.types.Action, first: int, last: int) -> tuple[int, int]:
    """Return the first and last capture frame of a range given in scene frames."""
    count, (start, end) = int(take["frames"]), (capture_frame(take, frame) for frame in (first, last))
    if end < 0 or start > count - 1 or start > end:
        message = f"The frames {first} to {last} are outside the take or in the wrong order."
        raise TakeMissing(message, where=take.name, hint="Set First and Last within the take.")
    return max(start, 0), min(end, count - 1)


def capture_frame(action: bpy.types.Action, frame: float) -> int:
    """Return the capture frame (counted from 0) that is nearest to a scene frame."""
    return round((frame - action["frame_start"]) * action["fps"] / laid_rate(action))


def scene_frame(action: bpy.types.Action, frame: int) -> int:
    """Return the scene frame that is nearest to a capture frame (counted from 0)."""
    return round(action["frame_start"] + frame * laid_rate(action) / action["fps"])


def pinned_values(armature: bpy.types.Object) -> str:
    """Return an armature's current pose as JSON text for a job file."""
    mesh = body_mesh(armature)
    action = current_action(armature)
    assert action is not None
    betas = get_betas(mesh) if mesh is not None else np.array(action[BETAS])
    rest = read_body(body_path_of(action.get("provenance", ""))).rest_joints(betas)
    with without_layers(armature):
        bpy.context.view_layer.update()
        pose = read_pose(armature, rest[0], without_root=True)
    values = {
        "global_orient": pose.rotvec[0].tolist(),
        "body_pose": pose.rotvec[1:].ravel().tolist(),
        "transl": pose.transl.tolist(),
    }
    return json.dumps({key: [round(v, 6) for v in numbers] for key, numbers in values.items()})


def sole_height(
    scene: bpy.types.Scene, armature: bpy.types.Object, take: bpy.types.Action, samples: int
) -> float | None:
    """Return the median height of the skin's lowest point over ``samples`` frames, or None without a skin."""
    skins = [obj for obj in scene.objects if obj.type == "MESH" and obj.find_armature() == armature]
    if not skins:
        return None
    shown = scene.frame_current_final
    first, last = take.frame_range
    lowest: list[float] = []
    try:
        for frame in np.linspace(first, last, samples):
            scene.frame_set(int(frame), subframe=float(frame % 1.0))
            lowest.append(min(_lowest(skin) for skin in skins))
    finally:
        scene.frame_set(int(shown // 1), subframe=float(shown % 1.0))
    return float(np.median(lowest))


def _lowest(skin: bpy.types.Object) -> float:
    posed = skin.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = posed.to_mesh()
    try:
        points = positions(mesh.vertices)
    finally:
        posed.to_mesh_clear()
    world = np.array(posed.matrix_world)
    return float((points @ world[2, :3] + world[2, 3]).min())


_BAD, _MIDDLE, _GOOD = np.array([[0.86, 0.09, 0.07], [0.95, 0.72, 0.10], [0.16, 0.70, 0.30]])
RESTING = np.array([0.42, 0.47, 0.56])
"""Colour of joints without a measurement."""
_ACTIVE_BLEND, _SELECT_BLEND = 0.65, 0.35
_VISIBLE = 0.02
"""Smallest change of a colour that is applied."""


def colours(confidence: ArrayLike) -> np.ndarray:
    """Return display colours (..., 3): red up to 0.3, amber at 0.6, green from 0.9."""
    c = np.clip((np.asarray(confidence, np.float64)[..., None] - 0.3) / 0.6, 0.0, 1.0)
    low = _BAD + (_MIDDLE - _BAD) * np.minimum(1.0, 2 * c)
    return np.where(c < 0.5, low, _MIDDLE + (_GOOD - _MIDDLE) * (2 * c - 1))


def paint_bones(armature: bpy.types.Object, frame: float, *, shown: bool) -> None:
    """Colour a body's bones by their confidence at a scene frame, or remove these colours."""
    action = current_action(armature)
    confidence = confidence_at(action, frame) if action is not None else {}
    if not shown:
        for name in confidence:
            armature.pose.bones[name].color.palette = "DEFAULT"
        return
    resting = resting_bones(armature, frame)
    for name, certain in zip(confidence, colours(list(confidence.values())), strict=True):
        colour = RESTING if name in resting else certain
        target = armature.pose.bones[name].color
        if target.palette != "CUSTOM":
            target.palette = "CUSTOM"
        elif max(abs(colour - target.custom.normal)) < _VISIBLE:
            continue  # because every change makes Blender redraw its editors
        target.custom.normal = colour
        target.custom.select = colour + _SELECT_BLEND * (1 - colour)
        target.custom.active = colour + _ACTIVE_BLEND * (1 - colour)


_INTERPOLATED = 1e-3  # Largest confidence of an interpolated frame (see ``confidence.joint_confidence``).


def joint_weights(skin: bpy.types.Object, joints: tuple[str, ...]) -> np.ndarray:
    """Return the weights (V, J) of a skin, normalised for each vertex. Vertices without weights get zeros."""
    columns = {group.index: j for j, name in enumerate(joints) if (group := skin.vertex_groups.get(deform_bone(name)))}
    weights = np.zeros((len(skin.data.vertices), len(joints)))
    for vertex in skin.data.vertices:
        for item in vertex.groups:
            if item.group in columns:
                weights[vertex.index, columns[item.group]] = item.weight
    return weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)


def skin_colours(
    weights: np.ndarray, joints: tuple[str, ...], confidence: Mapping[str, float], resting: Collection[str] = ()
) -> np.ndarray:
    """Return vertex colours (V, 3) from the confidence of the joints. Joints at rest are grey."""
    rests = np.array([name in resting for name in joints])
    shown = weights @ np.where(rests, 1.0, [confidence.get(name, 1.0) for name in joints])
    share = weights[:, rests].sum(axis=1, keepdims=True)
    return (1.0 - share) * colours(shown) + share * RESTING


def doubtful_bands(take: bpy.types.Action, below: float) -> list[tuple[float, float, tuple[float, float, float]]]:
    """Return start, end and colour of each timeline band with low confidence. Interpolated ranges are red."""
    lane = read_lane(take)
    if lane is None:
        return []
    frames, confidence = lane
    found = []
    for bound in (below, min(below, _INTERPOLATED)):
        shade = colours(0.6 if bound == below else 0.0)
        found += [
            (float(frames[a]), float(frames[b]), tuple(shade)) for a, b in bad_ranges(confidence, bound, bridge=0)
        ]
    return found
