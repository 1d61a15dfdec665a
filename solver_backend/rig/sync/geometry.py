"""The clocks of calibrated cameras to a small part of a frame: delays under which the views' rays meet best."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.cameras.refinement import refined_cameras
from solver_backend.cameras.triangulation.triangulate import triangulate
from solver_backend.cameras.view_checks.epipolar_lags import whole_lags
from solver_backend.cameras.view_checks.joint_delays import delay_step
from solver_backend.cameras.view_checks.synchronisation import moving_views, place_in_take, smoothed_tracks, tracks_at
from solver_backend.rig.sync.clocks import Clocks
from solver_backend.rig.sync.errors import SyncUnknown
from solver_backend.rig.sync.resample import at_times, common_times
from solver_backend.rig.sync.signals import RATE_SIGMA
from solver_backend.types import FEET, LIMBS, Cameras, JointSet

LAG_SIGMA_SHARE = 0.005
"""How far detections scatter where whole lags are compared, as a share of the picture's width."""
LAG_FRAMES = 120
SAMPLED_FRAMES = 1200
"""Frames on which delays are refined."""
ROUNDS, SETTLED_FRAMES = 12, 0.002
LEAST_FRAMES = 24


@dataclass(frozen=True)
class FilmedTracks:
    """One person in C views on their own clocks."""

    cameras: Cameras
    """C calibrated cameras."""
    tracks: list[np.ndarray]
    """(F_c, K, 2) px, NaN where missing."""
    times_s: list[np.ndarray]
    """(F_c,) from each video's first picture."""
    joint_set: JointSet
    """Names of the K keypoints."""
    fps: float
    """Pictures a second that all are compared at."""


def clocks_by_geometry(filmed: FilmedTracks, start: Clocks | None, reach_s: float) -> Clocks:
    """Return the clocks of calibrated cameras.

    Whole frames by epipolar lines (``whole_lags``), from a start or over the whole reach; then Gauss-Newton steps on
    delay and drift of all cameras with the points eliminated (``delay_step``), the drift held by the crystal's prior;
    cameras' poses are refined by the person in between, so that a calibration a little off counts less.

    Args:
        filmed: the person in every view.
        start: clocks known roughly; None looks over all lags.
        reach_s: largest offset looked for.

    Raises:
        SyncUnknown: too little moves, or no moment is in all views.
    """
    names = filmed.cameras.names
    clocks = start or Clocks.alike(names)
    xy = _whole_grid(filmed, clocks, reach_s if start is None else 0.0)
    usual = LAG_SIGMA_SHARE * float(filmed.cameras.image_size.max(axis=1).mean())
    sigma = np.full(xy.shape[2], usual)
    frames = np.arange(xy.shape[1])
    if xy.shape[1] < LEAST_FRAMES or (moving_views(xy, frames, sigma)).sum() < len(names):
        raise SyncUnknown(
            "The person moves too little, or is seen too little, to tell the cameras' clocks by.",
            where=", ".join(names), hint="Wave both arms in sight of all cameras, or use sound: --sync sound.",
        )  # fmt: skip
    reach = round((reach_s if start is None else 0.5) * filmed.fps)
    lags = whole_lags(filmed.cameras, xy, _lively(xy, LAG_FRAMES), sigma, max(reach, 2))
    clocks = replace(clocks, offset_s=clocks.offset_s + (lags - lags[0]) / filmed.fps)
    return _refined(filmed, clocks, usual)


def _whole_grid(filmed: FilmedTracks, clocks: Clocks, margin_s: float) -> np.ndarray:
    """Return (C, F, K, 2) limbs at moments that any view shows, on the clocks as they are known."""
    ends = [clocks.from_video(c, when[[0, -1]]) for c, when in enumerate(filmed.times_s)]
    low, high = min(e[0] for e in ends), max(e[1] for e in ends)
    wanted = low + np.arange(int((high - low) * filmed.fps) + 1) / filmed.fps
    return _limbs_at(filmed, clocks, wanted, feet=False)


def _limbs_at(filmed: FilmedTracks, clocks: Clocks, wanted: np.ndarray, *, feet: bool) -> np.ndarray:
    names = filmed.joint_set.keypoints
    compared = LIMBS["arms"] + LIMBS["legs"] + (FEET if feet else ())
    columns = [k for k, name in enumerate(names) if name.endswith(compared)]
    views = [
        at_times(track[:, columns], when, clocks.in_video(c, wanted))
        for c, (track, when) in enumerate(zip(filmed.tracks, filmed.times_s, strict=True))
    ]
    return smoothed_tracks(np.stack(views))


def _lively(xy: np.ndarray, count: int) -> np.ndarray:
    """Return numbers of frames spread over the take, those of each stretch in which most moves."""
    speed = np.nan_to_num(np.linalg.norm(np.gradient(xy, axis=1), axis=-1)).sum(axis=(0, 2))
    seen = np.isfinite(xy[..., 0]).any(-1).sum(0)
    parts = np.array_split(np.arange(xy.shape[1]), min(count, xy.shape[1]))
    return np.array([part[np.argmax(speed[part] * (seen[part] >= 2))] for part in parts if len(part)])


def _refined(filmed: FilmedTracks, clocks: Clocks, usual: float) -> Clocks:
    """Return the clocks after steps on delays and drifts."""
    cameras, fps = filmed.cameras, filmed.fps
    spans = [(float(when[0]), float(when[-1])) for when in filmed.times_s]
    sigma_s, findings = np.full((2, len(cameras)), np.nan), ()
    wanted = common_times(spans, clocks, fps)
    if len(wanted) < LEAST_FRAMES:
        raise SyncUnknown("The videos have no stretch of time in common.", where=", ".join(cameras.names))
    middle_s, half_s = float(wanted[[0, -1]].mean()), 0.5 * float(wanted[-1] - wanted[0])
    moved = clocks.offset_s + clocks.rate * (middle_s - clocks.middle_s)
    clocks = replace(clocks, offset_s=moved, middle_s=middle_s)
    for number in range(ROUNDS):
        xy = _limbs_at(filmed, clocks, wanted, feet=True)
        frames = np.unique(np.linspace(0, len(wanted) - 1, min(SAMPLED_FRAMES, len(wanted))).round().astype(int))
        seen = np.isfinite(xy[..., 0]).astype(float)
        if number in (1, 3):
            cameras = refined_cameras(cameras, xy, seen, rounds=4)
        located = triangulate(cameras, xy[:, frames], seen[:, frames])
        spread = np.minimum(np.asarray(located.sigma_px), usual)
        still = np.broadcast_to(frames, (len(cameras), len(frames))).astype(float)
        velocity = 0.5 * (tracks_at(xy, still + 1.0) - tracks_at(xy, still - 1.0))
        place = place_in_take(frames, len(wanted))
        step = delay_step(
            cameras, xy[:, frames], velocity, np.asarray(located.points), place, spread, drifting=True
        )
        limit = np.clip([step.delay, step.drift], -1.0, 1.0) / fps
        limit -= limit[:, :1]
        sigma_s = np.stack([step.sigma, step.drift_sigma]) / fps
        rate = clocks.rate + limit[1] / half_s
        trust = RATE_SIGMA**2 / (RATE_SIGMA**2 + (sigma_s[1] / half_s) ** 2)
        clocks = replace(clocks, offset_s=clocks.offset_s + limit[0], rate=trust * rate)
        if number > 3 and np.abs(limit[0]).max() * fps < SETTLED_FRAMES:
            break
    covariance = np.zeros((len(cameras), 2, 2))
    rate_variance = (sigma_s[1] / half_s) ** 2
    covariance[:, 0, 0] = sigma_s[0] ** 2 + sigma_s[0, 0] ** 2
    covariance[:, 1, 1] = rate_variance * RATE_SIGMA**2 / (rate_variance + RATE_SIGMA**2)
    covariance[0] = 0.0
    return replace(clocks, covariance=covariance, method="keypoints and cameras", findings=findings)
