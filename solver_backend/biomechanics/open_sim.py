"""Write motions for OpenSim: model coordinates, virtual markers and setup files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from solver_backend.biomechanics.joint_angles import JointRule, successive_turns
from solver_backend.biomechanics.segments import MIRROR, SEGMENTS, WORLD_TO_GROUND, PosedSegments, worn_offsets
from solver_backend.body.body import Body
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import MarkerCloud, Motion

# The coordinates are those of Rajagopal et al. 2016 and of its successor by Lai, Arnold and Wakeling 2017 and Uhlrich
# et al. 2022. Both models apply a joint's rotations in the order of their coordinates, about body-fixed axes, and use
# the same names. Ground: x forward, y up, z to the right.
ANKLE_AXIS, SUBTALAR_AXIS = np.array([-0.105, -0.174, 0.979]), np.array([0.787, 0.605, -0.121])
"""Hinges of the right ankle, in the shank's axes, and below its talus (Inman 1976, from Delp et al. 1990)."""
ELBOW_AXIS, PRONATION_AXIS = np.array([0.226, 0.022, 0.974]), np.array([0.056, 0.998, 0.002])
"""Hinge of the right elbow in the upper arm's axes, and pronation axis in the forearm's axes, as in the models."""


def _hinges(first: np.ndarray, other: np.ndarray, *, middle: bool) -> tuple[np.ndarray, ...]:
    """Return the unit axes of two hinges and their common perpendicular, which is second if ``middle``, else third."""
    a, b = first / np.linalg.norm(first), other / np.linalg.norm(other)
    c = np.cross(b, a) if middle else np.cross(a, b)
    c = c / np.linalg.norm(c)
    return (a, c, b) if middle else (a, b, c)


_FOOT, _FOREARM = _hinges(ANKLE_AXIS, SUBTALAR_AXIS, middle=False), _hinges(ELBOW_AXIS, PRONATION_AXIS, middle=True)
"""The perpendicular axis takes up the rotation that the hinges cannot follow. OpenSim has no coordinate for it."""
RULES: dict[str, JointRule] = {
    "pelvis": JointRule(("pelvis_tilt", "pelvis_list", "pelvis_rotation")),
    "thigh": JointRule(("hip_flexion", "hip_adduction", "hip_rotation")),
    "shank": JointRule(("knee_angle", "", ""), signs=(-1.0, 1.0, 1.0)),
    "foot": JointRule(("ankle_angle", "subtalar_angle", ""), _FOOT),
    "thorax": JointRule(("lumbar_extension", "lumbar_bending", "lumbar_rotation")),
    "upper_arm": JointRule(("arm_flex", "arm_add", "arm_rot")),
    "forearm": JointRule(("elbow_flex", "", "pro_sup"), _FOREARM),
}
LINES = {
    "thigh": (-0.0018, 0.4068, 0.0098), "shank": (0.0118, 0.3976, -0.0085), "upper_arm": (-0.0131, 0.2863, 0.0096),
    "forearm": (0.0155, 0.2488, -0.0397),
}  # fmt: skip
"""Vector in metres from the lower to the upper joint centre of each right segment in the models at zero angles, in its
axes. It is the ISB's y axis, so the models' hinges are offset by 2 degrees (knee) and 6 (elbow)."""
HINGE_DEG = 13.0  # Rotation of the elbow's hinge from the z axis of the models' upper arm towards x, in degrees.
PELVIS_PITCH_DEG, TORSO_PITCH_DEG = 6.0, -6.0
"""Rotation about z from the ISB axes of pelvis and thorax to the models', in degrees. In the models, the posterior
iliac spines are 17 mm above the anterior ones over 165 mm. In the ISB axes they are level. The line from C7 to the
jugular notch slopes down by 24 degrees in the models, and by 30 in the average body's ISB axes."""
HIPS_TO_ORIGIN = (0.364, 0.508, 0.0)
"""Vector from the hips' midpoint to the models' pelvis origin, as a fraction of the distance between the hips."""


@dataclass(frozen=True)
class Coordinates:
    """Values of N OpenSim coordinates in F frames."""

    names: tuple[str, ...]
    values: np.ndarray  # (F, N) degrees, metres for the pelvis position, radians for the kneecaps.


def coordinates(posed: PosedSegments) -> Coordinates:
    """Compute OpenSim coordinates from posed segments: pelvis first, then the right side."""
    posed = replace(posed, rotations=_model_axes(posed))
    hips = [posed.joints[f"{side}_hip"] @ posed.ground.T for side in ("left", "right")]
    apart = np.linalg.norm(hips[1] - hips[0], axis=-1, keepdims=True)
    origin = 0.5 * (hips[0] + hips[1]) + apart * (posed.rotations["pelvis"] @ np.array(HIPS_TO_ORIGIN))
    names, columns = ["pelvis_tx", "pelvis_ty", "pelvis_tz"], [*origin.T]
    for segment in sorted(SEGMENTS, key=_order):
        side, bare = segment.split("_", 1) if segment.startswith(("left_", "right_")) else ("", segment)
        if (rule := RULES.get(bare)) is None:
            continue
        turns = successive_turns(posed.relative(segment), rule.axes)
        for name, sign, angle in zip(rule.names, rule.signs, turns.T, strict=True):
            if name:
                names.append(f"{name}_{side[0]}" if side else name)
                columns.append(np.degrees(sign * angle))
                if name == "knee_angle":  # A constraint ties the kneecap to it, in radians.
                    names.append(f"knee_angle_{side[0]}_beta")
                    columns.append(sign * angle)
    names, columns = [*names[3:6], *names[:3], *names[6:]], [*columns[3:6], *columns[:3], *columns[6:]]
    return Coordinates(tuple(names), np.stack(columns, axis=-1))


def _model_axes(posed: PosedSegments) -> dict[str, np.ndarray]:
    """Return the (F, 3, 3) rotations of each segment in the axes of the OpenSim models."""
    turned = {"pelvis": _turn(2, PELVIS_PITCH_DEG), "thorax": _turn(2, TORSO_PITCH_DEG)}
    for name, line in LINES.items():
        y = np.array(line) / np.linalg.norm(line)
        across = np.cross(y, (0.0, 1.0, 0.0))
        turn = exp_so3(across[None] * np.arcsin(np.linalg.norm(across)) / np.linalg.norm(across))[0]
        turn = _turn(1, -HINGE_DEG) @ turn if name == "upper_arm" else turn
        turned |= {f"right_{name}": turn, f"left_{name}": MIRROR @ turn @ MIRROR}
    return {name: R @ turned.get(name, np.eye(3)) for name, R in posed.rotations.items()}


def _turn(axis: int, degrees: float) -> np.ndarray:
    return exp_so3(np.radians(degrees) * np.eye(3)[axis][None])[0]


def _order(segment: str) -> tuple[int, int]:
    return (0 if segment == "pelvis" else 1 if segment.startswith("right") else 2), list(SEGMENTS).index(segment)


def mot_text(title: str, found: Coordinates, fps: float) -> str:
    """Format coordinates as the text of an OpenSim motion file (.mot), one row per frame."""
    frames = len(found.values)
    head = [title, "version=1", f"nRows={frames}", f"nColumns={len(found.names) + 1}", "inDegrees=yes", "endheader"]
    times = np.arange(frames) / fps
    rows = ["\t".join(f"{value:.8f}" for value in row) for row in np.column_stack([times, found.values]).tolist()]
    return "\n".join([*head, "\t".join(["time", *found.names]), *rows]) + "\n"


_SKIN = {
    "ACR": "SHO", "LEL": "ELB", "MEL": "ELM", "FAradius": "WRA", "FAulna": "WRB", "ASI": "FWT", "PSI": "BWT",
    "LFC": "KNE", "MFC": "KNM", "LMAL": "ANK", "MMAL": "ANM", "CAL": "HEE", "TOE": "MT1", "MT5": "MT5",
}  # fmt: skip
_CENTRES = {"SJC": "shoulder", "EJC": "elbow", "HJC": "hip", "KJC": "knee", "AJC": "ankle"}
"""Markers of both models and their locations: on the skin or a joint centre, without side."""
PLACES = {"C7": "C7", "CLAV": "CLAV", **{side + name: side + place for side in "RL" for name, place in _SKIN.items()}}


def virtual_markers(motion: Motion, body: Body, posed: PosedSegments) -> MarkerCloud:
    """Return the OpenSim models' markers on the solved body, in metres with Z up."""
    places = marker_landmarks(body, tuple(PLACES.values()))
    worn = worn_offsets(motion)
    offsets = np.array([worn.get(place, np.zeros(3)) for place in PLACES.values()])
    turns = motion.body_pose.reshape(motion.num_frames, -1, 3).astype(np.float64)
    skin = pose_landmarks(
        body,
        places,
        motion.betas.astype(np.float64),
        exp_so3(motion.global_orient.astype(np.float64)),
        exp_so3(turns[:, : body.layout.num_solved]),
        motion.transl.astype(np.float64),
        offsets=offsets,
    ).points
    centres = {
        side[0].upper() + name: posed.joints[f"{side}_{joint}"]
        for side in ("right", "left")
        for name, joint in _CENTRES.items()
    }
    points = np.concatenate([skin, np.stack(list(centres.values()), axis=1)], axis=1)
    return MarkerCloud(points @ posed.ground.T @ WORLD_TO_GROUND, motion.fps, (*PLACES, *centres))


MEASUREMENTS: dict[str, tuple[Sequence[str], Sequence[str], str]] = {
    "pelvis_depth": (("RASI RPSI", "LASI LPSI"), ("pelvis",), "X"),
    "pelvis_height": (("RASI RHJC", "LASI LHJC"), ("pelvis",), "Y"),
    "pelvis_width": (("RASI LASI", "RHJC LHJC"), ("pelvis",), "Z"),
    "torso": (("C7 RHJC", "C7 LHJC"), ("torso",), "X Y"),
    "shoulders": (("RACR LACR",), ("torso",), "Z"),
    **{
        f"{name}_{side.lower()}": ((f"{side}{first} {side}{last}",), [f"{b}_{side.lower()}" for b in bodies], "X Y Z")
        for side in "RL"
        for name, first, last, bodies in (
            ("thigh", "HJC", "KJC", ("femur", "patella")),
            ("shank", "KJC", "AJC", ("tibia",)),
            ("foot", "CAL", "MT5", ("talus", "calcn", "toes")),
            ("upper_arm", "SJC", "EJC", ("humerus",)),
            ("forearm", "EJC", "FAradius", ("ulna", "radius", "hand")),
        )
    },
}
"""Marker pairs for each measurement. The distances between them scale the models' bodies along the axes."""


def scale_setup(name: str, model: str, markers: str, frames: int, fps: float, height_m: float) -> str:
    """Return the XML setup for OpenSim's Scale Tool, for the take's markers and a generic model."""
    measurements = "".join(
        f'<Measurement name="{key}"><apply>true</apply><MarkerPairSet><objects>'
        + "".join(f"<MarkerPair><markers>{pair}</markers></MarkerPair>" for pair in pairs)
        + "</objects></MarkerPairSet><BodyScaleSet><objects>"
        + "".join(f'<BodyScale name="{body}"><axes>{axes}</axes></BodyScale>' for body in bodies)
        + "</objects></BodyScaleSet></Measurement>\n"
        for key, (pairs, bodies, axes) in MEASUREMENTS.items()
    )
    return _document(
        f"<ScaleTool name={quoteattr(name)}><mass>-1</mass><height>{1000 * height_m:.0f}</height>\n"
        f"<GenericModelMaker><model_file>{escape(model)}</model_file></GenericModelMaker>\n"
        "<ModelScaler><apply>true</apply><scaling_order>measurements</scaling_order>\n"
        f"<MeasurementSet><objects>\n{measurements}</objects></MeasurementSet>\n"
        f"<marker_file>{escape(markers)}</marker_file><time_range>0 {(frames - 1) / fps:.6f}</time_range>\n"
        "<preserve_mass_distribution>true</preserve_mass_distribution>\n"
        f"<output_model_file>{escape(name)}_scaled.osim</output_model_file></ModelScaler>\n"
        "</ScaleTool>"
    )


def kinematics_setup(name: str, markers: str, labels: Sequence[str], frames: int, fps: float) -> str:
    """Return the XML setup for OpenSim's Inverse Kinematics Tool with the scaled model."""
    tasks = "".join(
        f'<IKMarkerTask name="{label}"><apply>true</apply><weight>1</weight></IKMarkerTask>\n' for label in labels
    )
    return _document(
        f"<InverseKinematicsTool name={quoteattr(name)}><model_file>{escape(name)}_scaled.osim</model_file>\n"
        f"<IKTaskSet><objects>\n{tasks}</objects></IKTaskSet>\n"
        f"<marker_file>{escape(markers)}</marker_file><time_range>0 {(frames - 1) / fps:.6f}</time_range>\n"
        f"<output_motion_file>{escape(name)}_ik.mot</output_motion_file></InverseKinematicsTool>"
    )


def _document(body: str) -> str:
    return f'<?xml version="1.0" encoding="UTF-8" ?>\n<OpenSimDocument Version="40000">\n{body}\n</OpenSimDocument>\n'
