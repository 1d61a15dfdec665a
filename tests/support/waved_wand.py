"""A wand waved before sensors that stand in a ring: what each of them sees, on its own clock, with a known truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import lens_of
from solver_backend.cameras.projection import project
from solver_backend.geometry.rotations import exp_so3
from solver_backend.sensors.wand.views import Wand, WandView
from solver_backend.synthesis.studio.sensor_pictures import TimeOfFlightModel
from solver_backend.types import Cameras

SIZE = (640, 576)  # Pixels of an Azure Kinect's narrow view, not binned.
RING_PIXELS = 12  # Depths that a marker's ring gives.


def sensors(count: int = 3, radius_m: float = 2.0) -> Cameras:
    """Return depth sensors around the origin at 1.2 m that look at a point 0.7 m above it."""
    angle = 2 * np.pi * np.arange(count) / count + 0.3
    centre = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), np.full(count, 1.2)], axis=1)
    forward = np.array([0.0, 0.0, 0.7]) - centre
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    R = np.stack([right, np.cross(forward, right), forward], axis=1)
    K = np.tile([[504.0, 0, 322.0], [0, 504.5, 285.0], [0, 0, 1]], (count, 1, 1))
    bent = np.tile([0.05, -0.04, 0.0004, -0.0003, 0, 0, 0, 0], (count, 1))
    names = tuple(f"sensor{c + 1}" for c in range(count))
    return Cameras(names, K, bent, R, -(R @ centre[..., None])[..., 0], np.tile(SIZE, (count, 1)))


@dataclass(frozen=True)
class Waving:
    """How the wand moves and how sensors err."""

    seconds: float = 20.0
    fps: float = 30.0
    sigma_px: float = 0.12
    """Of a centroid."""
    depth_bias_m: tuple[float, ...] = (0.002, -0.001, -0.002)
    """How much each sensor measures too far, in turn."""
    late_s: tuple[float, ...] = ()
    """How much later each sensor's clock shows what happens, in turn."""
    hidden: float = 0.1
    """Share of the sightings that are lost."""
    seed: int = 0


def middle_at(times_s: np.ndarray, seed: int) -> np.ndarray:
    """Return (F, 3) metres, a path that fills the middle of the volume, up to 3 m/s fast."""
    rng = np.random.default_rng(seed)
    slow, fast = rng.uniform(1.0, 2.2, 3), rng.uniform(3.0, 5.0, 3)
    phase = rng.uniform(0, 2 * np.pi, (2, 3))
    swing = 0.75 * np.sin(slow * times_s[:, None] + phase[0]) + 0.25 * np.sin(fast * times_s[:, None] + phase[1])
    return np.array([0.0, 0.0, 1.0]) + np.array([0.6, 0.6, 0.5]) * swing


def turn_at(times_s: np.ndarray, seed: int) -> np.ndarray:
    """Return (F, 3, 3) how the wand is turned."""
    rng = np.random.default_rng(seed + 1)
    speed, phase = rng.uniform(0.8, 2.0, 3), rng.uniform(0, 2 * np.pi, 3)
    return exp_so3(np.sin(speed * times_s[:, None] + phase) * np.array([0.6, 1.2, 1.5]))


def waved(cameras: Cameras, waving: Waving = Waving(), wand: Wand | None = None) -> list[WandView]:
    """Return what each sensor sees: a marker and its depth, or the lights of a wand in shuffled order."""
    rng = np.random.default_rng(waving.seed + 7)
    late = np.resize(waving.late_s or (0.0,), len(cameras))
    bias = np.resize(waving.depth_bias_m, len(cameras))
    return [_view(cameras.subset([c]), waving, wand, float(late[c]), float(bias[c]), rng) for c in range(len(cameras))]


def _view(
    camera: Cameras, waving: Waving, wand: Wand | None, late_s: float, bias_m: float, rng: np.random.Generator
) -> WandView:
    times = np.arange(int(waving.seconds * waving.fps)) / waving.fps
    lights = np.zeros((1, 3)) if wand is None else wand.lights
    world = middle_at(times - late_s, waving.seed)[:, None] + lights @ np.swapaxes(
        turn_at(times - late_s, waving.seed), 1, 2
    )
    px = project(camera, world)[0]
    px = px + rng.normal(0, waving.sigma_px, px.shape)
    inside = ((px > 0) & (px < np.array(SIZE) - 1)).all((1, 2)) & (rng.random(len(times)) > waving.hidden)
    px = np.where(inside[:, None, None], px, np.nan)
    if wand is not None:
        return WandView(camera.names[0], lens_of(camera, 0), times, px[:, [2, 0, 1]])
    z = (world @ camera.R[0].T + camera.t[0])[..., 2]
    model = TimeOfFlightModel()
    sigma = model.ring_noise * model.sigma_m(z) / np.sqrt(RING_PIXELS)
    depth = np.where(inside[:, None], z + bias_m + rng.normal(0, 1, z.shape) * sigma, np.nan)
    return WandView(camera.names[0], lens_of(camera, 0), times, px, depth)


def pose_errors(found: Cameras, truth: Cameras) -> tuple[np.ndarray, np.ndarray]:
    """Return (C,) millimetres and degrees by which sensors are off, both seen from the first one."""
    relative = []
    for cameras in (found, truth):
        R = cameras.R @ cameras.R[0].T
        relative.append((R, (cameras.centres - cameras.centres[0]) @ cameras.R[0].T))
    (R1, x1), (R2, x2) = relative
    cosine = (np.einsum("cij,cij->c", R1, R2) - 1.0) / 2.0
    return 1e3 * np.linalg.norm(x1 - x2, axis=1), np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def as_tables(views: Sequence[WandView]) -> dict[str, str]:
    """Return the tables of ``read_points_folder`` by file name."""
    tables = {}
    for view in views:
        rows = ["t_ns;u;v;depth_mm"] if view.depth_m is not None else []
        for f in range(len(view)):
            px = np.where(np.isfinite(view.px[f]), view.px[f], -1.0).ravel().tolist()
            more = [] if view.depth_m is None else (1e3 * np.nan_to_num(view.depth_m[f])).tolist()
            rows.append(";".join([str(round(1e9 * view.times_s[f])), *(f"{v:.4f}" for v in px + more)]))
        tables[f"{view.name}.csv"] = "\n".join(rows) + "\n"
    return tables
