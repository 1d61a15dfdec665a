"""The body to look at, before and after: ``python -m tests.benchmarks.body_sheets --out SHEET.png [--face]``.

Left of each pair is the skin of the body file, which solves use, right of it what Blender shows, in fixed cameras.
``--face`` draws the relaxed face and some of its shapes instead, ``--looks`` the looks of the body.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import bpy
import numpy as np
from scipy.spatial.transform import Rotation

from assets_procedural.layout import JOINT
from assets_procedural.quality.contact_sheet import rotations
from assets_procedural.skeleton.skinning import posed_joints
from blender_addon.body.body_file import BodyFile, default_body_path, read_body
from blender_addon.body.looks import show_look
from blender_addon.body.rig import create_rig
from blender_addon.conventions.coordinates import R_ARMATURE_BODY
from blender_addon.conventions.naming import LOOKS
from blender_addon.headless.process import leave
from blender_addon.render.contact_sheet import open_lettering
from blender_addon.render.picture import blend, gradient, layer_from_render, write_png
from blender_addon.render.stage import RenderQuality, open_stage
from blender_addon.render.view import View, look_at
from tests.support import posed_rig
from tests.support.shown_body import NAMED, bodies

_QUALITY, _SIZE, _AWAY_M = RenderQuality(shrink=2, cavity=True, shadows=True), (220, 264), 4.0
_VIEWS = (
    ("arms down", "spine3", (0.0, 0.08, 0.0), 0.75, ((0, 5), (35, 10), (180, 5))),
    ("crossed arms", "spine3", (0.0, 0.0, 0.1), 0.80, ((0, 5), (40, 10), (180, 10))),
    ("arms up", "spine3", (0.0, 0.15, 0.0), 0.90, ((0, 5), (40, 10), (180, 5))),
    ("elbows bent", "left_elbow", (0.0, 0.0, 0.05), 0.45, ((0, 10), (90, 30), (150, 20))),
    ("seated", "pelvis", (0.0, 0.0, 0.1), 1.0, ((70, 5), (20, 25), (180, 5))),
    ("cross-legged", "pelvis", (0.0, -0.1, 0.1), 1.0, ((20, 15), (180, 10), (120, 5))),
    ("deep squat", "pelvis", (0.0, 0.0, 0.1), 1.2, ((60, 5), (0, 10), (150, 5))),
)
"""Pose, target joint of the camera, offset in metres, height of the picture in metres, yaws and pitches in degrees."""
_SKIN, _LIPS, _NAIL, _MOUTH = (0.55, 0.50, 0.47), (0.50, 0.26, 0.20), (0.68, 0.46, 0.37), (0.10, 0.02, 0.02)
_COLOURS = (_SKIN, _SKIN, _LIPS, (0.75, 0.73, 0.70), (0.12, 0.16, 0.10), (0.01, 0.01, 0.01), _NAIL, _MOUTH)
_FACE, _EYE = ((0.0, 0.05, 0.05), 0.20), ((0.03, 0.075, 0.1), 0.06)  # Offset from the head's joint, and height.


class Shot(NamedTuple):
    """Settings of a picture of a skin."""

    title: str
    vertices: np.ndarray  # (V, 3) metres in the body's frame.
    centre: np.ndarray  # (3,) metres.
    height_m: float
    yaw: float  # Degrees.
    pitch: float = 0.0


def main() -> int:
    """Render the sheet."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.body_sheets", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, metavar="SHEET.png")
    parser.add_argument("--face", action="store_true", help="draw the face's shapes")
    parser.add_argument("--looks", action="store_true", help="draw the looks")
    args = parser.parse_args()
    body = read_body(default_body_path())
    if args.looks:
        write_png(args.out, draw_looks(body))
        return 0
    rows = face_rows(body) if args.face else pose_rows()
    write_png(args.out, draw(body, rows))
    sys.stdout.write(f"{args.out}: {len(rows)} rows\n")
    return 0


def pose_rows() -> list[list[Shot]]:
    """Return the poses, before and after."""
    rows = []
    for pose, joint, offset, height_m, ways in _VIEWS:
        local, row = rotations(NAMED[pose]), []
        for title, body in bodies().items():
            centre = posed_joints(body.joints, local)[JOINT[joint]] + offset
            row += [Shot(f"{pose}, {title}", body.posed(local), centre, height_m, *way) for way in ways]
        rows.append(row)
    return rows


def face_rows(body: BodyFile) -> list[list[Shot]]:
    """Return the face at rest and with some of its shapes."""
    head = (body.J_regressor @ body.v_template)[JOINT["head"]]

    def shot(values: dict[str, float], yaw: float = 0.0, place: tuple[tuple[float, ...], float] = _FACE) -> Shot:
        vertices = body.v_template.copy()
        for name, value in values.items():
            for key in (name, f"{name}Left", f"{name}Right"):
                if key in body.face_shapes:
                    at, offsets = body.face_shapes[key]
                    vertices[at] += value * offsets
        words = ", ".join(f"{name} {value:g}" for name, value in values.items()) or "rest"
        return Shot(words, vertices, head + place[0], place[1], yaw)

    eyes = [{}, {"eyeBlink": 0.5}, {"eyeBlink": 1.0}, {"eyeLookUp": 1.0}, {"eyeLookIn": 1.0}]
    lips = ("mouthSmile", "mouthFrown", "mouthPucker", "mouthFunnel")
    brows = ("browDown", "browInnerUp", "browOuterUp", "cheekPuff", "noseSneer")
    return [
        [shot({}), shot({}, 40), *(shot({name: 1.0}) for name in ("eyeBlink", "eyeWide", "jawLeft"))],
        [shot(values, 0.0, _EYE) for values in eyes],
        [shot({"jawOpen": 0.4}), *(shot({"jawOpen": 1.0}, yaw) for yaw in (0.0, 40.0)),
         shot({"jawOpen": 1.0, "mouthClose": 1.0}), shot({"jawOpen": 0.4, "mouthSmile": 1.0})],
        [shot({"mouthSmile": 1.0}, 40), *(shot({name: 1.0}) for name in lips)],
        [shot({name: 1.0}) for name in brows],
    ]  # fmt: skip


def draw(body: BodyFile, rows: Sequence[Sequence[Shot]]) -> np.ndarray:
    """Return the pictures combined in one."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    mesh, shown = bpy.data.meshes.new("Body"), bpy.data.collections.new("Shown")
    mesh.from_pydata(body.v_template.tolist(), [], body.faces.tolist())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(body.faces), dtype=bool))
    for colour in _COLOURS:
        material = bpy.data.materials.new("Face")
        material.diffuse_color = (*colour, 1.0)
        mesh.materials.append(material)
    assert body.face_material is not None
    mesh.polygons.foreach_set("material_index", body.face_material.astype(np.int32))
    shown.objects.link(bpy.data.objects.new("Body", mesh))
    width, height = _SIZE
    picture = gradient(max(map(len, rows)) * width, len(rows) * height)
    with TemporaryDirectory() as folder, open_lettering(Path(folder), 15) as letters:
        for i, row in enumerate(rows):
            for j, shot in enumerate(row):
                mesh.vertices.foreach_set("co", (shot.vertices @ R_ARMATURE_BODY.T).astype(np.float32).ravel())
                mesh.update()
                with open_stage("body", (shown,), _view(shot), _QUALITY, Path(folder)) as stage:
                    blend(picture, layer_from_render(stage.render(1.0), _QUALITY.shrink), j * width, i * height)
                letters.write(picture, shot.title, j * width + 5, i * height + 5)
    return picture


_POSES = {
    "standing": {
        "left_shoulder": (0.0, 0.0, -68.0), "right_shoulder": (0.0, 0.0, 68.0), "left_collar": (0.0, 0.0, -6.0),
        "right_collar": (0.0, 0.0, 6.0), "left_elbow": (0.0, -18.0, 0.0), "right_elbow": (0.0, 18.0, 0.0),
    },
    "running": {
        "left_hip": (-60.0, 0.0, 4.0), "left_knee": (75.0, 0.0, 0.0), "right_hip": (22.0, 0.0, -4.0),
        "right_knee": (38.0, 0.0, 0.0), "right_ankle": (25.0, 0.0, 0.0), "left_shoulder": (0.0, 40.0, -66.0),
        "right_shoulder": (0.0, 40.0, 66.0), "left_elbow": (0.0, -85.0, 0.0), "right_elbow": (0.0, 85.0, 0.0),
        "spine1": (6.0, 0.0, 0.0), "spine2": (6.0, 8.0, 0.0),
    },
}  # fmt: skip
_LOOK_VIEWS = (("standing", 20), ("standing", 200), ("running", 60), ("running", -35))  # Poses and yaws.


def draw_looks(body: BodyFile) -> np.ndarray:
    """Return one row per look."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    shown = bpy.data.collections.new("Shown")
    bpy.context.scene.collection.children.link(shown)
    rig = create_rig("Body", body, np.zeros(10), shown)
    width, height = 220, 320
    picture = gradient(len(_LOOK_VIEWS) * width, len(LOOKS) * height)
    with TemporaryDirectory() as folder, open_lettering(Path(folder), 15) as letters:
        for i, look in enumerate(LOOKS):
            show_look(rig.mesh, look)
            for j, (name, yaw) in enumerate(_LOOK_VIEWS):
                turns = Rotation.from_matrix(rotations(_POSES[name])).as_rotvec()
                turns[0] = 0.5 * np.pi, 0.0, 0.0  # upright
                posed_rig.pose(rig, turns)
                middle = np.array([0.0, 0.92, 0.0])
                view = _view(Shot("", np.zeros((0, 3)), middle, 1.95, yaw, 5.0), (width, height))
                with open_stage("look", (shown,), view, _QUALITY, Path(folder)) as stage:
                    blend(picture, layer_from_render(stage.render(1.0), _QUALITY.shrink), j * width, i * height)
                letters.write(picture, look if not j else "", 5, i * height + 5)
    return picture


def _view(shot: Shot, size: tuple[int, int] = _SIZE) -> View:
    yaw, pitch = np.deg2rad([shot.yaw, shot.pitch])
    away = np.array([np.sin(yaw) * np.cos(pitch), -np.cos(yaw) * np.cos(pitch), np.sin(pitch)])
    centre = R_ARMATURE_BODY @ shot.centre
    angle = 2.0 * float(np.arctan(0.5 * shot.height_m / _AWAY_M))
    return View(look_at("fixed", centre + _AWAY_M * away, centre, size, angle), size)


if __name__ == "__main__":
    leave(main())
