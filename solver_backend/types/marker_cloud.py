"""Define recorded optical markers, and the calibrated person who wears them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from solver_backend.exchange.errors import CaptureInvalid, NonFiniteData, ShapeMismatch, SubjectInvalid
from solver_backend.exchange.joint_sets import NUM_BETAS
from solver_backend.exchange.plausible import FARTHEST_M, LARGEST_BETA, require_within
from solver_backend.types.shapes import Float


@dataclass(frozen=True)
class MarkerCloud:
    """Positions of optical markers. Missing markers are NaN."""

    positions: Float[np.ndarray, "frames markers 3"]
    """(frames, markers, 3) positions in metres."""
    fps: float
    labels: tuple[str, ...] | None = None
    """One label per marker, or None for an unlabelled cloud."""
    residual: Float[np.ndarray, "frames markers"] | None = None
    """(frames, markers) residuals from the recording program in metres."""
    covariance: Float[np.ndarray, "frames markers 3 3"] | None = None
    """(frames, markers, 3, 3) covariances of measured positions in m², which replace the residuals."""

    def __post_init__(self) -> None:
        shape = np.shape(self.positions)
        if len(shape) != 3 or shape[-1] != 3:
            raise CaptureInvalid(
                f"Markers have the shape {shape}, but (frames, markers, 3) is expected.", where="markers"
            )
        if shape[1] and not shape[0]:
            hint = "Record or export it again."
            raise CaptureInvalid(f"The recording of {shape[1]} markers has no frames.", where="markers", hint=hint)
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise NonFiniteData(f"The frame rate must be a positive number, not {self.fps}.", where="markers")
        if self.labels is not None and len(self.labels) != shape[1]:
            raise ShapeMismatch(f"{len(self.labels)} labels do not match {shape[1]} markers.", where="markers")
        for name, expected in (("residual", shape[:2]), ("covariance", (*shape[:2], 3, 3))):
            value = getattr(self, name)
            if value is not None and np.shape(value) != expected:
                raise ShapeMismatch(
                    f"{name} has the shape {np.shape(value)}, but {expected} is expected.", where="markers"
                )

    @property
    def names(self) -> tuple[str, ...]:
        """Marker labels, or an empty tuple for an unlabelled cloud."""
        return self.labels or ()

    def columns(self, chosen: Sequence[int], labels: tuple[str, ...] | None = None) -> MarkerCloud:
        """Select markers by index, and rename them if ``labels`` are given."""
        if labels is None and self.labels is not None:
            labels = tuple(self.labels[i] for i in chosen)
        residual, covariance = (None if v is None else v[:, chosen] for v in (self.residual, self.covariance))
        return MarkerCloud(self.positions[:, chosen], self.fps, labels, residual, covariance)

    def frames(self, start: int, stop: int) -> MarkerCloud:
        """Return the frames from ``start`` to ``stop`` - 1."""
        residual, covariance = (None if v is None else v[start:stop] for v in (self.residual, self.covariance))
        return MarkerCloud(self.positions[start:stop], self.fps, self.labels, residual, covariance)

    @property
    def values(self) -> np.ndarray:
        """(frames, markers, 3 to 13) positions, then residuals and covariances if known."""
        parts = [self.positions]
        if self.residual is not None:
            parts.append(self.residual[..., None])
        if self.covariance is not None:
            parts.append(self.covariance.reshape(*self.positions.shape[:2], 9))
        return np.concatenate(parts, axis=-1)

    def with_values(self, values: np.ndarray, labels: tuple[str, ...]) -> MarkerCloud:
        """Build a cloud with new labels from an array in the same format as ``values``."""
        residual = None if self.residual is None else values[..., 3]
        covariance = None if self.covariance is None else values[..., -9:].reshape(*values.shape[:2], 3, 3)
        return MarkerCloud(values[..., :3], self.fps, labels, residual, covariance)


_LEAST_SIGMA_M = 1e-9  # Smallest standard deviation of a marker position (m). Markers are known to 0.1 mm at best.


@dataclass(frozen=True)
class MarkerSubject:
    """Calibrated person: body shape and marker positions, for takes with the same markers."""

    body: str  # Id of the body that the shape belongs to.
    betas: Float[np.ndarray, " 10"]  # (10,) shape coefficients.
    labels: tuple[str, ...]  # (M,) labels in the recording.
    places: tuple[str, ...]  # (M,) landmarks in the layouts, or ``@`` and the name of the marker's bone.
    offsets: Float[np.ndarray, "markers 3"]  # (M, 3) metres from landmark or joint to marker, in the rest pose.
    sigma_m: Float[np.ndarray, " markers"]  # (M,) standard deviation of each marker's position per axis, metres.
    skin_m: Float[np.ndarray, " markers"]  # (M,) distance from the skin in metres, NaN for a marker with only a bone.
    provenance: dict[str, Any] = field(default_factory=dict)
    """Takes, frames and version used in the calibration, as plain JSON values."""

    def __post_init__(self) -> None:
        count = len(self.labels)
        shapes = {"betas": (NUM_BETAS,), "offsets": (count, 3), "sigma_m": (count,), "skin_m": (count,)}
        for name, shape in shapes.items():
            value = np.asarray(getattr(self, name))
            if value.shape != shape:
                raise SubjectInvalid(f"{name} has shape {value.shape}, but {shape} is expected.", where="subject")
            if name != "skin_m" and not np.isfinite(value).all():
                raise SubjectInvalid(f"{name} contains NaN or infinite values.", where="subject")
        require_within("betas", self.betas, LARGEST_BETA, SubjectInvalid, "subject")
        require_within("offsets", self.offsets, FARTHEST_M, SubjectInvalid, "subject")
        if len(self.places) != count or len(set(self.labels)) < count:
            raise SubjectInvalid("Each marker needs one position and its own label.", where="subject")
        require_within("sigma_m", self.sigma_m, FARTHEST_M, SubjectInvalid, "subject")
        require_within("skin_m", np.nan_to_num(self.skin_m, nan=0.0), FARTHEST_M, SubjectInvalid, "subject")
        if count and not (np.asarray(self.sigma_m) >= _LEAST_SIGMA_M).all():
            raise SubjectInvalid("sigma_m contains a value that is not positive.", where="subject")
