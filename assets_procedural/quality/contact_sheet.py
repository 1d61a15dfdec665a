"""Rest, shapes, poses and close-ups to look at: ``python -m assets_procedural.quality.contact_sheet --out FOLDER``."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from assets_procedural.arrays import Array
from assets_procedural.build import BODY_FILE
from assets_procedural.layout import JOINT, PARENTS
from assets_procedural.quality.raster import RasterView, render, tile, write_png
from assets_procedural.skeleton.correctives import pose_features
from assets_procedural.skeleton.skinning import linear_blend, pose_skeleton, posed_joints

Degrees = dict[str, tuple[float, float, float]]

BENDS: dict[str, Degrees] = {
    "elbow": {"left_elbow": (0, -1, 0), "right_elbow": (0, 1, 0)},
    "knee": {"left_knee": (1, 0, 0), "right_knee": (1, 0, 0)},
    "hip": {"left_hip": (-1, 0, 0), "right_hip": (-1, 0, 0)},
    "shoulder": {"left_shoulder": (0, -1, 0), "right_shoulder": (0, 1, 0)},
}
"""Axis of each bend, both sides; the shoulder's brings the arms forward."""

EXTREMES: dict[str, Degrees] = {
    "high knee": {"left_hip": (-90, 0, 0), "left_knee": (90, 0, 0), "right_elbow": (0, 90, 0)},
    "deep squat": {
        "left_hip": (-115, 0, 14),
        "right_hip": (-115, 0, -14),
        "left_knee": (125, 0, 0),
        "right_knee": (125, 0, 0),
        "left_ankle": (-25, 0, 0),
        "right_ankle": (-25, 0, 0),
        "spine1": (15, 0, 0),
        "spine2": (10, 0, 0),
        "left_shoulder": (0, -80, 0),
        "right_shoulder": (0, 80, 0),
    },
    "cross-legged": {
        "left_hip": (-92, 82, -15),
        "right_hip": (-92, -82, 15),
        "left_knee": (130, 0, 0),
        "right_knee": (130, 0, 0),
    },
    "arms down": {
        "left_collar": (0, 0, -8),
        "right_collar": (0, 0, 8),
        "left_shoulder": (0, 0, -70),
        "right_shoulder": (0, 0, 70),
        "left_elbow": (0, -15, 0),
    },
    "arms up": {
        "left_collar": (0, 0, 22),
        "right_collar": (0, 0, -22),
        "left_shoulder": (0, 0, 65),
        "right_shoulder": (0, 0, -65),
    },
    "hands to face": {
        "left_shoulder": (0, -55, -25),
        "right_shoulder": (0, 55, 25),
        "left_elbow": (0, -135, 0),
        "right_elbow": (0, 135, 0),
    },
    "forearm twist": {
        "left_wrist": (90, 0, 0),
        "right_wrist": (-90, 0, 0),
        "left_elbow": (0, -60, 0),
        "right_shoulder": (0, 30, 50),
    },
    "toe touch": {
        "spine1": (30, 0, 0),
        "spine2": (25, 0, 0),
        "spine3": (20, 0, 0),
        "neck": (25, 0, 0),
        "left_hip": (-50, 0, 0),
        "right_hip": (-50, 0, 0),
        "left_shoulder": (0, -80, -20),
        "right_shoulder": (0, 80, 20),
    },
    "trunk twist": {
        "spine1": (0, 25, 0),
        "spine2": (0, 25, 0),
        "spine3": (0, 20, 0),
        "neck": (0, 30, 0),
        "head": (0, 25, 0),
        "left_shoulder": (0, 0, -60),
        "right_shoulder": (0, 0, 60),
    },
    "side split": {"left_hip": (0, 0, 65), "right_hip": (0, 0, -65)},
    "kick back": {
        "right_hip": (35, 0, 0),
        "right_knee": (120, 0, 0),
        "left_ankle": (-25, 0, 0),
        "left_shoulder": (0, 0, 60),
        "right_shoulder": (0, -30, 40),
        "spine1": (-20, 0, 0),
        "spine2": (-15, 0, 0),
    },
    "side bend": {
        "spine1": (0, 0, 22),
        "spine2": (0, 0, 20),
        "spine3": (0, 0, 12),
        "neck": (0, 0, 25),
        "left_shoulder": (0, 0, -70),
        "right_collar": (0, 0, -15),
        "right_shoulder": (0, 0, -75),
    },
    "lunge and throw": {
        "left_hip": (-85, 0, 10),
        "left_knee": (85, 0, 0),
        "right_hip": (25, 0, 0),
        "right_knee": (25, 0, 0),
        "right_foot": (-30, 0, 0),
        "right_shoulder": (0, -25, -20),
        "right_elbow": (0, 100, 0),
        "right_wrist": (0, 0, 45),
        "left_shoulder": (0, -40, -15),
        "spine2": (0, 20, 0),
        "head": (0, 35, 0),
    },
}
"""Thirteen poses by name, joint rotation vectors in degrees."""


def rotations(pose: Degrees, scale: float = 1.0) -> np.ndarray:
    """Return the (24, 3, 3) local rotations of a pose, every angle multiplied by ``scale``."""
    vectors = np.zeros((len(PARENTS), 3))
    for name, degrees in pose.items():
        vectors[JOINT[name]] = np.deg2rad(np.array(degrees, dtype=np.float64) * scale)
    return Rotation.from_rotvec(vectors).as_matrix()


MATERIAL_COLOURS = np.array(
    [[0.80, 0.62, 0.50], [0.42, 0.47, 0.54], [0.70, 0.46, 0.40], [0.88, 0.87, 0.85], [0.30, 0.36, 0.28], [0.05] * 3,
     [0.90, 0.74, 0.66]]
)  # fmt: skip
"""In the order of ``parts.MATERIAL_NAMES``."""
_UP: Degrees = {"left_collar": (0, 0, 22), "left_shoulder": (0, 0, 65)}
_BENT: Degrees = {"left_elbow": (0, -110, 0)}
_HANGING: Degrees = {"left_collar": (0, 0, -8), "left_shoulder": (0, 0, -70), "left_elbow": (0, -15, 0)}
_REST: Degrees = {}
_PLACES: tuple[tuple[Degrees, str, tuple[float, float, float], float, tuple[tuple[float, float], ...]], ...] = (
    (_REST, "head", (0.0, 0.07, 0.0), 0.30, ((0, 0), (-40, 0), (-90, 0))),
    (_REST, "head", (0.032, 0.077, 0.10), 0.07, ((0, 0), (-45, 10))),
    (_REST, "head", (0.0, 0.010, 0.10), 0.09, ((0, 0), (-45, 0))),
    (_REST, "left_hand", (0.02, -0.02, 0.01), 0.26, ((0, 90), (0, -90), (0, 10), (-70, 15))),
    (_HANGING, "left_hand", (0.0, -0.04, 0.0), 0.30, ((-60, 0), (60, 0))),
    (_REST, "left_wrist", (0.0, 0.0, 0.0), 0.16, ((180, 30), (0, 30))),
    (_UP, "left_shoulder", (0.0, -0.08, 0.0), 0.60, ((0, 0), (-60, 0), (180, 0))),
    (_BENT, "left_elbow", (0.0, 0.0, 0.04), 0.34, ((40, 35), (0, 90))),
    (_REST, "left_foot", (0.0, 0.0, -0.02), 0.22, ((0, 35), (-45, 25), (50, 25))),
)
"""Pose, joint, offset from it in the rest frame and height of the picture (metres), yaws and pitches (degrees)."""


@dataclass(frozen=True)
class BakedBody:
    """The arrays of a body file in double precision."""

    vertices: Array
    faces: Array
    weights: Array
    shapedirs: Array
    posedirs: Array
    regressor: Array
    material: Array

    @property
    def joints(self) -> Array:
        """Return the (24, 3) rest joints of the mean shape."""
        return self.regressor @ self.vertices

    def posed(self, local: Array, *, correctives: bool = True) -> Array:
        """Return the (V, 3) skinned vertices of the mean shape for (24, 3, 3) local rotations."""
        vertices = self.vertices
        if correctives:
            vertices = vertices + self.posedirs @ pose_features(local[None])[0]
        return linear_blend(vertices, self.weights, *pose_skeleton(self.joints, local))


def read_baked(path: Path = BODY_FILE) -> BakedBody:
    """Read a body file."""
    with np.load(path, allow_pickle=False) as data:
        names = ("v_template", "f", "weights", "shapedirs", "posedirs", "J_regressor", "face_material")
        arrays = {name: data[name] for name in names}
    real = {name: value.astype(np.float64) for name, value in arrays.items() if value.dtype.kind == "f"}
    return BakedBody(
        real["v_template"],
        arrays["f"].astype(np.int64),
        real["weights"],
        real["shapedirs"],
        real["posedirs"],
        real["J_regressor"],
        arrays["face_material"].astype(np.int64),
    )


def draw_close(body: BakedBody) -> Array:
    """Return the sheet of close-ups."""
    turns = {id(pose): rotations(pose) for pose in close_poses()}
    posed = {key: body.posed(local) for key, local in turns.items()}
    joints = {key: posed_joints(body.joints, local) for key, local in turns.items()}
    colours = MATERIAL_COLOURS[body.material]
    return tile([render(posed[id(pose)], body.faces, colours, view) for pose, view in close_views(joints)], 6)


def draw_all(body: BakedBody) -> dict[str, Array]:
    """Return the sheets of the whole body by file name."""
    colours = MATERIAL_COLOURS[body.material]

    def draw(vertices: Array, view: RasterView) -> Array:
        return render(vertices, body.faces, colours, view)

    rest = [draw(body.vertices, view) for view in _rest_views(body)]
    posed = []
    for pose in EXTREMES.values():
        vertices = body.posed(rotations(pose))
        middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        posed += [
            draw(vertices, RasterView(yaw=yaw, pitch=8, centre=tuple(middle), height_m=2.0)) for yaw in (30, -150)
        ]
    shapes = [
        draw(body.vertices + sign * 2.0 * body.shapedirs[:, :, k], RasterView(yaw=25, size=(320, 480), height_m=2.1))
        for sign in (1, -1)
        for k in range(body.shapedirs.shape[2])
    ]
    return {"rest.png": tile(rest, 4), "poses.png": tile(posed, 6), "shapes.png": tile(shapes, 10)}


def _rest_views(body: BakedBody) -> list[RasterView]:
    head = tuple(body.joints[15] + [0.0, 0.07, 0.0])
    hand = tuple(body.joints[22] + [0.02, -0.01, 0.01])
    foot = tuple(0.5 * (body.joints[7] + body.joints[10]))
    hips = tuple(body.joints[0] + [0.0, -0.06, 0.0])
    near = [RasterView(yaw=yaw, centre=head, height_m=0.32) for yaw in (0, 40, 90)]
    hands = [RasterView(yaw=0, pitch=pitch, centre=hand, height_m=0.26) for pitch in (90, 25)]
    feet = [
        RasterView(yaw=-40, pitch=25, centre=foot, height_m=0.30),
        RasterView(yaw=60, pitch=15, centre=foot, height_m=0.30),
    ]
    trunk = [RasterView(yaw=yaw, centre=hips, height_m=0.62) for yaw in (0, 180)]
    chest = [RasterView(yaw=yaw, centre=tuple(body.joints[9]), height_m=0.62) for yaw in (20, 160)]
    whole = [RasterView(yaw=yaw, height_m=1.95) for yaw in (0, 45, 90, 180)]
    return whole + near + hands[:1] + hands[1:] + feet + trunk[:1] + trunk[1:] + chest


def main() -> None:
    """Render the sheets of a body file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--body", type=Path, default=BODY_FILE)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--close", action="store_true", help="draw the close-ups alone")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    body = read_baked(arguments.body)
    sheets = {"close.png": draw_close(body)} | ({} if arguments.close else draw_all(body))
    for name, image in sheets.items():
        write_png(arguments.out / name, image)


if __name__ == "__main__":
    main()


def close_views(joints_of: dict[int, Array]) -> Iterator[tuple[Degrees, RasterView]]:
    """Yield each pose with a view of it.

    Args:
        joints_of: by ``id`` of a pose of ``close_poses``, the (24, 3) posed joints, metres.
    """
    for pose, joint, offset, height_m, ways in _PLACES:
        centre = joints_of[id(pose)][JOINT[joint]] + np.array(offset)
        for yaw, pitch in ways:
            yield pose, RasterView(yaw=yaw, pitch=pitch, centre=tuple(centre), height_m=height_m, size=(360, 360))


def close_poses() -> list[Degrees]:
    """Return the poses that are looked at."""
    return list({id(pose): pose for pose, *_ in _PLACES}.values())
