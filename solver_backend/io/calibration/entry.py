"""One camera as a calibration file states it, and the step from such entries to ``Cameras``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.plausible import FARTHEST_IN_UNITS, largest_finite
from solver_backend.types import Cameras

LARGEST_PICTURE = 1_000_000
"""Pixels a side."""
ROUNDING = 1e-3
"""A rotation matrix off by less is taken as rounded and made exact."""


@dataclass(frozen=True)
class CameraEntry:
    """A camera in OpenCV's axes: ``x_cam = R @ x_world + t``."""

    name: str
    """Name in the file."""
    K: np.ndarray
    """(3, 3) pixels."""
    distortion: np.ndarray
    """(n,) OpenCV's coefficients."""
    R: np.ndarray
    """(3, 3) world to camera."""
    t: np.ndarray
    """(3,) in the file's unit."""
    image_size: tuple[int, int] | None = None
    """Width and height in pixels where the file states it."""
    fisheye: bool = False
    """The coefficients are those of the fisheye model."""
    rotation_vector: np.ndarray | None = None
    """(3,) the rotation as it is written, where it is written as a vector."""

    def __post_init__(self) -> None:
        """Make sure that its numbers can be; they are not finite where a camera was not calibrated.

        Raises:
            CalibrationInvalid: one is larger than any length in any unit.
        """
        for name in ("K", "distortion", "R", "t"):
            largest = largest_finite(getattr(self, name))
            if largest > FARTHEST_IN_UNITS:
                what = f"{name} holds {largest:.3g}; at most {FARTHEST_IN_UNITS:g} is possible."
                raise CalibrationInvalid(what, where=f"camera {self.name}")


@dataclass(frozen=True)
class Calibration:
    """Cameras of one calibration in metres, Z up, with what was assumed."""

    cameras: Cameras
    """Every camera of the file."""
    source: Path
    """File or folder."""
    size_known: tuple[bool, ...] = ()
    """Whether the file states each camera's image size."""
    guessed_unit: str = ""
    """The unit that only the distance of the cameras suggests; '' where it is stated."""
    notes: tuple[Diagnostic, ...] = ()
    """Units and axes found."""
    rolls: tuple[int, ...] = ()
    """Of each camera, by how many quarter turns clockwise its pictures were found turned; () where none was."""
    problems: tuple[Diagnostic, ...] = ()
    """What the user should know."""


def build_cameras(entries: Sequence[CameraEntry], *, where: str) -> Cameras:
    """Return the cameras; an image size that is not stated is taken as twice the principal point.

    Raises:
        CalibrationInvalid: a value is impossible, or pinhole and fisheye cameras are mixed.
    """
    if len({entry.fisheye for entry in entries}) > 1:
        fish = ", ".join(entry.name for entry in entries if entry.fisheye)
        raise CalibrationInvalid(
            f"Pinhole and fisheye cameras are mixed; fisheye are {fish}.",
            where=where,
            hint="Calibrate all with one model.",
        )
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
        distortion_model="fisheye" if finished[0].fisheye else "opencv",
    )


def _exact_rotation(R: np.ndarray) -> np.ndarray:
    """Return the nearest rotation of one that was rounded; leave anything else for the check in ``Cameras``."""
    if not np.isfinite(R).all() or np.abs(R @ R.T - np.eye(3)).max() > ROUNDING:
        return R
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt


def _trimmed(entry: CameraEntry, where: str) -> np.ndarray:
    coefficients = np.asarray(entry.distortion, dtype=np.float64).reshape(-1)
    most = 4 if entry.fisheye else 8
    if len(coefficients) > most and np.any(coefficients[most:]):
        raise CalibrationInvalid(
            f"The camera has {len(coefficients)} distortion coefficients; {most} are read.",
            where=f"{where}, camera {entry.name}",
            hint="Calibrate without thin-prism and tilt terms.",
        )
    return coefficients[:most]


def _possible_size(size: tuple[int, int], place: str) -> tuple[int, int]:
    if max(abs(length) for length in size) > LARGEST_PICTURE:
        raise CalibrationInvalid(
            f"The image would be {size[0]:.4g} x {size[1]:.4g} pixels; at most {LARGEST_PICTURE:,} are possible.",
            where=place,
            hint="Check the image size, or the principal point where no size is stated.",
        )
    return size


def _guessed_size(K: np.ndarray) -> tuple[int, int]:
    # A NaN here is reported by Cameras, which looks at K itself.
    centre = np.clip(np.nan_to_num(K[:2, 2], nan=0.0, posinf=0.0, neginf=0.0), -1.0, float(LARGEST_PICTURE))
    return max(1, round(2 * float(centre[0]) + 1)), max(1, round(2 * float(centre[1]) + 1))
