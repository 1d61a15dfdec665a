"""Define calibrated cameras in OpenCV's convention, and the report on how well they fit a take."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.lens import DEFAULT_MODEL, require_models
from solver_backend.exchange.plausible import FARTHEST_IN_UNITS, require_within
from solver_backend.types.shapes import Float, Int

_SHORTEST_PX = 1e-3  # Focal length in pixels. A fisheye lens on a one-pixel image has 0.3.
_LARGEST_SIZE = 2.0**31  # Pixels per side below which sizes fit in 32-bit integers.


@dataclass(frozen=True)
class CameraPath:
    """Motion of a rigid group of cameras in F frames: ``x_start = R @ x_world + t``."""

    R: Any  # (F, 3, 3) rotations from the world to the axes to which the cameras are fixed.
    t: Any  # (F, 3) translations in metres.

    def __len__(self) -> int:
        return len(self.R)

    def at(self, frames: Any) -> CameraPath:
        """Return the path in selected frames (indices or slice)."""
        return CameraPath(self.R[frames], self.t[frames])


@dataclass(frozen=True)
class Cameras:
    """Cameras of one capture: ``x_cam = R @ x_world + t``, with pixel centres at whole numbers.

    Moving cameras have a path, ``x_cam = R @ x_start + t``. Points then have F frames along their first axis.
    """

    names: tuple[str, ...]
    """(C,) unique camera names."""
    K: Float[np.ndarray, "cameras 3 3"]
    """(C, 3, 3) intrinsic matrices in pixels."""
    distortion: Float[np.ndarray, "cameras 8"]
    """(C, 8) coefficients in the order of each camera's lens model, padded with zeros."""
    R: Float[np.ndarray, "cameras 3 3"]
    """(C, 3, 3) rotations from world to camera (OpenCV axes: x right, y down, z forward)."""
    t: Float[np.ndarray, "cameras 3"]
    """(C, 3) translations in metres."""
    image_size: Int[np.ndarray, "cameras 2"]
    """(C, 2) width and height in pixels."""
    models: tuple[str, ...] = (DEFAULT_MODEL,)
    """Name in ``LENS_MODELS`` of each camera's lens model, or one name for all."""
    path: CameraPath | None = None
    """Motion of moving cameras, or None for static cameras."""

    def __post_init__(self) -> None:
        count = len(self.names)
        if len(set(self.names)) != count:
            hint = "Rename one of them."
            raise CalibrationInvalid("Two cameras have the same name.", where=", ".join(self.names), hint=hint)
        distortion = np.zeros((count, 8))
        given = np.asarray(self.distortion, dtype=np.float64).reshape(count, -1) if count else distortion
        if given.shape[1] > 8:
            what = f"A camera has {given.shape[1]} distortion coefficients, but at most 8 are supported "
            hint = "Calibrate with the rational model or without thin-prism terms."
            raise CalibrationInvalid(f"{what}(k1 k2 p1 p2 k3 k4 k5 k6).", hint=hint)
        distortion[:, : given.shape[1]] = given
        sizes = np.asarray(self.image_size, dtype=np.float64)
        if not (np.abs(sizes) < _LARGEST_SIZE).all():  # also False for NaN
            raise CalibrationInvalid("image_size must contain whole numbers of pixels.", where="cameras")
        K, R, t = (np.asarray(array, dtype=np.float64) for array in (self.K, self.R, self.t))
        arrays = {"K": (K, (count, 3, 3)), "distortion": (distortion, (count, 8)), "R": (R, (count, 3, 3))}
        arrays |= {"t": (t, (count, 3)), "image_size": (sizes.astype(np.int64), (count, 2))}
        for name, (value, shape) in arrays.items():
            if value.shape != shape:
                raise CalibrationInvalid(f"{name} has shape {value.shape}, but {shape} is expected.", where="cameras")
            finite = np.isfinite(value).all(axis=tuple(range(1, value.ndim)))
            if not finite.all():
                what = f"{name} contains NaN or infinite values."
                raise CalibrationInvalid(what, where=f"camera {self.names[int(np.argmin(finite))]}")
            require_within(name, value, FARTHEST_IN_UNITS, CalibrationInvalid, "cameras")
            object.__setattr__(self, name, value)
        models = tuple(self.models) * count if len(self.models) == 1 else tuple(self.models)
        if len(models) != count:
            raise CalibrationInvalid(f"{len(models)} lens models do not match {count} cameras.", where="cameras")
        require_models(models)
        object.__setattr__(self, "models", models)
        if self.path is not None:
            self._check_path(self.path)
        self._check_physics()

    def _check_path(self, path: CameraPath) -> None:
        R, t = (np.asarray(part, dtype=np.float64) for part in (path.R, path.t))
        if R.shape != (len(t), 3, 3) or t.shape != (len(R), 3):
            what = f"The camera path has shapes {R.shape} and {t.shape}, but (F, 3, 3) and (F, 3) are expected."
            raise CalibrationInvalid(what, where="cameras")
        with np.errstate(invalid="ignore", over="ignore"):
            turns = np.isfinite(t).all(1) & (np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) <= 1e-3)
            turns &= np.linalg.det(np.nan_to_num(R)) > 0
        if not turns.all():
            where = f"frame {int(np.argmin(turns))}"
            raise CalibrationInvalid("The camera path has an impossible pose.", where=where)
        require_within("t of the camera path", t, FARTHEST_IN_UNITS, CalibrationInvalid, "cameras")
        object.__setattr__(self, "path", CameraPath(R, t))

    def _check_physics(self) -> None:
        with np.errstate(over="ignore", invalid="ignore"):  # numbers that overflow are not a rotation
            off = np.abs(self.R @ self.R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
            sign = np.linalg.det(self.R)
        bent = ~(off <= 1e-3)
        lengths = self.K[:, [0, 1], [0, 1]]
        if not (bent.any() or (sign < 0).any() or (lengths < _SHORTEST_PX).any() or (self.image_size <= 0).any()):
            return
        for c, name in enumerate(self.names):
            if bent[c] or sign[c] < 0:
                what, hint = "mirrors, unlike the other cameras", "Negate one axis of the camera, in R and t."
                if bent[c]:
                    what = "is not orthonormal"
                    hint = "Check that the calibration contains a rotation (not a scaled or mirrored matrix)."
                what = f"The rotation {what} (|R Rᵀ - I| = {off[c]:.3g}, det = {sign[c]:.3g})."
                raise CalibrationInvalid(what, where=f"camera {name}", hint=hint)
            if (lengths[c] < _SHORTEST_PX).any():
                found = f"{lengths[c, 0]:.6g}, {lengths[c, 1]:.6g}"
                what = f"The focal length must be {_SHORTEST_PX:g} px or more, not {found}."
                raise CalibrationInvalid(what, where=f"camera {name}")
            width, height = self.image_size[c]
            if min(width, height) <= 0:
                raise CalibrationInvalid(f"The image size {width} x {height} is not positive.", where=f"camera {name}")

    def __len__(self) -> int:
        return len(self.names)

    @property
    def centres(self) -> Float[np.ndarray, "cameras 3"]:
        """(C, 3) optical centres in world metres, ``-Rᵀ t``. For moving cameras, their centres at the start."""
        return -np.einsum("cji,cj->ci", self.R, self.t)

    def poses(self, camera: int, frames: int) -> tuple[Float[np.ndarray, "frames 3 3"], Float[np.ndarray, "frames 3"]]:
        """Return one camera's world-to-camera rotations (F, 3, 3) and translations (F, 3)."""
        R, t = self.R[camera], self.t[camera]
        if self.path is None:
            return np.broadcast_to(R, (frames, 3, 3)), np.broadcast_to(t, (frames, 3))
        return R @ self.path.R, self.path.t @ R.T + t

    def carried(self, R: Float[np.ndarray, "frames 3 3"], t: Float[np.ndarray, "frames 3"]) -> Cameras:
        """Return a single camera with new world-to-camera rotations (F, 3, 3) and translations (F, 3)."""
        return replace(self, R=R[:1], t=t[:1], path=CameraPath(R[0].T @ R, (t - t[0]) @ R[0]))

    def scaled(self, factor: float) -> Cameras:
        """Scale the world, and with it the camera positions, by ``factor``. Images do not change."""
        path = self.path and CameraPath(self.path.R, self.path.t * factor)
        return replace(self, t=self.t * factor, path=path)

    def at(self, frames: slice | np.ndarray) -> Cameras:
        """Return the cameras in selected frames. The first of these frames becomes the start of moving cameras."""
        if self.path is None or not len(part := self.path.at(frames)):
            return self
        R, t = self.R @ part.R[0], (self.R @ part.t[0]) + self.t
        path = CameraPath(part.R[0].T @ part.R, (part.t - part.t[0]) @ part.R[0])
        return replace(self, R=R, t=t, path=path)

    def subset(self, indices: list[int]) -> Cameras:
        """Return the cameras at these indices, in the order of the indices."""
        names, models = (tuple(every[i] for i in indices) for every in (self.names, self.models))
        arrays = {key: getattr(self, key)[indices] for key in ("K", "distortion", "R", "t", "image_size")}
        return Cameras(names=names, models=models, path=self.path, **arrays)


ROWS, COLUMNS = ("top", "centre", "bottom"), ("left", "middle", "right")  # Image regions.


@dataclass(frozen=True)
class CameraFits:
    """Report on how well C cameras fit a take. Errors are in px unless stated otherwise."""

    verdict: str
    region_px: np.ndarray  # (C, 3, 3) median reprojection error by image region, rows first, NaN if unknown.
    camera_px: np.ndarray  # (C,) median reprojection error over the whole image.
    best_px: np.ndarray  # (C,) the same after adjusting the camera poses to the take.
    epipolar_px: np.ndarray  # (C, W) median distance to the other cameras' epipolar lines in W equal parts of the take.
    stature_m: float  # The person's stature at the calibration's scale, in metres.
    tilt_deg: float  # Angle between the world's and the person's up directions, in degrees.
    tilt_sigma_deg: float  # Standard deviation of that angle, degrees.
    findings: tuple[str, ...]  # Problems and their remedies.
