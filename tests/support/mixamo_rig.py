"""A rig as Mixamo's files arrive in Blender: its names, centimetres, Y up in a turned and scaled object, its rolls."""

from __future__ import annotations

import bpy
import numpy as np

PREFIX = "mixamorig:"
_MIDDLE = {
    "Hips": ((0, 88, 1), None), "Spine": ((0, 97, 0), "Hips"), "Spine1": ((0, 108, -1), "Spine"),
    "Spine2": ((0, 121, -2), "Spine1"), "Neck": ((0, 136, -1), "Spine2"), "Head": ((0, 145, 2), "Neck"),
    "HeadTop_End": ((0, 165, 5), "Head"),
}  # fmt: skip
_LEFT = {
    "Shoulder": ((5, 133, -1), "Spine2"), "Arm": ((17, 132, -3), "Shoulder"), "ForeArm": ((41, 132, -3.5), "Arm"),
    "Hand": ((70, 132, -3), "ForeArm"),
    "HandMiddle1": ((79, 131, -2), "Hand"), "HandMiddle2": ((83, 131, -2), "HandMiddle1"),
    "UpLeg": ((8, 83, 1), "Hips"), "Leg": ((8.5, 43, 1.5), "UpLeg"), "Foot": ((9, 9, -1.5), "Leg"),
    "ToeBase": ((10, 2.5, 9), "Foot"), "Toe_End": ((10.5, 2, 16), "ToeBase"),
}  # fmt: skip
_BELOW_SHOULDER = ("ForeArm", "Hand", "HandMiddle1", "HandMiddle2")
_ROLLS = {
    "Hips": 0.0, "Spine": 3.14159, "LeftArm": 1.5708, "RightArm": -1.5708, "LeftForeArm": 1.5708, "RightForeArm": 1.7,
    "LeftUpLeg": 3.14159, "RightUpLeg": 3.0, "LeftLeg": 3.14159, "RightLeg": -3.1, "LeftFoot": 2.6, "RightFoot": -2.6,
    "LeftHand": 0.4,
}  # fmt: skip
_BUILDS = {
    "short": {"stature": 0.82, "legs": 0.93, "arms": 1.12},
    "tall": {"stature": 1.15, "legs": 1.06, "arms": 0.92},
}


def joints_of(build: str) -> tuple[dict[str, np.ndarray], dict[str, str | None]]:
    """Return head in centimetres (Y up, facing Z) and parent of each joint of a figure of other proportions."""
    heads = {name: np.array(head, float) for name, (head, _) in _MIDDLE.items()}
    parents = {name: parent for name, (_, parent) in _MIDDLE.items()}
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        for name, (head, parent) in _LEFT.items():
            heads[side + name] = np.array(head, float) * [sign, 1, 1]
            parents[side + name] = parent if parent in _MIDDLE else side + parent
    sizes = _BUILDS[build]
    hip = heads["LeftUpLeg"][1]
    for name, head in heads.items():
        part = name.removeprefix("Left").removeprefix("Right")
        if part in ("Leg", "Foot", "ToeBase", "Toe_End"):
            head[1] *= sizes["legs"]
        else:
            head[1] += (sizes["legs"] - 1) * hip
        shoulder = (
            heads[name.replace(part, "Arm")] if part in ("ForeArm", "Hand", "HandMiddle1", "HandMiddle2") else None
        )
        if shoulder is not None:
            head[:] = shoulder + sizes["arms"] * (head - shoulder)
        head *= 1.0
    return {name: sizes["stature"] * head for name, head in heads.items()}, parents


def mixamo_rig(
    name: str = "Character",
    build: str = "short",
    *,
    rolls: dict[str, float] | None = None,
    arms_down_deg: float = 0.0,
    prefix: str = PREFIX,
    leave_out: tuple[str, ...] = (),
) -> bpy.types.Object:
    """Build the rig in the current scene.

    Args:
        name: of the object.
        build: ``short`` or ``tall``.
        rolls: of bones; Mixamo's where left out.
        arms_down_deg: how far the arms hang below the horizontal at rest.
        prefix: before all names.
        leave_out: joints without a bone, with all below them.
    """
    heads, parents = joints_of(build)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        c, s = np.cos(np.radians(arms_down_deg)), np.sin(np.radians(arms_down_deg))
        turn = np.array([[c, sign * s, 0], [-sign * s, c, 0], [0, 0, 1]])
        shoulder = heads[f"{side}Arm"].copy()
        for part in _BELOW_SHOULDER:
            heads[side + part] = shoulder + turn @ (heads[side + part] - shoulder)
    data = bpy.data.armatures.new(name)
    rig = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    for joint, head in heads.items():
        if joint.endswith("_End") or _is_below(joint, parents, leave_out):
            continue
        children = [heads[other] for other, parent in parents.items() if parent == joint]
        bone = data.edit_bones.new(prefix + joint)
        bone.head = head.tolist()
        bone.tail = (np.mean(children, axis=0) if children else head + [0, 4, 0]).tolist()
        bone.roll = {**_ROLLS, **(rolls or {})}.get(joint, 0.0)
        if (parent := parents[joint]) is not None:
            bone.parent = data.edit_bones[prefix + parent]
    bpy.ops.object.mode_set(mode="OBJECT")
    rig.rotation_euler, rig.scale = (np.pi / 2, 0.0, 0.0), (0.01, 0.01, 0.01)
    bpy.context.view_layer.update()
    return rig


def _is_below(joint: str | None, parents: dict[str, str | None], tops: tuple[str, ...]) -> bool:
    while joint is not None:
        if joint in tops:
            return True
        joint = parents[joint]
    return False
