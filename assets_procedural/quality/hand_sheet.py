"""Draw the hands from both sides: ``python -m assets_procedural.quality.hand_sheet --out FILE.png``."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from assets_procedural.arrays import Array
from assets_procedural.quality.contact_sheet import MATERIAL_COLOURS, RasterView, read_baked, render, tile, write_png
from solver_backend.body.body import Body
from solver_backend.body.hand_skeleton import ANGLES
from solver_backend.body.hands import finger_rotations, hand_points, hand_skeletons, load_body_with_hands, rest_angles
from solver_backend.body.mesh import face_normals, pose_mesh
from solver_backend.exchange.body_layout import SMPL, SMPL_HANDS
from solver_backend.exchange.joint_sets import SIDES
from solver_backend.exchange.verb import flag, option, output, parse_script, values

Degrees = Mapping[str, float]
_FINGERS = ("index", "middle", "ring", "pinky")


def _all(mcp: float, pip: float, dip: float, fingers: tuple[str, ...] = _FINGERS) -> dict[str, float]:
    bends = {"mcp": mcp, "pip": pip, "dip": dip}
    return {f"{finger}_{joint}_flexion": bend for finger in fingers for joint, bend in bends.items()}


def _spread(index: float, middle: float, ring: float, pinky: float) -> dict[str, float]:
    return {f"{finger}_mcp_spread": v for finger, v in zip(_FINGERS, (index, middle, ring, pinky), strict=True)}


def _thumb(*angles: float) -> dict[str, float]:
    names = ("cmc_flexion", "cmc_spread", "cmc_twist", "mcp_flexion", "ip_flexion")
    return {f"thumb_{name}": angle for name, angle in zip(names, angles, strict=True)}


_FOLDED = _thumb(35, 10, 0, 45, 60)
HANDS: dict[str, Degrees] = {  # Angles in degrees, by pose name. Joints that are not listed are at rest.
    "rest": {},
    "flat": _all(0, 0, 0) | _spread(-8, -2, 5, 10) | _thumb(0, 5, 0, 0, 0),
    "spread": _all(-5, 0, 0) | _spread(16, 2, -10, -22) | _thumb(-25, 45, 0, -5, -10),
    "fist": _all(85, 95, 60) | _spread(-4, 0, 2, 4) | _FOLDED,
    "point": _all(0, 5, 0) | _all(85, 95, 60, _FINGERS[1:]) | _spread(-4, 0, 2, 4) | _FOLDED,
    "pinch": {**_all(25, 35, 15), "index_mcp_flexion": 43, "index_pip_flexion": 61, "index_dip_flexion": 59}
    | {"index_mcp_spread": 4}
    | _thumb(25, 21, 26, -6, -2),
}
_FACES = 0.7  # Smallest cosine between a palm face's normal and the direction of the palm.
_PALM = (0.88, 0.64, 0.52)  # Colour of the palms on the sheet. It makes them visible in each pose.
_SIDES = ((0.0, 90.0), (0.0, -90.0), (0.0, 0.0), (-90.0, 10.0), (180.0, -20.0))
"""Yaw and pitch of each view of a left hand in degrees: back, palm, thumb side, fingertips, little finger side."""


def pose_hands(body: Body, degrees: Degrees, *, correctives: bool = True) -> Array:
    """Pose both hands by angles in degrees (see ``HANDS``). Return vertices (V, 3) of the mean shape in metres."""
    angles = rest_angles(body)[None].copy()
    for name, value in degrees.items():
        angles[..., ANGLES.index(name)] = np.radians(value)
    still = np.tile(np.eye(3), (1, SMPL.num_solved, 1, 1))
    local = np.concatenate([still, finger_rotations(body, angles)], axis=1)
    return pose_mesh(body, np.zeros(10), np.eye(3)[None], local, np.zeros((1, 3)), correctives=correctives)[0]


def palm_faces(body: Body, side: int) -> Array:
    """Return a mask (T,) of the palm faces on the left (0) or right (1) side.

    These faces follow the wrist, are in front of the knuckles, and face away from the back of the hand.
    """
    skeleton, start = hand_skeletons(body)[side], hand_points(body, side)
    middles, normals = body.v_template[body.faces].mean(axis=1), face_normals(body.v_template, body.faces)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    wrist = SMPL_HANDS.joints.index(f"{SIDES[side]}_wrist")
    knuckle = start[9]
    along = (middles - start[0]) @ (knuckle - start[0]) / ((knuckle - start[0]) @ (knuckle - start[0]))
    carried = body.weights[:, wrist][body.faces].min(axis=1) > 0.5
    return carried & (along > 0.2) & (along < 0.9) & (normals @ skeleton.palm[2, :, 1] < -_FACES)


def draw_hands(body: Body, material: Array, *, correctives: bool = True, side: str = "left") -> Array:
    """Return the sheet for the hand on one side, with one row per pose."""
    centre = tuple(body.joints_template[SMPL_HANDS.joints.index(f"{side}_middle1")] + [0.0, -0.02, 0.01])
    hand = body.weights[:, list(SMPL_HANDS.group(f"{side}_hand"))].sum(axis=1)
    near = (body.weights[:, SMPL_HANDS.joints.index(f"{side}_wrist")] + hand)[body.faces].min(axis=1) > 0
    faces, colours, pictures = body.faces[near], MATERIAL_COLOURS[material[near]].copy(), []
    colours[palm_faces(body, SIDES.index(side))[near]] = _PALM
    for degrees in HANDS.values():
        skin = pose_hands(body, degrees, correctives=correctives)
        for yaw, pitch in _SIDES:
            yaw = yaw if side == "left" else -yaw
            view = RasterView(yaw=yaw, pitch=pitch, centre=centre, height_m=0.2, size=(420, 420))
            pictures.append(render(skin, faces, colours, view))
    return tile(pictures, len(_SIDES))


def main() -> None:
    """Draw the hand sheet of the bundled body and write it to a PNG file."""
    sides = values("left", "right", "both")
    arguments = parse_script(
        __doc__,
        output("SHEET.png", "Picture to write"),
        flag("plain", "Leave out the correctives"),
        option("choice", "side", "", "Hand to draw. The value both draws the left one first", "both", choices=sides),
    )
    body, material = load_body_with_hands(), read_baked().material
    sides = ("left", "right") if arguments.side == "both" else (arguments.side,)
    drawn = [draw_hands(body, material, correctives=not arguments.plain, side=side) for side in sides]
    write_png(arguments.out, np.concatenate(drawn, axis=1))


if __name__ == "__main__":
    main()
