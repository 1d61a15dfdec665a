"""A thing with markers that somebody swings: known poses, and markers as a system records them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.props import Prop
from solver_backend.geometry.rotations import exp_so3, log_so3

RACKET = np.array([(0.1, 0.0, 0.02), (-0.1, 0.05, 0.0), (0.0, 0.45, 0.01), (0.02, -0.15, 0.0)])
STICK = np.array([(0.0, -0.5, 0.0), (0.0, -0.1, 0.0), (0.0, 0.4, 0.0), (0.0, 0.55, 0.0)])


@dataclass(frozen=True)
class MovingProp:
    """F frames of a rigid body."""

    shape: np.ndarray  # (M, 3) markers in its own frame, metres.
    rotvec: np.ndarray
    transl: np.ndarray
    fps: float

    @property
    def markers(self) -> np.ndarray:
        """(F, M, 3) metres."""
        return self.shape @ np.swapaxes(exp_so3(self.rotvec), -1, -2) + self.transl[:, None]

    def recorded(self, noise_m: float, missing: float, seed: int) -> np.ndarray:
        """Return the markers with noise, a share of them missing, each frame by itself."""
        rng = np.random.default_rng(seed + 100)
        points = self.markers + noise_m * rng.normal(size=self.markers.shape)
        points[rng.random(points.shape[:2]) < missing] = np.nan
        return points


def moving_prop(shape: np.ndarray, *, frames: int, fps: float = 100.0, seed: int = 0) -> MovingProp:
    """Return a thing that swings by some decimetres and a radian, at up to 1.2 Hz."""
    rng, time = np.random.default_rng(seed), np.arange(frames)[:, None] / fps

    def swing(size: float) -> np.ndarray:
        rates, phases = rng.uniform(0.1, 1.2, (4, 3)), rng.uniform(0, 2 * np.pi, (4, 3))
        return size * np.sin(2 * np.pi * rates * time[..., None] + phases).sum(axis=1)

    return MovingProp(shape - shape.mean(axis=0), swing(0.4), swing(0.2) + (0.0, 0.0, 1.0), fps)


def pose_errors(
    prop: Prop, truth: MovingProp, chosen: np.ndarray | slice = slice(None)
) -> tuple[np.ndarray, np.ndarray]:
    """Return (F, M) distances of markers in metres, and (F,) angles between rotations, a constant one apart, rad.

    Args:
        prop: as it was solved.
        truth: as it moved.
        chosen: frames that show the constant rotation.
    """
    away = np.linalg.norm(prop.markers - truth.markers, axis=-1)
    found, true = exp_so3(prop.rotvec), exp_so3(truth.rotvec)
    U, _, Vt = np.linalg.svd((np.swapaxes(found, -1, -2) @ true)[chosen].mean(axis=0))
    return away, np.linalg.norm(log_so3(np.swapaxes(true, -1, -2) @ found @ (U @ Vt)), axis=-1)
