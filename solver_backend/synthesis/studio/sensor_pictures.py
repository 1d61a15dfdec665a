"""Render the surface in each pixel of a camera, and simulate infrared and depth images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.mesh import face_normals
from solver_backend.synthesis.simulation.keypoint_detector import direction_seen_from
from solver_backend.synthesis.studio.costume import FURNITURE, LABELS, MARKER, ROOM
from solver_backend.synthesis.studio.room import pixel_rays
from solver_backend.synthesis.studio.stage import Stage
from solver_backend.synthesis.studio.z_buffer import RADIUS_M, Spheres, in_camera, rasterise, see_spheres
from solver_backend.types import SMPL_JOINTS


@dataclass(frozen=True)
class Backdrop:
    """A camera's view of room and furniture without the person. It is the same in all frames."""

    depth: np.ndarray  # (h, w) float32 depth in metres.
    label: np.ndarray  # (h, w) uint8 label.
    normal: np.ndarray  # (h, w, 3) float32 normal in world axes.
    cosine: np.ndarray  # (h, w) float32 cosine of the angle between normal and line of sight.
    towards: np.ndarray  # (h, w, 3) float32 unit vectors from the surface to the camera, in world axes.


@dataclass(frozen=True)
class Seen:
    """A camera's view of the person and the room in one frame."""

    depth: np.ndarray  # (h, w) float32 depth in metres of person or room, without markers. inf where nothing is hit.
    label: np.ndarray  # (h, w) uint8 label index, including markers.
    cosine: np.ndarray  # (h, w) float32 cosine of the angle between normal and line of sight.
    normal: np.ndarray | None  # (h, w, 3) float32 unit normals in world axes, or None if not requested.
    spheres: Spheres


def backdrop(stage: Stage, view: int) -> Backdrop:
    """Render the room and the furniture for one camera."""
    cameras = stage.cameras
    ray = pixel_rays(cameras, view) @ cameras.R[view]
    depth, normal = stage.room.seen_by(cameras.centres[view], ray)
    label = np.where(np.isfinite(depth), ROOM, 0).astype(np.uint8)
    vertices, faces = stage.room.furniture_mesh()
    if len(faces):
        camera, px = in_camera(cameras, view, vertices)
        width, height = cameras.image_size[view].tolist()
        pieces = rasterise(px, camera[:, 2], faces, (width, height))
        nearer = pieces.depth < depth
        face = pieces.face[nearer]
        depth[nearer], label[nearer], normal[nearer] = pieces.depth[nearer], FURNITURE, _units(vertices, faces)[face]
    towards = (-ray / np.linalg.norm(ray, axis=-1, keepdims=True)).astype(np.float32)
    cosine = np.abs((normal * towards).sum(axis=-1)).astype(np.float32)
    return Backdrop(depth, label, normal.astype(np.float32), cosine, towards)


def look(stage: Stage, view: int, behind: Backdrop, surface: np.ndarray, frame: int, *, normals: bool = False) -> Seen:
    """Render the dressed person, given as vertices (N, 3), in front of a camera's backdrop."""
    cameras, costume = stage.cameras, stage.costume
    width, height = cameras.image_size[view].tolist()
    camera, px = in_camera(cameras, view, surface)
    person = rasterise(px, camera[:, 2], costume.faces, (width, height))
    there = np.flatnonzero((person.depth < behind.depth).ravel())
    face = person.face.reshape(-1)[there]
    depth, label, cosine = behind.depth.copy(), behind.label.copy(), behind.cosine.copy()
    used, which = np.unique(face, return_inverse=True)
    unit = _units(surface, costume.faces[used]).astype(np.float32)[which]
    depth.reshape(-1)[there] = person.depth.reshape(-1)[there]
    label.reshape(-1)[there] = costume.label[face]
    towards = behind.towards.reshape(-1, 3)[there]
    cosine.reshape(-1)[there] = np.abs((unit * towards).sum(axis=1))
    normal = None
    if normals:
        normal = behind.normal.copy()
        normal.reshape(-1, 3)[there] = unit
    spheres = see_spheres(cameras, view, stage.markers[frame], depth)
    label.reshape(-1)[spheres.pixel[spheres.cover >= 0.5]] = MARKER
    return Seen(depth, label, cosine, normal, spheres)


def _units(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the (T, 3) unit normals of triangles."""
    across = face_normals(vertices, faces)
    return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)


FULL = 65535  # Saturation value of the sensor.
_ALBEDO = np.array([0.0, 0.55, 0.45, 0.4, 0.25, 0.2, 0.3, 0.9, 0.5, 0.6], np.float32)  # Infrared albedo of each label.
_KERNEL_PX = 2  # Radius of the lens blur in pixels. Chosen by hand.


@dataclass(frozen=True)
class InfraredModel:
    """Surface brightness and noise of an infrared sensor, chosen to resemble figure 5.5 of the thesis."""

    flood: float = 9000.0  # Counts from a white surface that faces the camera at a distance of 1 m.
    retro: float = 6.0  # Counts from a retro-reflector at 2 m, relative to ``FULL``.
    least_retro: float = 1.3  # Smallest value of this ratio, because the exposure depends on the size of the room.
    blur_px: float = 0.65  # Standard deviation of the lens blur around retro-reflections.
    shot_noise: float = 2.0  # Standard deviation at one count. It grows with the square root of the counts.
    read_noise: float = 12.0  # Standard deviation of the counts in the dark.


def sphere_light(spheres: Spheres, shape: tuple[int, int], model: InfraredModel) -> np.ndarray:
    """Return the (h, w) float32 image of the retro-reflective markers in sensor counts, before saturation."""
    height, width = shape
    light = np.zeros(height * width, np.float32)
    if not len(spheres.pixel):
        return light.reshape(shape)
    bright = FULL * np.maximum(model.retro * (2.0 / np.maximum(spheres.depth, 0.3)) ** 2, model.least_retro)
    counts = bright[spheres.owner] * spheres.cover
    steps = np.arange(-_KERNEL_PX, _KERNEL_PX + 1)
    weights = np.exp(-0.5 * (steps / model.blur_px) ** 2)
    weights /= weights.sum()
    row, column = np.divmod(spheres.pixel, width)
    for dy, wy in zip(steps.tolist(), weights.tolist(), strict=True):
        for dx, wx in zip(steps.tolist(), weights.tolist(), strict=True):
            y, x = row + dy, column + dx
            inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
            np.add.at(light, (y * width + x)[inside], (wx * wy * counts)[inside].astype(np.float32))
    return light.reshape(shape)


def infrared(seen: Seen, retro: np.ndarray, model: InfraredModel, rng: np.random.Generator) -> np.ndarray:
    """Simulate the (h, w) uint16 infrared image, with ``retro`` light from ``sphere_light``."""
    assert len(_ALBEDO) == len(LABELS)
    surface = np.float32(model.flood) * _ALBEDO[seen.label] * np.maximum(seen.cosine, np.float32(0.05)) / seen.depth**2
    counts = np.minimum(surface + retro, np.float32(2 * FULL))
    sigma = np.float32(model.shot_noise) * np.sqrt(counts) + np.float32(model.read_noise)
    counts += sigma * rng.standard_normal(counts.shape, np.float32)
    return np.clip(counts, 0, FULL).astype(np.uint16)


@dataclass(frozen=True)
class TimeOfFlightModel:
    """Errors of a time-of-flight depth sensor, measured for Azure Kinects (Tölgyessy et al. 2021)."""

    constant_mm: float = 0.8  # Standard deviation at distance 0.
    quadratic_mm: float = 0.55  # Additional standard deviation at 1 m. It grows with the square of the distance.
    grazing: float = 0.25  # Growth of the noise with the tangent of the angle of incidence.
    edge_m: float = 0.06  # Depth difference between neighbouring pixels that makes an edge.
    flying: float = 0.5  # Fraction of edge pixels with a depth between both surfaces.
    lost: float = 0.25  # Fraction of edge pixels that have no depth.
    range_m: tuple[float, float] = (0.5, 3.86)  # Smallest and largest depth in metres.
    ring_noise: float = 1.5  # Noise factor in the ring of pixels around a marker.
    surface_radii: float = 2.0 / 3.0  # Mean distance from a sphere's centre to the surface that reflects, in radii.

    def sigma_m(self, depth: np.ndarray) -> np.ndarray:
        """Return the standard deviation of depths (m) in metres, for surfaces that face the sensor."""
        return 1e-3 * (self.constant_mm + self.quadratic_mm * depth**2)


def measure_depth(seen: Seen, retro: np.ndarray, model: TimeOfFlightModel, rng: np.random.Generator) -> np.ndarray:
    """Simulate the (h, w) uint16 depth image in millimetres along the optical axis, 0 where missing."""
    low, high = model.range_m
    true = np.minimum(seen.depth, np.float32(100.0))
    blind = retro >= FULL
    ring = np.zeros_like(blind)
    if blind.any():
        true, ring = _with_rings(true, blind, seen.spheres, model.surface_radii * RADIUS_M)
    slope = np.clip(1.0 / np.maximum(seen.cosine, np.float32(0.1)), 1.0, 6.0) - 1.0
    factor = np.where(ring, np.float32(model.ring_noise), 1.0 + np.float32(model.grazing) * slope)
    sigma = np.float32(1e-3) * (np.float32(model.constant_mm) + np.float32(model.quadratic_mm) * true**2)
    found = true + (sigma * factor).astype(np.float32) * rng.standard_normal(true.shape, np.float32)
    # There are few edge pixels, so random numbers are only drawn for these.
    near, far = _neighbours(true)
    edge = np.flatnonzero(((far - near > np.float32(model.edge_m)) & ~ring).ravel())
    draw, mix = rng.random(len(edge), np.float32), rng.random(len(edge), np.float32)
    flat, near, far = found.reshape(-1), near.reshape(-1)[edge], np.minimum(far.reshape(-1)[edge], np.float32(high))
    between = near + mix * np.maximum(far - near, 0.0)
    flat[edge] = np.where(draw < model.flying, between, np.where(draw < model.flying + model.lost, 0.0, flat[edge]))
    found[blind | (found < low) | (found > high)] = 0.0
    return np.round(found * np.float32(1000.0)).astype(np.uint16)


def _with_rings(
    depth: np.ndarray, blind: np.ndarray, spheres: Spheres, before_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Add rings around the blind patches of a depth image. Also return the (h, w) mask of the rings.

    A ring is two pixels wide and has the depth of the nearest marker. The marker reflects light at a point
    ``before_m`` in front of its centre.
    """
    height, width = depth.shape
    owner = np.full(height * width, np.inf, np.float32)
    np.minimum.at(owner, spheres.pixel, (spheres.depth[spheres.owner] - before_m).astype(np.float32))
    around = owner.reshape(height, width)
    grown = blind
    for step in range(3):
        around = np.minimum(around, _lowest_around(around))
        if step < 2:
            grown = ~(_lowest_around((~grown).astype(np.float32)) > 0) | grown
    ring = grown & ~blind & np.isfinite(around) & (around < depth + 0.1)
    return np.where(ring, around, depth), ring


def _lowest_around(values: np.ndarray) -> np.ndarray:
    padded = np.pad(values, 1, mode="edge")
    rows = np.minimum(np.minimum(padded[:-2], padded[1:-1]), padded[2:])
    return np.minimum(np.minimum(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:])


def _neighbours(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest depth among each pixel and its four neighbours."""
    padded = np.pad(depth, 1, mode="edge")
    four = (padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:])
    return np.minimum.reduce([depth, *four]), np.maximum.reduce([depth, *four])


SECTOR_DEG = 30  # Width in degrees of the bins of joint angles, from 0 to 180 degrees.
_AT = {name: i for i, name in enumerate(SMPL_JOINTS)}
_TRUNK = ("neck", "pelvis")
_LIMBS: dict[str, tuple[tuple[str, str], tuple[str, str]]] = {
    "elbow bent": (("shoulder", "elbow"), ("elbow", "wrist")),
    "knee bent": (("hip", "knee"), ("knee", "ankle")),
    "thigh before trunk": (_TRUNK, ("hip", "knee")),
    "arm off trunk": (_TRUNK, ("shoulder", "elbow")),
}
"""Joint angles in the data card, as angles between two lines from joint to joint. Both sides are counted together."""


def views_of(stage: Stage) -> list[int]:
    """Count how often cameras see the person from each of eight directions, starting with the front."""
    angle = direction_seen_from(stage.cameras, stage.person.orient, stage.joints[:, 0]) % (2 * np.pi)
    eighth = np.round(angle / (np.pi / 4)).astype(int) % 8
    return np.bincount(eighth.ravel(), minlength=8).tolist()


def poses_of(joints: np.ndarray) -> dict[str, list[int]]:
    """Return a histogram of each limb angle over (F, 24, 3) joints, by name. The bins are ``SECTOR_DEG`` wide."""
    upright = np.broadcast_to([0.0, 0.0, 1.0], joints[:, 0].shape)
    found = {"trunk off upright": _counted(_angle(_line(joints, "pelvis", "neck", ""), upright))}
    for name, (one, other) in _LIMBS.items():
        sides = [_angle(_line(joints, *one, side), _line(joints, *other, side)) for side in ("left_", "right_")]
        found[name] = _counted(np.concatenate(sides))
    return found


def _line(joints: np.ndarray, start: str, end: str, side: str) -> np.ndarray:
    first, last = (_AT[name if name in _AT else f"{side}{name}"] for name in (start, end))
    return joints[:, last] - joints[:, first]


def _angle(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the (F,) angles in degrees between two (F, 3) lines."""
    return np.rad2deg(np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), (one * other).sum(axis=1)))


def _counted(degrees: np.ndarray) -> list[int]:
    sectors = 180 // SECTOR_DEG
    return np.bincount(np.minimum(degrees // SECTOR_DEG, sectors - 1).astype(int), minlength=sectors).tolist()
