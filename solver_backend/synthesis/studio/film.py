"""A shot filmed: infrared, depth, masks and normals of every camera and frame, handed on picture by picture."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from solver_backend.synthesis.studio.marker_sight import marker_sight
from solver_backend.synthesis.studio.sensors.infrared import InfraredModel, infrared, sphere_light
from solver_backend.synthesis.studio.sensors.picture_of import Backdrop, backdrop, look
from solver_backend.synthesis.studio.sensors.time_of_flight import TimeOfFlightModel, measure_depth
from solver_backend.synthesis.studio.spec import Spec
from solver_backend.synthesis.studio.stage import Stage
from solver_backend.synthesis.studio.writers.pictures import EXR

Keep = Callable[[str, int, int, np.ndarray], None]
"""Takes kind, view, frame and picture."""
_CHUNK = 16
"""Frames whose surfaces are held at a time."""


def film(spec: Spec, stage: Stage, keep: Keep, on_frame: Callable[[int], None] = lambda frame: None) -> np.ndarray:
    """Film a shot; return (C, F, M) the share of each marker that each camera sees, float32.

    Where nothing is filmed the shares are those of sight lines.

    Args:
        spec: what is filmed.
        stage: the shot.
        keep: takes every picture: 'infrared' and 'depth' (h, w) uint16, 'masks' (h, w) uint8, 'normals' (h, w, 3)
            uint8 in the camera's frame, 'exr' (h, w, 4) float32: the normal, and metres before any sensor.
        on_frame: called with each frame that is done.
    """
    kinds = [kind for kind in spec.film if kind != "rgb"] + ([EXR] if EXR in spec.write else [])
    cameras = stage.cameras
    markers = np.zeros((len(cameras), stage.num_frames, stage.markers.shape[1]), np.float32)
    coloured = "rgb" in spec.film and bool(stage.labels)
    if not kinds and not coloured:
        return marker_sight(stage)
    behind = [backdrop(stage, view) for view in range(len(cameras))]
    for start in range(0, stage.num_frames, _CHUNK):
        frames = np.arange(start, min(start + _CHUNK, stage.num_frames))
        surfaces = stage.surface(frames)
        for frame, surface in zip(frames.tolist(), surfaces, strict=True):
            for view in range(len(cameras)):
                markers[view, frame] = _shoot(spec, stage, behind[view], kinds, (view, frame), surface, keep)
            on_frame(frame + 1)
    return markers


def _shoot(
    spec: Spec, stage: Stage, behind: Backdrop, kinds: list[str], place: tuple[int, int], surface: np.ndarray,
    keep: Keep,
) -> np.ndarray:  # fmt: skip
    """Film one picture; return the shares of markers seen."""
    view, frame = place
    seen = look(stage, view, behind, surface, frame, normals="normals" in kinds or EXR in kinds)
    rng = stage.shot.rng(spec, f"pixels {view} {frame}")
    model = InfraredModel()
    if "infrared" in kinds or "depth" in kinds:
        light = sphere_light(seen.spheres, (len(seen.depth), seen.depth.shape[1]), model)
        if "infrared" in kinds:
            keep("infrared", view, frame, infrared(seen.depth, seen.cosine, seen.label, light, model, rng))
        if "depth" in kinds:
            sensor = TimeOfFlightModel(range_m=stage.shot.array.range_m)
            keep("depth", view, frame, measure_depth(seen.depth, seen.cosine, light, seen.spheres, sensor, rng))
    if "masks" in kinds:
        keep("masks", view, frame, seen.label)
    if seen.normal is not None:
        turned = seen.normal @ stage.cameras.R[view].T.astype(np.float32)
        if "normals" in kinds:
            keep("normals", view, frame, np.round(turned * 127.5 + 127.5).astype(np.uint8))
        if EXR in kinds:
            keep(EXR, view, frame, np.concatenate([turned, seen.depth[..., None]], axis=-1, dtype=np.float32))
    return seen.spheres.seen.astype(np.float32)
