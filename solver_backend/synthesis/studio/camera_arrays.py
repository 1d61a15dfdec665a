"""Build camera arrays from descriptions: rings, corners, a capture's cameras, or given cameras."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import CalibrationMissing
from solver_backend.geometry.alignment import look_at
from solver_backend.synthesis.studio.checked_values import CheckedValues, StudioInvalid
from solver_backend.types import Cameras

_AHEAD_M = 3.0  # Distance (m) from the mean camera centre to the target if the axes do not meet. Chosen by hand.
_TRUST = 1e-3  # Weight of this target relative to one camera axis. Chosen by hand.


def aim_point(cameras: Cameras) -> np.ndarray:
    """Return the (3,) point in metres that is closest to the optical axes of all cameras.

    With centres c and unit axes d, it minimises ``sum |(I - d d^T) (p - c)|^2``. A small weight pulls it towards the
    point 3 m in front of the mean camera centre. This determines the result if the axes are parallel or there is only
    one camera.
    """
    axes, centres = cameras.R[:, 2], cameras.centres
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    ahead = centres.mean(axis=0) + _AHEAD_M * axes.mean(axis=0)
    weight = _TRUST * len(cameras)
    left = across.sum(axis=0) + weight * np.eye(3)
    return np.linalg.solve(left, np.einsum("cij,cj->i", across, centres) + weight * ahead)


def scaled(cameras: Cameras, by: float) -> Cameras:
    """Scale the images of cameras by a factor. Each side remains at least 16 pixels long."""
    if by == 1.0:
        return cameras
    size = np.maximum(16, np.round(by * cameras.image_size)).astype(cameras.image_size.dtype)
    ratio = size / cameras.image_size
    K = cameras.K.copy()
    K[:, :2] *= ratio[:, :, None]
    # Pixel (0, 0) is the centre of the first pixel, so the image edge is half a pixel before it.
    K[:, :2, 2] += 0.5 * ratio - 0.5
    return replace(cameras, K=K, image_size=size)


PRESETS = Path(__file__).parents[2] / "assets" / "studio_camera_arrays.json"
LAYOUTS = ("ring", "corners", "capture", "cameras")
STANDS = ("world", "aim")  # Place of the person in front of fixed cameras: as in the motion, or at their target.
_KNOWN = (
    *("name", "layout", "about", "count", "radius_m", "height_m", "height_step_m", "room_m", "target_m"),
    *("size", "fov_deg", "distortion", "capture", "cameras", "range_m", "turn_deg", "scale", "stand", "leave_out"),
    "widest",
)
_TARGET_M = (0.0, 0.0, 0.95)  # Target of the cameras in metres, near a standing person's pelvis.


@dataclass(frozen=True)
class CameraRing:
    """A named camera array that can be placed around a person."""

    name: str  # Part of a shot's name.
    cameras: Cameras  # Cameras around the origin, which moves to the centre of the person's path.
    range_m: tuple[float, float]  # Smallest and largest depth that the sensors measure, in metres.
    fixed: bool  # True if the cameras keep their positions in the world.
    stand: np.ndarray | None = None  # (2,) centre of the path for fixed cameras, metres. None keeps the motion's path.

    def around(self, place: np.ndarray) -> Cameras:
        """Move the cameras horizontally so that a person at (3,) ``place`` is in their centre."""
        if self.fixed:
            return self.cameras
        move = np.array([place[0], place[1], 0.0])
        return replace(self.cameras, t=self.cameras.t - np.einsum("cij,j->ci", self.cameras.R, move))


@cache
def camera_array_presets() -> dict[str, dict[str, Any]]:
    """Return the descriptions of the built-in camera arrays by name."""
    return json.loads(PRESETS.read_text(encoding="utf-8"))["presets"]


def build_camera_array(description: Any, folder: Path = Path()) -> CameraRing:
    """Build a camera array from its description, which is a preset's name or an object.

    Raises:
        StudioInvalid: a key or preset is unknown, or a value is invalid.
        MocapError: a capture cannot be read, or contains no cameras.
    """
    values = CheckedValues.described(description, "camera array", _KNOWN, camera_array_presets())
    layout = values.choice("layout", "ring", LAYOUTS)
    name = values.text("name", layout)
    low, high = values.numbers("range_m", 2).tolist() if "range_m" in values else (0.3, 10.0)
    if not 0 <= low < high:
        message = "range_m must be a nearest depth and a larger farthest depth."
        raise StudioInvalid(message, where=f"camera array {name}")
    cameras = _LAYOUTS[layout](values, folder)
    fixed = layout in ("capture", "cameras")
    if fixed:
        cameras = scaled(cameras, values.number("scale", 1.0, 0.05, 4.0))
    fewer = len(cameras) - values.whole("leave_out", 0, 0, 64)
    if fewer < 1:
        message = f"leave_out leaves none of {len(cameras)} cameras."
        raise StudioInvalid(message, where=f"camera array {name}: leave_out")
    cameras = cameras.subset(list(range(fewer)))
    widest = int(cameras.image_size[:, 0].max())
    cameras = scaled(cameras, min(1.0, values.whole("widest", widest, 16, 8192) / widest))
    aimed = values.choice("stand", "world", STANDS) == "aim"
    return CameraRing(name, cameras, (low, high), fixed, aim_point(cameras)[:2] if fixed and aimed else None)


def _ring(values: CheckedValues, folder: Path) -> Cameras:
    count = values.whole("count", 4, 1, 64)
    radius, height = values.number("radius_m", 3.0, 0.2, 50.0), values.number("height_m", 1.4, 0.0, 20.0)
    angle = np.deg2rad(values.number("turn_deg", 35.0, -360.0, 360.0)) + 2 * np.pi * np.arange(count) / count
    up = height + values.number("height_step_m", 0.0, -5.0, 5.0) * (np.arange(count) % 2)
    centres = np.stack([radius * np.cos(angle), radius * np.sin(angle), up], axis=1)
    return _aimed(values, centres)


def _corners(values: CheckedValues, folder: Path) -> Cameras:
    x, y = (values.numbers("room_m", 2) if "room_m" in values else np.array([5.0, 5.0])).tolist()
    if min(x, y) <= 0:
        raise StudioInvalid("room_m must be two positive lengths.", where=values.where)
    height = values.number("height_m", 2.3, 0.0, 20.0)
    centres = [[sx * x / 2, sy * y / 2, height] for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    return _aimed(values, np.array(centres)[: values.whole("count", 4, 1, 4)])


def _aimed(values: CheckedValues, centres: np.ndarray) -> Cameras:
    """Return identical cameras at (C, 3) centres that all point at one target."""
    target = values.numbers("target_m", 3) if "target_m" in values else np.array(_TARGET_M)
    scale = values.number("scale", 1.0, 0.05, 4.0)
    width, height = (max(16, round(scale * side)) for side in values.size("size", (640, 480)))
    fov = np.deg2rad(values.number("fov_deg", 65.0, 5.0, 150.0))
    given, distortion = values.raw("distortion", []), np.zeros(8)
    if given != []:
        count = min(len(given), 8) if isinstance(given, list) else 8
        distortion[:count] = values.numbers("distortion", count)
    focal, count = width / 2 / np.tan(fov / 2), len(centres)
    K = np.array([[focal, 0.0, (width - 1) / 2], [0.0, focal, (height - 1) / 2], [0.0, 0.0, 1.0]])
    if (np.linalg.norm(target - centres, axis=1) < 0.05).any():
        raise StudioInvalid("A camera is at the point that it looks at. Move one of them.", where=values.where)
    R = look_at(centres, target)
    names = tuple(f"cam{i + 1:02d}" for i in range(count))
    t, size = -np.einsum("cij,cj->ci", R, centres), np.tile([width, height], (count, 1))
    return Cameras(names, np.tile(K, (count, 1, 1)), np.tile(distortion, (count, 1)), R, t, size)


def _of_capture(values: CheckedValues, folder: Path) -> Cameras:
    from solver_backend.io.load import load_capture

    path = folder / values.text("capture", "")
    cameras = load_capture(path).cameras
    if cameras is None:
        message, hint = "The capture has no cameras to film with.", "Choose a capture with several cameras."
        raise CalibrationMissing(message, where=str(path), hint=hint)
    return cameras


def _written_out(values: CheckedValues, folder: Path) -> Cameras:
    given = values.raw("cameras")
    if not isinstance(given, list) or not given:
        raise StudioInvalid("cameras must be a list of at least one camera.", where=values.where)
    names, rows = [], []
    for i, entry in enumerate(given):
        camera = CheckedValues(entry, f"camera {i + 1}", ("name", "K", "R", "t", "image_size", "distortion"))
        try:
            K, R, t = (np.ravel(np.asarray(camera.raw(key, ()), dtype=np.float64)) for key in ("K", "R", "t"))
            coefficients = np.ravel(np.asarray(camera.raw("distortion", []), dtype=np.float64))[:8]
        except (TypeError, ValueError, OverflowError) as error:
            message = f"A camera contains something that is not a number ({error})."
            raise StudioInvalid(message, where=camera.where) from error
        if [K.size, R.size, t.size] != [9, 9, 3]:
            raise StudioInvalid("A camera needs K (3 x 3), R (3 x 3) and t (3).", where=camera.where)
        lens = np.zeros(8)
        lens[: len(coefficients)] = coefficients
        rows.append((K.reshape(3, 3), lens, R.reshape(3, 3), t, camera.size("image_size", (0, 0))))
        names.append(camera.text("name", f"cam{i + 1:02d}"))
    K, lenses, R, t, sizes = (np.array(column) for column in zip(*rows, strict=True))
    return Cameras(tuple(names), K, lenses, R, t, sizes)


_LAYOUTS = {"ring": _ring, "corners": _corners, "capture": _of_capture, "cameras": _written_out}
