"""Store cameras as a calibration file states them, correct them, and convert them to ``Cameras``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.lens import DEFAULT_MODEL, LENS_MODELS
from solver_backend.exchange.plausible import FARTHEST_IN_UNITS, largest_finite
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Cameras

LARGEST_PICTURE = 1_000_000  # Largest width or height in pixels.
ROUNDING = 1e-3  # Largest deviation from a rotation matrix that is corrected as a rounding error.


@dataclass(frozen=True)
class CameraEntry:
    """A camera in OpenCV's convention, as a file states it: ``x_cam = R @ x_world + t``."""

    name: str
    K: np.ndarray
    """(3, 3) intrinsic matrix in pixels."""
    distortion: np.ndarray
    """(n,) distortion coefficients in OpenCV's order."""
    R: np.ndarray
    """(3, 3) rotation from world to camera."""
    t: np.ndarray
    """(3,) translation in the file's length unit."""
    image_size: tuple[int, int] | None = None
    """Width and height in pixels, or None if the file does not state them."""
    model: str = DEFAULT_MODEL
    """Name of the lens model that the coefficients belong to."""
    rotation_vector: np.ndarray | None = None
    """(3,) rotation vector if the file stores one."""

    def __post_init__(self) -> None:
        for name in ("K", "distortion", "R", "t"):  # an uncalibrated camera may contain NaN
            if (largest := largest_finite(getattr(self, name))) > FARTHEST_IN_UNITS:
                what = f"{name} contains {largest:.3g}, but at most {FARTHEST_IN_UNITS:g} is possible."
                raise CalibrationInvalid(what, where=f"camera {self.name}")


@dataclass(frozen=True)
class StatedCameras:
    """All cameras in a calibration file, in the file's length unit and axes."""

    entries: list[CameraEntry]  # Cameras in the file. Empty if the file has another format.
    unit: str = ""  # Length unit, or empty if the format does not define one.
    up_axis: str = ""  # Up axis of the file's world, or empty if the format does not define one.
    source: str = "default"  # Source of the unit and axis, for notes.
    problems: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True)
class Calibration:
    """Calibrated cameras in metres with Z up, and notes on how the calibration was interpreted."""

    cameras: Cameras
    source: Path
    """Calibration file or folder."""
    size_known: tuple[bool, ...] = ()
    """For each camera, True if the file states its image size."""
    guessed_unit: str = ""
    """Length unit if inferred from the distances between cameras, or '' if the file or the user states it."""
    notes: tuple[Diagnostic, ...] = ()
    rolls: tuple[int, ...] = ()
    """Clockwise quarter turns of each camera's images, or () if no image is rotated."""
    problems: tuple[Diagnostic, ...] = ()


def build_cameras(entries: Sequence[CameraEntry], *, where: str) -> Cameras:
    """Convert camera entries to ``Cameras``. A missing image size is derived from the principal point."""
    finished = [replace(e, R=_exact_rotation(e.R), distortion=_trimmed(e, where)) for e in entries]
    sizes = [_possible_size(e.image_size or _guessed_size(e.K), f"{where}, camera {e.name}") for e in finished]
    width = max(len(e.distortion) for e in finished)
    coefficients = np.stack([np.pad(e.distortion, (0, width - len(e.distortion))) for e in finished])
    return Cameras(
        names=tuple(e.name for e in finished),
        K=np.stack([e.K for e in finished]),
        distortion=coefficients,
        R=np.stack([e.R for e in finished]),
        t=np.stack([e.t for e in finished]),
        image_size=np.array(sizes),
        models=tuple(e.model for e in finished),
    )


def _is_rounded(R: np.ndarray) -> bool:
    """Return whether a matrix is orthonormal up to rounding. It may be mirrored."""
    return bool(np.isfinite(R).all() and np.abs(R @ R.T - np.eye(3)).max() <= ROUNDING)


def _exact_rotation(R: np.ndarray) -> np.ndarray:
    """Replace a rounded rotation matrix by the nearest exact one. Other matrices are returned unchanged."""
    if not _is_rounded(R):
        return R
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt


def _trimmed(entry: CameraEntry, where: str) -> np.ndarray:
    coefficients = np.asarray(entry.distortion, dtype=np.float64).reshape(-1)
    most = len(LENS_MODELS[entry.model].terms)
    if len(coefficients) > most and np.any(coefficients[most:]):
        hint = "Calibrate without thin-prism and tilt terms."
        what = f"The camera has {len(coefficients)} distortion coefficients, but {most} are supported."
        raise CalibrationInvalid(what, where=f"{where}, camera {entry.name}", hint=hint)
    return coefficients[:most]


def _possible_size(size: tuple[int, int], place: str) -> tuple[int, int]:
    if max(abs(length) for length in size) > LARGEST_PICTURE:
        hint = "Check the image size, or the principal point where no size is stated."
        what = f"The image would be {size[0]:.4g} x {size[1]:.4g} pixels, but the limit is {LARGEST_PICTURE:,}."
        raise CalibrationInvalid(what, where=place, hint=hint)
    return size


def _guessed_size(K: np.ndarray) -> tuple[int, int]:
    # ``Cameras`` checks K and rejects NaN.
    centre = np.clip(np.nan_to_num(K[:2, 2], nan=0.0, posinf=0.0, neginf=0.0), -1.0, float(LARGEST_PICTURE))
    return max(1, round(2 * float(centre[0]) + 1)), max(1, round(2 * float(centre[1]) + 1))


LARGEST_SHARE = 10.0
"""Largest focal length in image widths. The longest lenses reach 8. Values in pixels are at least about 100."""
SHORTEST_SHARE = 0.05
"""Smallest focal length in image widths (a field of view of 168 degrees). Smaller values are not in pixels."""
OFF_MIDDLE = 0.15
"""Largest distance from a principal point to the image centre, in image sizes. It is 0.3 or more for a principal point
measured from a corner.
"""
SURELY_DEGREES = 4.0 * np.pi  # A longer rotation vector exceeds two full turns, so it is in degrees.
_MIRROR = np.diag([-1.0, 1.0, 1.0])


def meant_entries(entries: Sequence[CameraEntry]) -> tuple[list[CameraEntry], tuple[Diagnostic, ...]]:
    """Convert cameras from unusual conventions, such as focal lengths in image widths. Also report the conversions."""
    names, found = [entry.name for entry in entries], []
    sized = all(e.image_size is not None for e in entries)
    sizes = [np.array(e.image_size or (1, 1)) for e in entries]
    if sized and all((e.K[:2] >= 0).all() and 0 < e.K[0, 0] < LARGEST_SHARE for e in entries):
        entries = [replace(e, K=np.diag([*size, 1.0]) @ e.K) for e, size in zip(entries, sizes, strict=True)]
        found.append(diagnostic("calibration_read_as", convention="shares", cameras=names))
    short = (0 < e.K[0, 0] < SHORTEST_SHARE * size[0] for e, size in zip(entries, sizes, strict=True))
    if sized and all(LENS_MODELS[e.model].is_straight for e in entries) and all(short):
        shortest, longest = min(e.K[0, 0] for e in entries), max(e.K[0, 0] for e in entries)
        hint = "Convert them to pixels. Multiply by the image width in pixels, and divide by the sensor width in mm."
        what = f"The focal lengths are {shortest:.3g} to {longest:.3g} px, which is not plausible. They may be in mm."
        raise CalibrationInvalid(what, hint=hint)
    if sized and all((np.abs(e.K[:2, 2]) < OFF_MIDDLE * size).all() for e, size in zip(entries, sizes, strict=True)):
        missing = not any(e.K[:2, 2].any() for e in entries)
        middles = [np.pad(0.5 * (size - 1)[:, None], ((0, 1), (2, 0))) for size in sizes]
        entries = [replace(e, K=e.K + middle) for e, middle in zip(entries, middles, strict=True)]
        convention = "centre_missing" if missing else "centre_offset"
        found.append(diagnostic("calibration_read_as", convention=convention, cameras=names))
    lengths = [float(np.linalg.norm(e.rotation_vector)) for e in entries if e.rotation_vector is not None]
    if np.isfinite(lengths).all() and max(lengths, default=0.0) > SURELY_DEGREES:
        turned = [None if (v := e.rotation_vector) is None else np.asarray(exp_so3(np.radians(v))) for e in entries]
        entries = [e if R is None else replace(e, R=R) for e, R in zip(entries, turned, strict=True)]
        found.append(diagnostic("calibration_read_as", convention="degrees", cameras=names))
    if all(_is_rounded(e.R) and np.linalg.det(e.R) < 0 for e in entries):
        entries = [replace(e, R=e.R @ _MIRROR) for e in entries]
        found.append(diagnostic("calibration_read_as", convention="left_handed", cameras=names))
    return list(entries), tuple(found)
