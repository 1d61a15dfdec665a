"""Optical markers as they were recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.errors import CaptureInvalid, NonFiniteData, ShapeMismatch
from solver_backend.types.shapes import Float


@dataclass(frozen=True)
class MarkerCloud:
    """Optical markers; missing = NaN."""

    positions: Float[np.ndarray, "frames markers 3"]
    """(frames, markers, 3) metres."""
    fps: float
    """Frames per second."""
    labels: tuple[str, ...] | None = None
    """One label a marker, or None for an unlabelled cloud."""
    residual: Float[np.ndarray, "frames markers"] | None = None
    """(frames, markers) metres, the tracker's own residual."""
    covariance: Float[np.ndarray, "frames markers 3 3"] | None = None
    """(frames, markers, 3, 3) m², how surely each position was measured; it stands in the residual's place."""

    def __post_init__(self) -> None:
        shape = np.shape(self.positions)
        if len(shape) != 3 or shape[-1] != 3:
            raise CaptureInvalid(f"Markers have the shape {shape}; (frames, markers, 3) is expected.", where="markers")
        if shape[1] and not shape[0]:
            raise CaptureInvalid(f"The recording of {shape[1]} markers has no frames.", where="markers")
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise NonFiniteData(f"The frame rate must be a positive number, not {self.fps}.", where="markers")
        if self.labels is not None and len(self.labels) != shape[1]:
            raise ShapeMismatch(f"{len(self.labels)} labels do not fit {shape[1]} markers.", where="markers")
        for name, expected in (("residual", shape[:2]), ("covariance", (*shape[:2], 3, 3))):
            value = getattr(self, name)
            if value is not None and np.shape(value) != expected:
                raise ShapeMismatch(f"{name} has the shape {np.shape(value)}; {expected} is expected.", where="markers")

    def columns(self, chosen: Sequence[int], labels: tuple[str, ...] | None) -> MarkerCloud:
        """Return these markers under these labels."""
        residual, covariance = (None if v is None else v[:, chosen] for v in (self.residual, self.covariance))
        return MarkerCloud(self.positions[:, chosen], self.fps, labels, residual, covariance)
