"""What is wrong with a single camera's picture of a person, as far as it shows: repeated frames, cuts, gliding."""

from __future__ import annotations

import numpy as np

from solver_backend.agreement.repeated_frames import LEAST_REPEATED, repeated_frames, without_repeats
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.geometry.runs import true_runs
from solver_backend.types import Keypoints2D

CUT_SHARE, CUT_TIMES = 0.3, 6.0
"""A picture cuts where keypoints jump by this share of the person's extent, and by so many times their usual step:
a sprinter moves by 0.15 of it from picture to picture at 30 a second."""
CUT_POINTS, USUAL_S = 4, 0.5
"""Keypoints that both pictures must show, and how far around the usual step is looked for."""
GLIDE_M_S, GLIDE_S, GLIDE_SHARE = 0.35, 0.7, 0.5
"""Somebody glides who moves over the floor faster than this for so long, the feet slower about the body than such a
share of it. A walker's feet move about the body as fast as the body moves, and nobody flies for so long."""
SMOOTH_S = 0.25
"""Length of the average over time under which a lifted pose's trembling is no movement."""
_LEAST_EXTENT_PX = 1.0
"""Of a person whose points are all in one place."""


def bridge_repeats(camera: str, keypoints: Keypoints2D) -> tuple[Keypoints2D, list[Diagnostic]]:
    """Return the detections of one view with repeated frames between their neighbours, and what was repeated."""
    again = repeated_frames(keypoints)
    share = 100.0 * float(again.mean())
    if share < LEAST_REPEATED:
        return keypoints, []
    found = diagnostic(
        "frames_repeated", cameras=[camera], frames=[(0, keypoints.num_frames - 1)], remedy=Remedy.BRIDGED, size=share
    )
    return without_repeats(keypoints, again), [found]


def diagnose_cuts(camera: str, keypoints: Keypoints2D) -> list[Diagnostic]:
    """Return the cuts of one view."""
    last = cuts(keypoints.xy[0], keypoints.confidence[0] > 0, keypoints.fps)
    return [diagnostic("picture_cuts", cameras=[camera], frames=[(f, f + 1) for f in last])] if len(last) else []


def cuts(xy: np.ndarray, seen: np.ndarray, fps: float) -> np.ndarray:
    """Return the last frames before a cut.

    Args:
        xy: (F, K, 2) pixels.
        seen: (F, K) bool.
        fps: frames per second.
    """
    both = seen[1:] & seen[:-1]
    step = np.linalg.norm(np.where(both[..., None], np.diff(xy, axis=0), np.nan), axis=-1)
    low, high = (np.where(seen[..., None], xy, end) for end in (np.inf, -np.inf))
    span = np.where(seen.any(axis=1)[:, None], high.max(axis=1) - low.min(axis=1), np.nan)
    extent = np.linalg.norm(span, axis=-1)
    enough = both.sum(axis=1) >= CUT_POINTS
    jump = np.zeros(len(step))
    largest = np.maximum(np.maximum(extent[:-1], extent[1:])[enough], _LEAST_EXTENT_PX)
    jump[enough] = np.nanmedian(step[enough], axis=1) / largest
    around = max(2, round(USUAL_S * fps))
    near = np.lib.stride_tricks.sliding_window_view(np.pad(jump, around, mode="reflect"), 2 * around + 1)
    usual = np.median(near, axis=1) if len(jump) > around else np.full(len(jump), np.median(jump))
    return np.flatnonzero((jump > CUT_SHARE) & (jump > CUT_TIMES * usual))


def glides(root: np.ndarray, feet: np.ndarray, seen: np.ndarray, fps: float) -> list[tuple[int, int]]:
    """Return the stretches in which a person moves over the floor and the feet take no step.

    Args:
        root: (F, 3) the body's middle, world metres, Z up.
        feet: (F, 2, 3) the ankles.
        seen: (F,) bool, the person is in the picture.
        fps: frames per second.
    """
    if len(root) < GLIDE_S * fps + 2:
        return []
    body = np.linalg.norm(_speed(root, fps)[:, :2], axis=-1)
    about = np.linalg.norm(_speed(feet - root[:, None], fps), axis=-1).max(axis=1)
    gliding = (body > GLIDE_M_S) & (about < GLIDE_SHARE * body) & seen
    return [run for run in true_runs(gliding) if run[1] - run[0] + 1 >= GLIDE_S * fps]


def _speed(points: np.ndarray, fps: float) -> np.ndarray:
    """Return the speed of (F, ...) points averaged over ``SMOOTH_S``, a second."""
    half = max(1, round(0.5 * SMOOTH_S * fps))
    index = np.arange(len(points))
    before, after = np.maximum(index - half, 0), np.minimum(index + half, len(points) - 1)
    span = (after - before).reshape(-1, *(1,) * (points.ndim - 1))
    return (points[after] - points[before]) * fps / span
