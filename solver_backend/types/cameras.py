"""Calibrated cameras in OpenCV's convention, and how well they fit a take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.lens import DEFAULT_MODEL, require_models
from solver_backend.exchange.plausible import FARTHEST_IN_UNITS, require_within
from solver_backend.types.shapes import Float, Int

_LARGEST_SIZE = 2.0**31
"""Pixels along a side that no picture has: beyond it whole numbers of 32 bits end."""


@dataclass(frozen=True)
class Cameras:
    """Cameras of one capture: ``x_cam = R @ x_world + t``; pixel (0, 0) is the centre of the top-left pixel."""

    names: tuple[str, ...]
    """One unique name a camera."""
    K: Float[np.ndarray, "cameras 3 3"]
    """(C, 3, 3) intrinsic matrices in pixels."""
    distortion: Float[np.ndarray, "cameras 8"]
    """(C, 8) coefficients in the order of each camera's lens model, padded with zeros."""
    R: Float[np.ndarray, "cameras 3 3"]
    """(C, 3, 3) rotations world to camera (OpenCV axes: x right, y down, z forward)."""
    t: Float[np.ndarray, "cameras 3"]
    """(C, 3) translations in metres."""
    image_size: Int[np.ndarray, "cameras 2"]
    """(C, 2) width and height in pixels."""
    models: tuple[str, ...] = (DEFAULT_MODEL,)
    """Name of each camera's lens model, of ``LENS_MODELS``; a single name is that of all."""

    def __post_init__(self) -> None:
        count = len(self.names)
        if len(set(self.names)) != count:
            hint = "Rename one of them."
            raise CalibrationInvalid("Two cameras have the same name.", where=", ".join(self.names), hint=hint)
        distortion = np.zeros((count, 8))
        given = np.asarray(self.distortion, dtype=np.float64).reshape(count, -1) if count else distortion
        if given.shape[1] > 8:
            raise CalibrationInvalid(
                f"A camera has {given.shape[1]} distortion coefficients; at most 8 are read (k1 k2 p1 p2 k3 k4 k5 k6).",
                hint="Calibrate with the rational model or without thin-prism terms.",
            )
        distortion[:, : given.shape[1]] = given
        sizes = np.asarray(self.image_size, dtype=np.float64)
        if not (np.abs(sizes) < _LARGEST_SIZE).all():  # a number that is none is not, either
            raise CalibrationInvalid("image_size must hold whole numbers of pixels.", where="cameras")
        arrays = {
            "K": (np.asarray(self.K, dtype=np.float64), (count, 3, 3)),
            "distortion": (distortion, (count, 8)),
            "R": (np.asarray(self.R, dtype=np.float64), (count, 3, 3)),
            "t": (np.asarray(self.t, dtype=np.float64), (count, 3)),
            "image_size": (sizes.astype(np.int64), (count, 2)),
        }
        for name, (value, shape) in arrays.items():
            if value.shape != shape:
                raise CalibrationInvalid(f"{name} has shape {value.shape}; {shape} is expected.", where="cameras")
            finite = np.isfinite(value).all(axis=tuple(range(1, value.ndim)))
            if not finite.all():
                what = f"{name} holds NaN or infinite values."
                raise CalibrationInvalid(what, where=f"camera {self.names[int(np.argmin(finite))]}")
            require_within(name, value, FARTHEST_IN_UNITS, CalibrationInvalid, "cameras")
            object.__setattr__(self, name, value)
        models = tuple(self.models) * count if len(self.models) == 1 else tuple(self.models)
        if len(models) != count:
            raise CalibrationInvalid(f"{len(models)} lens models do not fit {count} cameras.", where="cameras")
        require_models(models)
        object.__setattr__(self, "models", models)
        self._check_physics()

    def _check_physics(self) -> None:
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is no rotation
            off = np.abs(self.R @ self.R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
            sign = np.linalg.det(self.R)
        bent = ~(off <= 1e-3)
        lengths = self.K[:, [0, 1], [0, 1]]
        if not (bent.any() or (sign < 0).any() or (lengths <= 0).any() or (self.image_size <= 0).any()):
            return
        for c, name in enumerate(self.names):
            if bent[c] or sign[c] < 0:
                mirrors = not bent[c]
                what = "mirrors, unlike those of other cameras" if mirrors else "is not orthonormal"
                raise CalibrationInvalid(
                    f"The rotation {what} (|R Rᵀ - I| = {off[c]:.3g}, det = {sign[c]:.3g}).",
                    where=f"camera {name}",
                    hint="Negate one axis of the camera, in R and t."
                    if mirrors
                    else "Check that the calibration holds a rotation (not a scaled or mirrored matrix).",
                )
            if self.K[c, 0, 0] <= 0 or self.K[c, 1, 1] <= 0:
                what = f"The focal length must be positive, not {self.K[c, 0, 0]:.6g}, {self.K[c, 1, 1]:.6g}."
                raise CalibrationInvalid(what, where=f"camera {name}")
            width, height = self.image_size[c]
            if min(width, height) <= 0:
                raise CalibrationInvalid(f"The image size {width} x {height} is not positive.", where=f"camera {name}")

    def __len__(self) -> int:
        return len(self.names)

    @property
    def centres(self) -> Float[np.ndarray, "cameras 3"]:
        """(C, 3) optical centres in world metres, ``-Rᵀ t``."""
        return -np.einsum("cji,cj->ci", self.R, self.t)

    def subset(self, indices: list[int]) -> Cameras:
        """Return the cameras at these indices, in this order."""
        names, models = (tuple(every[i] for i in indices) for every in (self.names, self.models))
        arrays = {key: getattr(self, key)[indices] for key in ("K", "distortion", "R", "t", "image_size")}
        return Cameras(names=names, models=models, **arrays)


ROWS, COLUMNS = ("top", "centre", "bottom"), ("left", "middle", "right")
"""Parts of a picture."""


@dataclass(frozen=True)
class CameraFits:
    """How C cameras fit one take; px unless stated."""

    verdict: str
    """One sentence."""
    region_px: np.ndarray
    """(C, 3, 3) median reprojection error by part of the picture, rows first; NaN where too little was seen."""
    camera_px: np.ndarray
    """(C,) the same of the whole picture."""
    best_px: np.ndarray
    """(C,) the same after the poses were adjusted to the take."""
    epipolar_px: np.ndarray
    """(C, W) median distance to the other cameras' epipolar lines in W equal stretches of the take."""
    stature_m: float
    """Of the person by the calibration's scale, metres."""
    tilt_deg: float
    """Between the world's up and the person's, degrees."""
    tilt_sigma_deg: float
    """Standard deviation of that angle as a person shows it, degrees."""
    findings: tuple[str, ...]
    """What is wrong, with what to do."""
