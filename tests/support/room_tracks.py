"""Tracks of background points in a room that a carried camera films: simulated, without pictures."""

from __future__ import annotations

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.types import Cameras, Keypoints2D

MARGIN_M, HEIGHT_M = 2.5, 2.8  # Of the room around the camera's and the person's ways.
CROWDED = 3000  # Points of the room per metre of its longer side are far more than a tracker keeps.
KEPT = 400  # Most tracks in a picture.
LIFE_S, SHORTEST = 1.2, 8  # Mean life of a track, and pictures of the shortest one.
NOISE_PX, DRIFT_PX = 0.4, 0.03  # White noise per axis, and random walk per picture.
ADRIFT, SLIDE_PX = 0.06, 0.7  # Share of tracks that slide away (reflections, occluding edges), and how fast.
HIDDEN = 0.25  # A person hides the box of the keypoints and so much of its size around it.


def room_tracks(
    camera: Cameras,
    poses: tuple[np.ndarray, np.ndarray],
    person: Keypoints2D,
    way: np.ndarray,
    seed: int,
    kept: int = KEPT,
) -> np.ndarray:
    """Return (F, P, 2) tracks in px, NaN where a point is not tracked.

    Args:
        poses: (F, 3, 3) and (F, 3) of the camera, world to camera.
        way: (F, 3) of the person, metres.
        kept: most tracks in a picture. A plain wall has few.
    """
    rng, (R, t) = np.random.default_rng(seed), poses
    frames, fps = len(R), person.fps
    X = scene(rng, np.concatenate([-np.einsum("fba,fb->fa", R, t), way]))
    px = np.asarray(project(camera.carried(R, t), np.broadcast_to(X, (frames, *X.shape))))[0]
    ahead = np.einsum("fa,pa->fp", R[:, 2], X) + t[:, 2, None] > 0.2
    shown = ahead & ((px >= 0) & (px < camera.image_size[0])).all(axis=-1)
    shown &= ~in_boxes(px, person)
    number, start = np.arange(frames)[:, None], rng.uniform(-LIFE_S * fps, frames, len(X))
    shown &= (number >= start) & (number < start + rng.exponential(LIFE_S * fps, len(X)))
    # A point that was lost is another track when it is found again, so each column ends at its first loss.
    first = np.argmax(shown, axis=0)
    shown &= np.logical_and.accumulate(shown | (number < first), axis=0)
    shown[:, shown.sum(axis=0) < SHORTEST] = False
    crowd = np.median(shown.sum(axis=1))
    shown &= rng.uniform(size=len(X)) < kept / max(crowd, 1)
    slides = (rng.uniform(size=len(X)) < ADRIFT) * SLIDE_PX
    angle, age = rng.uniform(0.0, 2.0 * np.pi, len(X)), np.maximum(number - first, 0)[..., None]
    px = px + NOISE_PX * rng.normal(size=px.shape)
    px += DRIFT_PX * np.cumsum(rng.normal(size=px.shape), axis=0) * (age > 0)
    px += age * (slides * np.array([np.cos(angle), np.sin(angle)])).T
    return np.where(shown[..., None], px, np.nan)[:, shown.any(axis=0)]


def scene(rng: np.random.Generator, ways: np.ndarray) -> np.ndarray:
    """Return (P, 3) points on the floor and the walls of a room around the ways (N, 3), and on its furniture."""
    low, high = ways[:, :2].min(axis=0) - MARGIN_M, ways[:, :2].max(axis=0) + MARGIN_M
    count = int(CROWDED * (high - low).max())
    X = rng.uniform([*low, 0.0], [*high, HEIGHT_M], (count, 3))
    side = rng.integers(0, 6, count)
    for axis in (0, 1):
        for end, bound in enumerate((low, high)):
            X[side == 2 * axis + end, axis] = bound[axis]
    X[side == 4, 2] = 0.0
    near = np.clip(0.3 * rng.exponential(size=(count, 2)), 0.0, 1.0)  # Furniture stands at the walls.
    pieces = side == 5
    X[pieces, 0] = np.where(rng.uniform(size=count) < 0.5, low[0] + near[:, 0], high[0] - near[:, 0])[pieces]
    X[pieces, 2] *= 0.6
    return X


def in_boxes(px: np.ndarray, person: Keypoints2D) -> np.ndarray:
    """Return (F, P) bool, whether points are in the box around the person's keypoints."""
    seen = np.where(person.confidence[0, ..., None] > 0, person.xy[0], np.nan)
    low, high = np.nanmin(seen, axis=1), np.nanmax(seen, axis=1)
    margin = HIDDEN * (high - low)
    return ((px > (low - margin)[:, None]) & (px < (high + margin)[:, None])).all(axis=-1)
