"""Draw shapes and poses of the body: ``python -m assets_procedural.quality.contact_sheet``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from assets_procedural.arrays import NUMBERS, Array
from assets_procedural.build import BODY_FILE
from assets_procedural.layout import JOINT, PARENTS
from assets_procedural.skeleton.correctives import pose_features
from assets_procedural.skeleton.skinning import linear_blend, pose_skeleton, posed_joints, vertex_normals
from solver_backend.exchange.verb import flag, option, output, parse_script
from solver_backend.io.png import png_bytes

_KEY, _FILL, _TOP = np.array([-0.45, 0.55, 0.70]), np.array([0.87, 0.11, 0.44]), np.array([0.0, 1.0, 0.0])
_BACKGROUND = np.array([0.90, 0.91, 0.93])  # Linear background colour. Chosen by hand.


@dataclass(frozen=True)
class RasterView:
    """Orthographic camera, rotated by ``yaw`` degrees and tilted by ``pitch`` degrees."""

    yaw: float = 0.0
    pitch: float = 0.0
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    height_m: float = 1.9
    size: tuple[int, int] = (480, 480)  # Width and height in pixels.

    @property
    def turn(self) -> Array:
        """Return the rotation (3, 3) to the axes of the view: x right, y up, z towards the viewer."""
        a, b = np.deg2rad([self.yaw, self.pitch])
        about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
        about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
        return about_x @ about_y


def render(vertices: Array, faces: Array, colours: Array, view: RasterView, oversample: int = 2) -> Array:
    """Return an (H, W, 3) uint8 picture with smooth shading. Face colours (F, 3) are from 0 to 1.

    ``oversample`` is the number of samples along each side of a pixel.
    """
    width, height = (oversample * s for s in view.size)
    scale = height / view.height_m
    seen = (vertices - np.array(view.centre)) @ view.turn.T
    normals = vertex_normals(seen, faces)
    xy = np.stack([seen[:, 0] * scale + width / 2, height / 2 - seen[:, 1] * scale], axis=1)
    depth = np.full((height, width), -np.inf)
    normal, colour = np.zeros((height, width, 3)), np.zeros((height, width, 3))
    for face, tint in zip(faces, colours, strict=True):
        _fill(xy[face], seen[face, 2], normals[face], tint, depth, normal, colour)
    image = np.where(np.isfinite(depth)[..., None], _shade(normal) * colour, _BACKGROUND).clip(0, 1) ** (1 / 1.6)
    blocks = image.reshape(height // oversample, oversample, width // oversample, oversample, 3)
    return np.round(255 * blocks.mean(axis=(1, 3))).astype(np.uint8)


def _fill(xy: Array, z: Array, normals: Array, tint: Array, depth: Array, normal: Array, colour: Array) -> None:
    height, width = depth.shape
    x0, y0 = np.maximum(np.floor(xy.min(axis=0)).astype(int), 0)
    x1, y1 = np.minimum(np.ceil(xy.max(axis=0)).astype(int) + 1, (width, height))
    (ax, ay), (bx, by), (cx, cy) = xy
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if area >= 0 or x1 <= x0 or y1 <= y0:  # y points down in the picture, so visible faces have a negative area
        return
    x, y = np.arange(x0, x1)[None], np.arange(y0, y1)[:, None]
    v = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
    w = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
    u = 1.0 - v - w
    here = u * z[0] + v * z[1] + w * z[2]
    window = (slice(y0, y1), slice(x0, x1))
    visible = (u >= -1e-9) & (v >= -1e-9) & (w >= -1e-9) & (here > depth[window])
    depth[window][visible] = here[visible]
    blended = u[..., None] * normals[0] + v[..., None] * normals[1] + w[..., None] * normals[2]
    normal[window][visible] = blended[visible]
    colour[window][visible] = tint


def _shade(normal: Array) -> Array:
    n = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    light = 0.15 + 0.10 * (n @ _TOP).clip(0, 1)
    for direction, strength in ((_KEY, 0.66), (_FILL, 0.22)):
        light = light + strength * (n @ (direction / np.linalg.norm(direction))).clip(0, 1)
    return light[..., None]


def tile(images: list[Array], columns: int) -> Array:
    """Combine pictures of equal size row by row. Fill the last row with background."""
    blank = np.broadcast_to(np.round(255 * _BACKGROUND ** (1 / 1.6)).astype(np.uint8), images[0].shape)
    padded = images + [blank] * (-len(images) % columns)
    rows = [np.concatenate(padded[i : i + columns], axis=1) for i in range(0, len(padded), columns)]
    return np.concatenate(rows, axis=0)


def write_png(path: Path, image: Array) -> None:
    """Write an (H, W, 3) uint8 picture to a PNG file."""
    path.write_bytes(png_bytes(image))


Degrees = dict[str, tuple[float, float, float]]
_POSES: dict[str, dict[str, Degrees]] = json.loads((NUMBERS / "poses.json").read_text(encoding="utf-8"))
BENDS, EXTREMES = _POSES["bends"], _POSES["extremes"]  # Rotation vectors of joints in degrees. For a bend, its axis.


def rotations(pose: Degrees, scale: float = 1.0) -> np.ndarray:
    """Return the local rotations (24, 3, 3) of a pose, with all angles multiplied by ``scale``."""
    vectors = np.zeros((len(PARENTS), 3))
    for name, degrees in pose.items():
        vectors[JOINT[name]] = np.deg2rad(np.array(degrees, dtype=np.float64) * scale)
    return Rotation.from_rotvec(vectors).as_matrix()


# In the order of ``charts.MATERIAL_NAMES``.
MATERIAL_COLOURS = np.array([[0.80, 0.62, 0.50], [0.42, 0.47, 0.54], [0.70, 0.46, 0.40], [0.88, 0.87, 0.85]])
MATERIAL_COLOURS = np.concatenate([MATERIAL_COLOURS, [[0.30, 0.36, 0.28], [0.05] * 3, [0.90, 0.74, 0.66]]])
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
"""Pose, joint, offset from the joint at rest and picture height in metres, and yaw and pitch in degrees."""


@dataclass(frozen=True)
class BakedBody:
    """Arrays of a body file in double precision."""

    vertices: Array
    faces: Array
    weights: Array
    shapedirs: Array
    posedirs: Array
    regressor: Array
    material: Array

    @property
    def joints(self) -> Array:
        """Return the rest joints (24, 3) of the mean shape in metres."""
        return self.regressor @ self.vertices

    def posed(self, local: Array, *, correctives: bool = True) -> Array:
        """Return the skinned vertices (V, 3) of the mean shape in metres, for local rotations (24, 3, 3)."""
        vertices = self.vertices
        if correctives:
            vertices = vertices + self.posedirs @ pose_features(local[None])[0]
        return linear_blend(vertices, self.weights, *pose_skeleton(self.joints, local))


def read_baked(path: Path = BODY_FILE) -> BakedBody:
    """Read a body file's arrays in double precision."""
    names = ("v_template", "f", "weights", "shapedirs", "posedirs", "J_regressor", "face_material")
    with np.load(path, allow_pickle=False) as data:
        arrays = [data[name] for name in names]
    return BakedBody(*(array.astype(np.float64 if array.dtype.kind == "f" else np.int64) for array in arrays))


def draw_close(body: BakedBody) -> Array:
    """Return a sheet of close-ups of joints, at rest and bent."""
    colours, pictures = MATERIAL_COLOURS[body.material], []
    for pose, joint, offset, height_m, ways in _PLACES:
        local = rotations(pose)
        vertices, centre = body.posed(local), posed_joints(body.joints, local)[JOINT[joint]] + np.array(offset)
        for yaw, pitch in ways:
            view = RasterView(yaw=yaw, pitch=pitch, centre=tuple(centre), height_m=height_m, size=(360, 360))
            pictures.append(render(vertices, body.faces, colours, view))
    return tile(pictures, 6)


def draw_all(body: BakedBody) -> dict[str, Array]:
    """Return the sheets of the whole body in several shapes and poses, by file name."""
    colours = MATERIAL_COLOURS[body.material]

    def draw(vertices: Array, view: RasterView) -> Array:
        return render(vertices, body.faces, colours, view)

    rest = [draw(body.vertices, view) for view in _rest_views(body)]
    posed = []
    for pose in EXTREMES.values():
        vertices = body.posed(rotations(pose))
        middle = tuple(0.5 * (vertices.min(axis=0) + vertices.max(axis=0)))
        posed += [draw(vertices, RasterView(yaw, 8, middle, 2.0)) for yaw in (30, -150)]
    view = RasterView(yaw=25, size=(320, 480), height_m=2.1)
    moves = [sign * 2.0 * move for sign in (1, -1) for move in np.moveaxis(body.shapedirs, 2, 0)]
    shapes = [draw(body.vertices + move, view) for move in moves]
    return {"rest.png": tile(rest, 4), "poses.png": tile(posed, 6), "shapes.png": tile(shapes, 10)}


def _rest_views(body: BakedBody) -> list[RasterView]:
    joints = body.joints
    head, hand, hips = joints[15] + [0.0, 0.07, 0.0], joints[22] + [0.02, -0.01, 0.01], joints[0] + [0.0, -0.06, 0.0]
    near = [(head, 0.32, yaw, 0) for yaw in (0, 40, 90)] + [(hand, 0.26, 0, pitch) for pitch in (90, 25)]
    near += [(0.5 * (joints[7] + joints[10]), 0.30, yaw, pitch) for yaw, pitch in ((-40, 25), (60, 15))]
    near += [(hips, 0.62, yaw, 0) for yaw in (0, 180)] + [(joints[9], 0.62, yaw, 0) for yaw in (20, 160)]
    whole = [RasterView(yaw=yaw, height_m=1.95) for yaw in (0, 45, 90, 180)]
    return whole + [RasterView(yaw=y, pitch=p, centre=tuple(centre), height_m=h) for centre, h, y, p in near]


def main() -> None:
    """Render the contact sheets of a body file to PNG files."""
    body_file = option("path", "body", "BODY.npz", "Body file", BODY_FILE)
    out, close = output("DIR", "Folder of the sheets", kind="folder"), flag("close", "Draw the close-ups alone")
    arguments = parse_script(__doc__, body_file, out, close)
    arguments.out.mkdir(parents=True, exist_ok=True)
    body = read_baked(arguments.body)
    sheets = {"close.png": draw_close(body)} | ({} if arguments.close else draw_all(body))
    for name, image in sheets.items():
        write_png(arguments.out / name, image)


if __name__ == "__main__":
    main()
