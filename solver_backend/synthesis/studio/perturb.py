"""Create the clean capture of a shot, and a capture with simulated faults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.body.markers import marker_landmarks
from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.synthesis.faults import autoregressive, bursts
from solver_backend.synthesis.simulation.keypoint_detector import (
    Sight,
    delayed,
    detect_keypoints,
    direction_seen_from,
    miscalibrated,
    px_per_mm,
)
from solver_backend.synthesis.studio.spec import Spec, sizes_of
from solver_backend.synthesis.studio.stage import Stage
from solver_backend.synthesis.studio.truth import OUTSIDE, VISIBLE, Truth, marker_sight
from solver_backend.types import Capture, Keypoints2D, MarkerCloud, Motion

_ORIGIN = "a shot of the studio"


def clean_capture(spec: Spec, stage: Stage, truth: Truth, motion: Motion) -> Capture:
    """Return a shot's capture without errors. Keypoints inside the image have confidence 1."""
    chosen = spec.joint_set
    there = truth.visibility[chosen] != OUTSIDE
    xy = np.where(there[..., None], truth.xy[chosen], np.nan)
    keypoints = Keypoints2D(xy, there.astype(np.float64), chosen, spec.fps)
    markers = MarkerCloud(stage.markers, spec.fps, stage.labels) if stage.labels else None
    known = {name: getattr(motion, name) for name in ("betas", "global_orient", "body_pose", "transl", "joints")}
    known |= {"keypoints3d": truth.keypoints3d[chosen], "R": stage.cameras.R, "t": stage.cameras.t}
    known |= {"visibility": truth.visibility[chosen]}
    if stage.labels:
        known |= {"markers": stage.markers}
    name, footage, notes = stage.shot.name, (None,) * len(stage.cameras), (diagnostic("synthetic", origin=_ORIGIN),)
    parts = stage.cameras, keypoints, markers
    return Capture(name, *parts, footage=footage, sources=(name,), notes=notes, truth=known)


def perturbed_capture(spec: Spec, stage: Stage, truth: Truth, clean: Capture) -> Capture:
    """Add the described faults to a clean capture, and record them in its ground truth.

    The records are ``swapped`` and ``outlier`` (C, F, K), ``delay_frames`` (C,), and for markers ``marker_ghosts`` and
    ``marker_swapped`` (F, M).
    """
    capture, faults = clean, spec.perturb
    if faults.of_views:
        capture = _of_views(spec, stage, truth, capture, stage.shot.rng(spec, "views"))
    if faults.of_markers and stage.labels:
        capture = _of_markers(spec, stage, capture, stage.shot.rng(spec, "markers"))
    listed = ", ".join(f"{name} {value:g}" for name, value in sizes_of(faults).items() if value) or "nothing"
    return replace(capture, notes=(*clean.notes, diagnostic("perturbed", faults=listed)))


def _of_views(spec: Spec, stage: Stage, truth: Truth, capture: Capture, rng: np.random.Generator) -> Capture:
    faults, chosen, cameras = spec.perturb, spec.joint_set, stage.cameras
    px, points = truth.xy[chosen], truth.keypoints3d[chosen]
    if faults.anatomy_mm:
        offsets = 1e-3 * faults.anatomy_mm * rng.normal(size=(chosen.num_keypoints, 3))
        px = project(cameras, stage.person.landmarks(chosen, offsets).points)
    late = np.r_[0.0, faults.cameras.delay_frames * rng.random(len(cameras) - 1)]
    if faults.cameras.delay_frames and len(points) > 1:
        px = np.stack([delayed(track, delay) for track, delay in zip(px, late, strict=True)])
    pelvis = stage.joints[:, 0]
    direction = direction_seen_from(cameras, stage.person.orient, pelvis)
    hidden = (truth.visibility[chosen] != VISIBLE) & (truth.visibility[chosen] != OUTSIDE)
    sight = Sight(px, px_per_mm(cameras, points), direction, hidden, cameras.image_size)
    found = detect_keypoints(sight, chosen, spec.fps, faults.detector, rng)
    off_mm = faults.cameras.calibration_mm
    seen = miscalibrated(cameras, pelvis.mean(axis=0), off_mm, rng) if off_mm else cameras
    keypoints = Keypoints2D(found.xy, found.confidence, chosen, spec.fps)
    known = capture.truth | {"swapped": found.swapped, "outlier": found.outlier, "delay_frames": late}
    return replace(capture, cameras=seen, keypoints=keypoints, truth=known)


def _of_markers(spec: Spec, stage: Stage, capture: Capture, rng: np.random.Generator) -> Capture:
    faults, count = spec.perturb.markers, len(stage.labels)
    frames = stage.num_frames
    placement = 1e-3 * faults.placement_mm * rng.normal(size=(count, 3))
    points = stage.person.pose(marker_landmarks(stage.person.body, stage.labels), placement).points
    slide = float(np.exp(-1 / (spec.fps * faults.skin_s)))
    points += 1e-3 * faults.skin_mm * autoregressive((count, frames, 3), slide, rng).swapaxes(0, 1)
    points += 1e-3 * faults.measurement_mm * rng.normal(size=points.shape)
    swapped = np.zeros((frames, count), dtype=bool)
    for _ in range(rng.poisson(faults.swaps_per_minute * frames / spec.fps / 60.0)):
        first, pair = int(rng.integers(frames)), rng.choice(count, 2, replace=False)
        last = min(frames, first + max(2, round(faults.swap_s * spec.fps)))
        if not swapped[first:last, pair].any():
            points[first:last, pair] = points[first:last, pair[::-1]]
            swapped[first:last, pair] = True
    ghosts = rng.random((frames, count)) < faults.ghosts
    points = np.where(ghosts[..., None], points + faults.ghost_m * rng.normal(size=points.shape), points)
    lost = np.zeros((frames, count), dtype=bool)
    if faults.least_views:
        seen = capture.truth.get("marker_seen")
        lost |= ((marker_sight(stage) if seen is None else seen) > 0.5).sum(axis=0) < faults.least_views
    if faults.hidden:
        lost |= bursts(rng.random((count, frames)), faults.hidden, max(1.0, faults.hidden_s * spec.fps)).T
    points = np.where(lost[..., None], np.nan, points)
    truth = capture.truth | {"marker_ghosts": ghosts & ~lost, "marker_swapped": swapped & ~lost}
    return replace(capture, markers=MarkerCloud(points, spec.fps, stage.labels), truth=truth)
