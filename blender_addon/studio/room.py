"""Build a shot's room in Blender, in random colours that depend on the shot's seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np

from ..conventions.datablocks import shader_of
from .dressed_person import linear, painted_object
from .scene_file import SceneFile

Paint = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Function that returns linear RGB colours (n, 3) of squares at (n,) columns and rows."""
_TILE_M = 0.12  # Approximate size of the coloured squares on floor and walls, in metres.
_MOST_TILES = 90  # Largest number of squares along a side. It limits the size of the mesh. Chosen by hand.
_BOX = np.array([list(map(int, face)) for face in ["0231", "4576", "0154", "2673", "0462", "1375"]])
"""Corner indices of the faces of a box."""
_ROOM = {
    "floor": (0, (1, 0, 0), (0, 1, 0)),
    "south": (0, (0, 0, 1), (1, 0, 0)),
    "west": (0, (0, 1, 0), (0, 0, 1)),
    "north": (1, (0, 0, -1), (-1, 0, 0)),
    "east": (1, (0, -1, 0), (0, 0, -1)),
    "ceiling": (1, (-1, 0, 0), (0, -1, 0)),
}
"""Corner (0 is the lower, 1 is the upper) and two axes of each plane of the room."""


def build_room(scene: SceneFile, collection: bpy.types.Collection, rng: np.random.Generator) -> None:
    """Add floor, walls, ceiling and furniture to a collection."""
    low, high = scene.room
    floor, wall = _floor_paint(rng), _wall_paint(rng)
    for name, (corner, *axes) in _ROOM.items():
        if name == "floor" or scene.walls:
            paint = floor if name == "floor" else wall
            u, v = np.array(axes, float)
            collection.objects.link(_make_plane(name, scene.room[corner], u, v, high - low, paint))
    for i, (middle, half, (angle, _, _), colour) in enumerate(scene.furniture):
        collection.objects.link(_make_box(f"furniture {i}", middle, half, angle, colour))


def light_room(
    scene: SceneFile, target: bpy.types.Scene, collection: bpy.types.Collection, rng: np.random.Generator
) -> None:
    """Add lamps below the ceiling, and a dim world that Cycles and EEVEE use."""
    low, high = scene.room
    area = float((high - low)[0] * (high - low)[1])
    warmth = rng.uniform(-0.15, 0.15)
    for _ in range(int(rng.integers(2, 5))):
        data = bpy.data.lights.new("lamp", "AREA")
        data.energy = float(rng.uniform(4.0, 9.0) * area / 3.5)
        data.size = float(rng.uniform(0.5, 1.6))
        data.color = (1.0, float(1 - 0.3 * max(warmth, 0)), float(1 - max(warmth, 0)))
        lamp = bpy.data.objects.new("lamp", data)
        place = low + (high - low) * [*rng.uniform(0.2, 0.8, 2), 0.0]
        lamp.location = (float(place[0]), float(place[1]), float(high[2] - 0.06))
        collection.objects.link(lamp)
    world = bpy.data.worlds.new("studio")
    background = shader_of(world, "Background")
    background.inputs["Color"].default_value = (0.8, 0.85, 1.0, 1.0)
    background.inputs["Strength"].default_value = float(rng.uniform(0.3, 0.6)) if scene.walls else 0.9
    target.world = world


def _floor_paint(rng: np.random.Generator):
    base = linear(rng.uniform(0.05, 0.12), rng.uniform(0.1, 0.5), rng.uniform(0.45, 0.8))
    kind = int(rng.integers(3))
    jitter = rng.uniform(0.05, 0.25)

    def paint(i: np.ndarray, j: np.ndarray) -> np.ndarray:
        shade = np.sin(12.9898 * i + 78.233 * (j // 6 if kind == 0 else j)) * 43758.5453
        shade = 1 + jitter * (shade - np.floor(shade) - 0.5)
        if kind == 1:
            shade = shade * np.where(((i // 3 + j // 3) % 2).astype(bool), 1.15, 0.7)
        return base * shade[:, None]

    return paint


def _wall_paint(rng: np.random.Generator):
    base = linear(rng.random(), rng.uniform(0.0, 0.22), rng.uniform(0.75, 0.98))
    other = base * rng.uniform(0.6, 0.95)
    period, kind = int(rng.integers(3, 9)), int(rng.integers(3))

    def paint(i: np.ndarray, j: np.ndarray) -> np.ndarray:
        stripe = ((i if kind == 1 else j) // period) % 2 == 0
        return np.where(stripe[:, None] & (kind > 0), other, base)

    return paint


def _make_plane(
    name: str, start: np.ndarray, u: np.ndarray, v: np.ndarray, size: np.ndarray, paint: Paint
) -> bpy.types.Object:
    lengths = float(np.abs(u @ size)), float(np.abs(v @ size))
    counts = [int(np.clip(round(length / _TILE_M), 1, _MOST_TILES)) for length in lengths]
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(counts[0] + 1), np.arange(counts[1] + 1), indexing="ij"))
    points = start + np.outer(i / counts[0] * lengths[0], u) + np.outer(j / counts[1] * lengths[1], v)
    a, b = (grid.ravel() for grid in np.meshgrid(np.arange(counts[0]), np.arange(counts[1]), indexing="ij"))
    first = a * (counts[1] + 1) + b
    faces = np.stack([first, first + counts[1] + 1, first + counts[1] + 2, first + 1], axis=1)
    return _make_object(name, points, faces, np.repeat(paint(a, b), 4, axis=0))


def _make_box(name: str, middle: np.ndarray, half: np.ndarray, angle: float, colour: np.ndarray) -> bpy.types.Object:
    corner = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=np.float64)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return _make_object(name, (corner * half) @ turn.T + middle, _BOX, np.tile(colour**2.2, (24, 1)))


def _make_object(name: str, points: np.ndarray, faces: np.ndarray, colours: np.ndarray) -> bpy.types.Object:
    thing = painted_object(name, points, faces, np.clip(colours, 0, 1), 0.7, smooth=False)
    # The only light in Workbench is the sun, and the ceiling would block it.
    thing.display.show_shadows = name.startswith("furniture")
    return thing


@dataclass(frozen=True)
class Light:
    """Brightness, colour, shadows and sensor noise of a room's light."""

    stops: float  # Brightness relative to daylight, which the camera's exposure does not compensate.
    tint: tuple[float, float, float]  # Linear colour of the light.
    shadow: float  # Darkness of Workbench's shadows, 0 to 1.
    gain: float  # Sensor noise relative to daylight.

    def set_up(self, scene: bpy.types.Scene) -> None:
        """Apply the light's exposure and shadows to a scene."""
        scene.view_settings.exposure += self.stops
        scene.display.shading.shadow_intensity = self.shadow

    def tinted(self, picture: np.ndarray) -> np.ndarray:
        """Tint an (h, w, 3) picture (0 to 255, gamma 2.2) in the light's colour."""
        return picture * np.array(self.tint, np.float32) ** np.float32(1 / 2.2)


LIGHTS = {
    "day": Light(0.0, (1.0, 1.0, 1.0), 0.4, 1.0),
    "dim": Light(-1.2, (1.0, 0.8, 0.55), 0.6, 2.0),
    "night": Light(-2.4, (0.7, 0.85, 1.0), 0.8, 4.0),
}
"""Lights by name. Chosen by hand."""
