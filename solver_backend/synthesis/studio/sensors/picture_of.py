"""What one camera sees in one frame: surface, label, depth and normal of every pixel, and the sensors' pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.synthesis.studio.scene.costume import FURNITURE, MARKER, ROOM
from solver_backend.synthesis.studio.scene.marker_spheres import Spheres, see_spheres
from solver_backend.synthesis.studio.scene.room import pixel_rays
from solver_backend.synthesis.studio.scene.z_buffer import ZBuffer, in_camera, rasterise
from solver_backend.synthesis.studio.stage import Stage


@dataclass(frozen=True)
class Backdrop:
    """What a camera sees while nobody is there; the same in every frame."""

    depth: np.ndarray
    """(h, w) float32 metres."""
    label: np.ndarray
    """(h, w) uint8."""
    normal: np.ndarray
    """(h, w, 3) float32, world."""
    cosine: np.ndarray
    """(h, w) float32 between normal and sight line."""
    towards: np.ndarray
    """(h, w, 3) float32 unit vectors from the surfaces to the camera, world."""


@dataclass(frozen=True)
class Seen:
    """What a camera sees in a frame."""

    depth: np.ndarray
    """(h, w) float32 metres along the axis, inf where nothing is; the person's and the room's, without markers."""
    label: np.ndarray
    """(h, w) uint8 index into the labels, with markers."""
    cosine: np.ndarray
    """(h, w) float32."""
    normal: np.ndarray | None
    """(h, w, 3) float32 unit normals of the world, None where nobody asked."""
    spheres: Spheres
    """The markers."""
    person: ZBuffer
    """The person alone."""


def backdrop(stage: Stage, view: int) -> Backdrop:
    """Return a camera's picture of room and furniture."""
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
        across = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
        unit = across / np.linalg.norm(across, axis=1, keepdims=True)
        depth, label, normal = depth.copy(), label.copy(), normal.copy()
        depth[nearer], label[nearer], normal[nearer] = pieces.depth[nearer], FURNITURE, unit[face]
    towards = (-ray / np.linalg.norm(ray, axis=-1, keepdims=True)).astype(np.float32)
    cosine = np.abs((normal * towards).sum(axis=-1)).astype(np.float32)
    return Backdrop(depth, label, normal.astype(np.float32), cosine, towards)


def look(stage: Stage, view: int, behind: Backdrop, surface: np.ndarray, frame: int, *, normals: bool = False) -> Seen:
    """Return what a camera sees of a dressed person before its backdrop.

    Args:
        stage: the shot.
        view: which camera.
        behind: its backdrop.
        surface: (N, 3) the person's vertices in this frame.
        frame: which frame, for the markers.
        normals: also return the normals.
    """
    cameras, costume = stage.cameras, stage.costume
    width, height = cameras.image_size[view].tolist()
    camera, px = in_camera(cameras, view, surface)
    person = rasterise(px, camera[:, 2], costume.faces, (width, height))
    there = np.flatnonzero((person.depth < behind.depth).ravel())
    face = person.face.reshape(-1)[there]
    depth, label, cosine = behind.depth.copy(), behind.label.copy(), behind.cosine.copy()
    used, which = np.unique(face, return_inverse=True)
    a, b, c = (surface[costume.faces[used, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    unit = (across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)).astype(np.float32)[which]
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
    return Seen(depth, label, cosine, normal, spheres, person)
