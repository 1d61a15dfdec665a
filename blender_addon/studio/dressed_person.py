"""Build a shot's dressed person as meshes, which are posed for every picture."""

from __future__ import annotations

import colorsys

import bpy
import numpy as np

from .._exchange.motion_file import MotionFile
from ..body.body_file import BodyFile, skin
from ..conventions.datablocks import shader_of
from .scene_file import SceneFile

COLOURS = "paint"  # Name of the colour attribute.
_SKINS = ((0.60, 0.36, 0.25), (0.48, 0.27, 0.18), (0.33, 0.17, 0.10), (0.20, 0.095, 0.055), (0.09, 0.042, 0.026))
"""Skin colours in linear RGB, from light to dark. Chosen by hand."""
_HAIRS = ((0.012, 0.009, 0.008), (0.035, 0.018, 0.01), (0.11, 0.055, 0.025), (0.33, 0.2, 0.08), (0.25, 0.24, 0.24))
"""Hair colours in linear RGB. Chosen by hand."""
_PATTERNS = ("plain", "plain", "stripes", "upright", "checks", "blocks")


def linear(hue: float, saturation: float, value: float) -> np.ndarray:
    """Convert HSV to linear RGB, shape (3,)."""
    return np.array(colorsys.hsv_to_rgb(hue, saturation, value)) ** 2.2


def painted_material(name: str, roughness: float) -> bpy.types.Material:
    """Return a material that shows the corner colours of its mesh."""
    material = bpy.data.materials.new(name)
    shader, tree = shader_of(material), material.node_tree
    shader.inputs["Roughness"].default_value = roughness
    paint = tree.nodes.new("ShaderNodeAttribute")
    paint.attribute_name = COLOURS
    tree.links.new(paint.outputs["Color"], shader.inputs["Base Color"])
    return material


def painted_object(
    name: str, points: np.ndarray, faces: np.ndarray, colours: np.ndarray, roughness: float, *, smooth: bool = True
) -> bpy.types.Object:
    """Create an object with linear RGB colours (C, 3) at its triangle corners."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points.tolist(), [], faces.tolist())
    mesh.polygons.foreach_set("use_smooth", np.full(len(faces), smooth))
    attribute = mesh.color_attributes.new(COLOURS, "FLOAT_COLOR", "CORNER")
    attribute.data.foreach_set("color", np.c_[colours, np.ones(len(colours))].astype(np.float32).ravel())
    mesh.materials.append(painted_material(name, roughness))
    mesh.update()
    return bpy.data.objects.new(name, mesh)


def move_vertices(obj: bpy.types.Object, vertices: np.ndarray) -> None:
    """Move an object's vertices to (V, 3) positions in metres."""
    obj.data.vertices.foreach_set("co", np.ascontiguousarray(vertices, np.float32).ravel())
    obj.data.update()


def person_colours(scene: SceneFile, rng: np.random.Generator) -> np.ndarray:
    """Return linear RGB colours (3 T, 3) for the triangle corners of a dressed person."""
    tone = np.array(_SKINS[rng.integers(len(_SKINS))]) * rng.uniform(0.85, 1.15)
    strand = np.array(_HAIRS[rng.integers(len(_HAIRS))]) * rng.uniform(0.8, 1.2)
    corner = scene.faces.ravel()
    label = np.repeat(scene.label, 3)
    colours = np.zeros((len(corner), 3))
    for index, name in enumerate(scene.labels):
        chosen = label == index
        if not chosen.any():
            continue
        rest = scene.rest[corner[chosen]]
        if name == "skin":
            colours[chosen] = _skin(tone, rest)
        elif name == "hair":
            colours[chosen] = strand * (1 + 0.5 * np.sin(rest @ rng.normal(size=3) * 260))[:, None] * 0.8
        elif name == "shoes":
            colours[chosen] = linear(rng.random(), 0.3, rng.uniform(0.1, 0.8))
        else:
            colours[chosen] = _cloth(rest, rng, plain=name == "suit")
    return np.clip(colours, 0.002, 0.95)


def _skin(tone: np.ndarray, rest: np.ndarray) -> np.ndarray:
    blotch = np.sin(rest[:, 0] * 31 + 2) * np.sin(rest[:, 1] * 27) * np.sin(rest[:, 2] * 29 + 1)
    return tone * (1 + 0.06 * blotch[:, None] * [0.3, 1.0, 1.0])


def _cloth(rest: np.ndarray, rng: np.random.Generator, *, plain: bool) -> np.ndarray:
    base = linear(rng.random(), rng.uniform(0.15, 0.8), rng.uniform(0.2, 0.9))
    other = linear(rng.random(), rng.uniform(0.0, 0.7), rng.uniform(0.15, 0.95))
    pattern = "plain" if plain else _PATTERNS[rng.integers(len(_PATTERNS))]
    length = rng.uniform(0.05, 0.1)
    up, across = np.sin(2 * np.pi * rest[:, 1] / length) > 0, np.sin(2 * np.pi * rest[:, 0] / length) > 0
    middle = np.median(rest[:, 1])
    mixes = {"plain": np.zeros(len(rest)), "stripes": up * 1.0, "upright": across * 1.0}
    mixes |= {"checks": 0.5 * up + 0.5 * across, "blocks": (rest[:, 1] > middle) * 1.0}
    mix = mixes[pattern][:, None]
    return base * (1 - mix) + other * mix


class DressedPerson:
    """A dressed person to pose and render. Its triangle corners have linear RGB colours (3 T, 3)."""

    def __init__(
        self,
        body: BodyFile,
        motion: MotionFile,
        scene: SceneFile,
        colours: np.ndarray,
        collection: bpy.types.Collection,
    ) -> None:
        self._body, self._motion, self._scene = body, motion, scene
        self._known: dict[int, np.ndarray] = {}
        self.object = painted_object("person", self.surface(0), scene.faces, colours, 0.6)
        collection.objects.link(self.object)

    def pose(self, frame: float) -> None:
        """Move the vertices to their positions at a fractional frame, interpolated linearly."""
        first = int(np.floor(frame))
        share = frame - first
        vertices = self.surface(first)
        if share > 1e-6:
            vertices = (1 - share) * vertices + share * self.surface(first + 1)
        move_vertices(self.object, vertices)

    def surface(self, frame: int) -> np.ndarray:
        """Return the vertices (N, 3) in world metres at a frame, which is clamped to the frames of the motion."""
        frame = int(np.clip(frame, 0, self._motion.num_frames - 1))
        if frame not in self._known:
            while len(self._known) > 2:
                self._known.pop(next(iter(self._known)))
            vertices = skin(self._body, self._motion, [frame])[0]
            moved = vertices[self._scene.base]
            if self._scene.offset_m.any():
                moved = moved + self._scene.offset_m[:, None] * _normals(vertices, self._body.faces)[self._scene.base]
            self._known[frame] = moved
        return self._known[frame]


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return unit normals (V, 3): area-weighted sums over the adjacent triangles, as in the solver."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    across = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    corner = faces.ravel()
    total = np.stack([np.bincount(corner, across[:, i], len(vertices)) for i in range(3)], axis=1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


RADIUS_M = 0.007  # Radius of a marker in metres. Balls of 14 mm are common.
_RINGS, _SEGMENTS = 4, 8
_GREY = (0.75, 0.75, 0.78)
"""Marker colour in linear RGB. Chosen by hand."""


class MarkerBalls:
    """Marker balls in linear RGB ``colours`` (count, 3). If these are None, the balls are grey."""

    def __init__(
        self,
        count: int,
        collection: bpy.types.Collection,
        radius_m: float = RADIUS_M,
        colours: np.ndarray | None = None,
    ) -> None:
        points, faces = ball(radius_m)
        self._ball, self._count = points, count
        every = (np.arange(count)[:, None, None] * len(points) + faces).reshape(-1, 3)
        corner = np.repeat(np.tile(_GREY, (count, 1)) if colours is None else colours, 3 * len(faces), axis=0)
        self.object = painted_object("markers", np.tile(points, (count, 1)), every, corner, 0.4)
        collection.objects.link(self.object)

    def place(self, points: np.ndarray) -> None:
        """Move the balls to (count, 3) positions in world metres. Balls at NaN are hidden."""
        shown = np.isfinite(points).all(axis=1)
        middle = np.where(shown[:, None], points, 0.0)
        size = np.where(shown, 1.0, 0.0)[:, None, None]
        move_vertices(self.object, middle[:, None] + size * self._ball)


def ball(radius_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3) and triangles (T, 3) of a sphere around the origin."""
    polar = np.pi * np.arange(1, _RINGS) / _RINGS
    around = 2 * np.pi * np.arange(_SEGMENTS) / _SEGMENTS
    ring = [[np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)] for p in polar for a in around]
    points = radius_m * np.array([[0, 0, 1.0], *ring, [0, 0, -1.0]])
    faces, last = [], len(points) - 1
    for k in range(_SEGMENTS):
        n = (k + 1) % _SEGMENTS
        faces.append((0, 1 + k, 1 + n))
        for r in range(_RINGS - 2):
            a, b = 1 + r * _SEGMENTS, 1 + (r + 1) * _SEGMENTS
            faces += [(a + k, b + k, b + n), (a + k, b + n, a + n)]
        bottom = 1 + (_RINGS - 2) * _SEGMENTS
        faces.append((bottom + k, last, bottom + n))
    return points, np.array(faces)
