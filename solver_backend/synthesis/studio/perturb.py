"""Clean and perturbed captures of a shot: the truth, and what detectors, trackers and a poor calibration make of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.body.markers import marker_landmarks
from solver_backend.cameras.projection import project
from solver_backend.synthesis.embedded.temporal_noise import autoregressive, bursts
from solver_backend.synthesis.simulation.camera_errors import delayed, miscalibrated, px_per_mm
from solver_backend.synthesis.simulation.keypoint_detector import DetectorModel, Sight, detect_keypoints
from solver_backend.synthesis.studio.marker_sight import marker_sight
from solver_backend.synthesis.studio.perturbation import Perturbation
from solver_backend.synthesis.studio.spec import Spec
from solver_backend.synthesis.studio.stage import Stage, posed_markers
from solver_backend.synthesis.studio.truth import OUTSIDE, VISIBLE, Truth
from solver_backend.types import Capture, Keypoints2D, MarkerCloud, Motion

_GHOST_M = 0.15
_SWAP_S = 0.4


def clean_capture(spec: Spec, stage: Stage, truth: Truth, motion: Motion) -> Capture:
    """Return a capture without errors: every keypoint in the picture with confidence 1, hidden or not."""
    chosen = spec.joint_set
    there = truth.visibility[chosen] != OUTSIDE
    keypoints = Keypoints2D(
        np.where(there[..., None], truth.xy[chosen], np.nan), there.astype(np.float64), chosen, spec.fps
    )
    markers = MarkerCloud(stage.markers, spec.fps, stage.labels) if stage.labels else None
    known = {
        "betas": motion.betas, "global_orient": motion.global_orient, "body_pose": motion.body_pose,
        "transl": motion.transl, "joints": motion.joints, "keypoints3d": truth.keypoints3d[chosen],
        "R": stage.cameras.R, "t": stage.cameras.t, "visibility": truth.visibility[chosen],
    }  # fmt: skip
    if stage.labels:
        known |= {"markers": stage.markers}
    return Capture(
        stage.shot.name, stage.cameras, keypoints, markers, footage=(None,) * len(stage.cameras),
        sources=(stage.shot.name,), notes=("Synthetic capture of the studio: the truth is known.",), truth=known,
    )  # fmt: skip


def perturbed_capture(spec: Spec, stage: Stage, truth: Truth, clean: Capture) -> Capture:
    """Return the capture with the description's faults; the truth goes along as it was.

    Added truth: ``swapped`` and ``outlier`` (C, F, K), ``delay_frames`` (C,), and of markers ``marker_ghosts`` and
    ``marker_swapped`` (F, M).
    """
    capture, faults = clean, spec.perturb
    if faults.views:
        capture = _of_views(spec, stage, truth, capture, stage.shot.rng(spec, "views"))
    if faults.of_markers and stage.labels:
        capture = _of_markers(spec, stage, capture, stage.shot.rng(spec, "markers"))
    return replace(capture, notes=(*clean.notes, f"Perturbed: {_said(faults)}."))


def _of_views(spec: Spec, stage: Stage, truth: Truth, capture: Capture, rng: np.random.Generator) -> Capture:
    faults, chosen, cameras = spec.perturb, spec.joint_set, stage.cameras
    model = DetectorModel(
        view_bias_mm=faults.bias_mm, drift_mm=faults.drift_mm, jitter_mm=faults.jitter_mm, missing=faults.missing,
        occluded_missing=faults.occluded_missing, outliers=faults.outliers, swaps_per_minute=faults.swaps_per_minute,
    )  # fmt: skip
    px, points = truth.xy[chosen], truth.keypoints3d[chosen]
    if faults.anatomy_mm:
        offsets = 1e-3 * faults.anatomy_mm * rng.normal(size=(chosen.num_keypoints, 3))
        meant = stage.person.landmarks(chosen, offsets).points
        px = project(cameras.K, cameras.distortion, cameras.R, cameras.t, meant, cameras.distortion_model)
    late = np.r_[0.0, faults.delay_frames * rng.random(len(cameras) - 1)]
    if faults.delay_frames and len(points) > 1:
        px = np.stack([delayed(track, delay) for track, delay in zip(px, late, strict=True)])
    way = np.einsum("fij,cfi->cfj", stage.person.orient, cameras.centres[:, None] - stage.joints[None, :, 0])
    hidden = (truth.visibility[chosen] != VISIBLE) & (truth.visibility[chosen] != OUTSIDE)
    sight = Sight(px, px_per_mm(cameras, points), np.arctan2(way[..., 0], way[..., 2]), hidden, cameras.image_size)
    found = detect_keypoints(sight, chosen, spec.fps, model, rng)
    pelvis = stage.joints[:, 0].mean(axis=0)
    seen = miscalibrated(cameras, pelvis, faults.calibration_mm, rng) if faults.calibration_mm else cameras
    return replace(
        capture, cameras=seen, keypoints=Keypoints2D(found.xy, found.confidence, chosen, spec.fps),
        truth=capture.truth | {"swapped": found.swapped, "outlier": found.outlier, "delay_frames": late},
    )  # fmt: skip


def _of_markers(spec: Spec, stage: Stage, capture: Capture, rng: np.random.Generator) -> Capture:
    faults, count = spec.perturb, len(stage.labels)
    frames = stage.num_frames
    placement = 1e-3 * faults.placement_mm * rng.normal(size=(count, 3))
    points = posed_markers(stage.person, marker_landmarks(stage.person.body, stage.labels), placement)
    slide = float(np.exp(-1 / (spec.fps * 0.3)))
    points += 1e-3 * faults.skin_mm * autoregressive((count, frames, 3), slide, rng).swapaxes(0, 1)
    points += 1e-3 * faults.marker_mm * rng.normal(size=points.shape)
    swapped = np.zeros((frames, count), dtype=bool)
    for _ in range(rng.poisson(faults.marker_swaps_per_minute * frames / spec.fps / 60.0)):
        first, pair = int(rng.integers(frames)), rng.choice(count, 2, replace=False)
        last = min(frames, first + max(2, round(_SWAP_S * spec.fps)))
        if not swapped[first:last, pair].any():
            points[first:last, pair] = points[first:last, pair[::-1]]
            swapped[first:last, pair] = True
    ghosts = rng.random((frames, count)) < faults.ghosts
    points = np.where(ghosts[..., None], points + _GHOST_M * rng.normal(size=points.shape), points)
    lost = np.zeros((frames, count), dtype=bool)
    if faults.marker_views:
        seen = capture.truth.get("marker_seen")
        lost |= ((marker_sight(stage) if seen is None else seen) > 0.5).sum(axis=0) < faults.marker_views
    if faults.marker_gaps:
        gone = bursts(rng.random((count, frames)), faults.marker_gaps, max(1.0, 0.25 * spec.fps)).T
        lost |= gone
    points = np.where(lost[..., None], np.nan, points)
    ghosts, swapped = ghosts & ~lost, swapped & ~lost
    truth = capture.truth | {"marker_ghosts": ghosts, "marker_swapped": swapped}
    return replace(capture, markers=MarkerCloud(points, spec.fps, stage.labels), truth=truth)


def _said(faults: Perturbation) -> str:
    given = {name: getattr(faults, name) for name in Perturbation.__dataclass_fields__}
    return ", ".join(f"{name} {value:g}" for name, value in given.items() if value) or "nothing"
