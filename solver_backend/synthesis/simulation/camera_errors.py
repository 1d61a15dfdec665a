"""What cameras get wrong: a calibration that is a little off, and a clock that runs late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Cameras


def miscalibrated(cameras: Cameras, centre: np.ndarray, error_mm: float, rng: np.random.Generator) -> Cameras:
    """Return the cameras turned a little, so that a point at ``centre`` seems moved by ``error_mm`` per axis.

    What a shift of the whole room explains is taken out: a world frame is only as good as its cameras.
    """
    right, down = cameras.R[:, 0], cameras.R[:, 1]
    shift = 1e-3 * error_mm * rng.normal(size=(len(cameras), 2))
    directions = np.concatenate([right, down])
    room = np.linalg.lstsq(directions, shift.T.ravel(), rcond=None)[0]
    across, along = shift[:, 0] - right @ room, shift[:, 1] - down @ room
    distance = np.linalg.norm(cameras.centres - centre, axis=1)
    roll = 1e-3 * error_mm * rng.normal(size=len(cameras))
    turn = exp_so3(np.stack([-along, across, roll], axis=1) / distance[:, None])
    return replace(cameras, R=turn @ cameras.R, t=(turn @ cameras.t[..., None])[..., 0])


def delayed(track: np.ndarray, frames: float) -> np.ndarray:
    """Return an (F, ...) track as a camera sees it that runs late by some frames (linear between, held at the ends)."""
    at = np.clip(np.arange(len(track)) - frames, 0, len(track) - 1)
    first = np.minimum(np.floor(at).astype(int), len(track) - 2)
    share = (at - first).reshape(-1, *([1] * (track.ndim - 1)))
    return (1 - share) * track[first] + share * track[first + 1]


def px_per_mm(cameras: Cameras, points: np.ndarray) -> np.ndarray:
    """Return (C, F, K) pixels that a millimetre spans at (F, K, 3) points."""
    depth = np.einsum("cj,fkj->cfk", cameras.R[:, 2], points) + cameras.t[:, 2, None, None]
    return cameras.K[:, 0, 0, None, None] / (1000.0 * np.maximum(depth, 0.1))
