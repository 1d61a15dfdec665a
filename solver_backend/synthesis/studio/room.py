"""Create a room around the cameras and the person, with furniture that blocks some lines of sight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.lens import normalised, undistort
from solver_backend.types import Cameras

_MARGIN_M = 0.8  # Distance in metres from people and cameras to the walls.
_CLEAR_OF_PERSON_M, _CLEAR_OF_CAMERA_M = 0.55, 0.6
_TRIES = 60  # Number of positions tried for furniture.
_PARTS = 10  # Number of squares along each edge of a box. They are small enough to follow lens distortion.


@dataclass(frozen=True)
class Room:
    """A room around people and cameras, with boxes as furniture."""

    low: np.ndarray  # (3,) lower corner in metres. Its z is the floor.
    high: np.ndarray  # (3,) upper corner in metres.
    walls: bool  # True if there are walls and a ceiling.
    furniture: np.ndarray  # (N, 4, 3) centre, half sizes, (heading, 0, 0) and colour (0..1) of each piece.

    def furniture_mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the (V, 3) vertices and (T, 3) triangles of all furniture."""
        if not len(self.furniture):
            return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
        corner, box = unit_box(_PARTS)
        vertices = []
        for middle, half, heading, _ in self.furniture:
            vertices.append((corner * half) @ _turn(heading[0]).T + middle)
        faces = [box + len(corner) * i for i in range(len(vertices))]
        return np.concatenate(vertices), np.concatenate(faces)

    def hides(self, centres: np.ndarray, lines: np.ndarray) -> np.ndarray:
        """Return an (F, C, K) mask of the sight lines that furniture blocks (Kay and Kajiya 1986).

        ``centres`` (C, 3) are camera positions. ``lines`` (F, C, K, 3) are vectors from the cameras to the points.
        """
        hidden = np.zeros(lines.shape[:3], dtype=bool)
        for middle, half, heading, _ in self.furniture:
            turn = _turn(heading[0])
            start = ((centres - middle) @ turn).astype(np.float32)[:, None]
            way = lines @ turn.astype(np.float32)
            with np.errstate(divide="ignore", invalid="ignore"):
                one, other = (-half - start) / way, (half - start) / way
            near, far = np.fmin(one, other), np.fmax(one, other)
            first = np.maximum(np.maximum(near[..., 0], near[..., 1]), near[..., 2])
            last = np.minimum(np.minimum(far[..., 0], far[..., 1]), far[..., 2])
            hidden |= (first <= last) & (first < 1) & (last > 0)
        return hidden

    def seen_by(self, centre: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the (h, w) depth in metres and the normals of floor and walls, as seen from a camera.

        The rays (h, w, 3) start at the camera's (3,) centre and have length 1 along its optical axis. They start inside
        the room, so they end at the nearest plane in their direction. If they hit nothing, the depth is infinite.
        """
        planes = np.where(ray > 0, self.high, self.low)
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = (planes - centre) / ray
        if not self.walls:
            reach[..., :2] = np.inf
            reach[..., 2] = np.where(ray[..., 2] < 0, reach[..., 2], np.inf)
        reach = np.where(reach > 0, reach, np.inf)
        axis = reach.argmin(axis=-1)
        depth = np.take_along_axis(reach, axis[..., None], -1)[..., 0]
        normal = np.zeros((*depth.shape, 3))
        sign = -np.sign(np.take_along_axis(ray, axis[..., None], -1))
        np.put_along_axis(normal, axis[..., None], sign, -1)
        return depth.astype(np.float32), normal.astype(np.float32)


def _turn(angle: float) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])


def pixel_rays(cameras: Cameras, view: int) -> np.ndarray:
    """Return the (h, w, 3) viewing directions of the pixel centres in the camera's frame, with z = 1."""
    width, height = cameras.image_size[view].tolist()
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    bent = normalised(np.stack([u, v], axis=-1), cameras.K[view])
    straight = undistort(bent, cameras.distortion[view], cameras.models[view])
    return np.concatenate([np.nan_to_num(straight, nan=10.0), np.ones((height, width, 1))], axis=-1)


def unit_box(parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the (V, 3) vertices, in -1..1, and the (T, 3) triangles of a box with subdivided sides."""
    steps = np.linspace(-1.0, 1.0, parts + 1)
    u, v = (grid.ravel() for grid in np.meshgrid(steps, steps))
    first = (np.arange(parts)[:, None] * (parts + 1) + np.arange(parts)).ravel()
    right, up, both = first + 1, first + parts + 1, first + parts + 2
    side = np.concatenate([np.stack([first, right, both], 1), np.stack([first, both, up], 1)])
    vertices, faces = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            points = np.zeros((len(u), 3))
            points[:, axis], points[:, (axis + 1) % 3], points[:, (axis + 2) % 3] = sign, u, v
            faces.append((side if sign > 0 else side[:, ::-1]) + len(u) * len(vertices))
            vertices.append(points)
    return np.concatenate(vertices), np.concatenate(faces)


def furnish(path: np.ndarray, cameras: Cameras, furniture: int, walls: bool, rng: np.random.Generator) -> Room:
    """Create a room around a person's path (F, 3), with up to ``furniture`` pieces in it."""
    points = np.concatenate([path, cameras.centres])
    low, high = points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M
    low[2], high[2] = 0.0, max(high[2], 2.6)
    pieces: list[np.ndarray] = []
    for _ in range(_TRIES):
        half = np.array([*rng.uniform(0.15, 0.35, 2), rng.uniform(0.2, 0.5)])
        away, angle = rng.uniform(0.7, 1.6), rng.uniform(0, 2 * np.pi)
        beside = path[rng.integers(len(path)), :2] + away * np.array([np.cos(angle), np.sin(angle)])
        middle = np.array([*beside, half[2]])
        reach = float(np.hypot(*half[:2]))
        to_path = np.linalg.norm(path[:, :2] - middle[:2], axis=1).min() - reach
        to_camera = np.linalg.norm(cameras.centres[:, :2] - middle[:2], axis=1).min() - reach
        apart = all(np.linalg.norm(middle[:2] - p[0, :2]) > reach + np.hypot(*p[1, :2]) for p in pieces)
        if len(pieces) < furniture and to_path > _CLEAR_OF_PERSON_M and to_camera > _CLEAR_OF_CAMERA_M and apart:
            pieces.append(np.stack([middle, half, [rng.uniform(0, np.pi), 0, 0], rng.uniform(0.15, 0.75, 3)]))
    return Room(low, high, walls, np.array(pieces).reshape(-1, 4, 3))
