"""A capture examined before it is solved: faults of its views are found, repaired where that is sure, and named."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.cameras.triangulation.triangulate import Triangulation, triangulate
from solver_backend.cameras.view_checks.label_swaps import undo_swaps
from solver_backend.cameras.view_checks.repeated_frames import repeated_frames, skipped_frames, without_repeats
from solver_backend.cameras.view_checks.synchronisation import LEAST_FRAMES, estimate_delays, synchronised
from solver_backend.cameras.view_checks.view_faults import Mirrored, NamedLike
from solver_backend.cameras.view_checks.view_repair import ViewFault, exclude_views, repair_views
from solver_backend.exchange.progress import Progress
from solver_backend.fitters.measurements.base import seen_frames
from solver_backend.geometry.runs import true_runs
from solver_backend.people.bystanders import exclude_bystanders
from solver_backend.types import Cameras, Capture, Fault, FaultKind, Keypoints2D, Remedy

STAGE = "Checking the cameras"
STEPS = 5
LEAST_DELAY_FRAMES = 0.3
"""Smaller delays are not worth a word ..."""
LEAST_DELAY_SIGMAS = 8.0
"""... nor those that are not sure: a detector errs alike for longer than the deviation knows."""
LEAST_REPEATED = 1.0
"""Per cent of a view's frames that are shown again; fewer are bridged without a word."""
AWAY_S = 0.25
"""Shorter absences are not named, only bridged and flagged."""


@dataclass(frozen=True)
class CheckedCapture:
    """A capture with its faults repaired or left out."""

    capture: Capture
    """What is to be solved."""
    triangulation: Triangulation
    """Of that capture."""
    faults: tuple[Fault, ...]
    """What was found, by first frame."""


def check_capture(
    capture: Capture, triangulation: Triangulation, progress: Progress, *, estimate_sync: bool = False
) -> CheckedCapture:
    """Find faults of single views and repair them.

    Frames that are shown twice first, then whole views (names, mirrored, turned), then time, then passers-by and limbs,
    and what is still wrong is left out.

    Args:
        capture: as it was read.
        triangulation: of that capture.
        progress: called as the checks advance.
        estimate_sync: where some camera is late, move the others by their delays too, however small.
    """
    cameras, keypoints = capture.require_multiview()
    progress(STAGE, 0, STEPS)
    again, skipped = repeated_frames(keypoints), skipped_frames(keypoints)
    if again.any() or skipped.any():
        keypoints = without_repeats(keypoints, again | skipped)
        triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence)
    views = repair_views(cameras, keypoints, triangulation)
    progress(STAGE, 1, STEPS)
    timed, triangulation, late = _in_time(cameras, views.keypoints, views.triangulation, estimate_sync)
    progress(STAGE, 2, STEPS)
    alone = exclude_bystanders(cameras, timed, triangulation)
    progress(STAGE, 3, STEPS)
    sides = undo_swaps(cameras, alone.keypoints, alone.triangulation)
    progress(STAGE, 4, STEPS)
    rest = exclude_views(cameras, sides.keypoints, sides.triangulation)
    progress(STAGE, 5, STEPS)
    faults = [_fault_of(cameras, fault) for fault in views.found] + late + _repetitions(cameras, again, skipped)
    for swap in sides.found:
        where = cameras.names[swap.view], swap.first, swap.last
        faults.append(Fault(FaultKind.LIMBS_EXCHANGED, *where, round(swap.gain, 1), Remedy.REPAIRED, swap.limb))
    for excluded in alone.found + rest.found:
        where = cameras.names[excluded.view], excluded.first, excluded.last
        faults.append(Fault(FaultKind.CONTRADICTS, *where, 0.0, Remedy.EXCLUDED))
    faults += _absences(seen_frames(rest.triangulation.points), keypoints.fps)
    faults.sort(key=lambda fault: (fault.first, fault.camera, fault.kind))
    return CheckedCapture(replace(capture, keypoints=rest.keypoints), rest.triangulation, tuple(faults))


def _in_time(
    cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation, every: bool
) -> tuple[Keypoints2D, Triangulation, list[Fault]]:
    """Return the detections, those of late (or all) cameras moved, their triangulation, and what is late or unknown."""
    delays = estimate_delays(cameras, keypoints, triangulation)
    late = np.abs(delays.frames) >= np.maximum(LEAST_DELAY_FRAMES, LEAST_DELAY_SIGMAS * delays.sigma)
    drifting = np.nan_to_num(delays.drift) != 0
    moved = late | drifting
    last = keypoints.num_frames - 1

    def faults(kind: FaultKind, which: np.ndarray, figures: np.ndarray, remedy: Remedy) -> list[Fault]:
        return [
            Fault(kind, cameras.names[v], 0, last, round(float(figures[v]), 2), remedy) for v in np.flatnonzero(which)
        ]

    seeing = (keypoints.confidence > 0).any(axis=(1, 2))
    unknown = np.isnan(delays.frames) & seeing & (keypoints.num_frames >= LEAST_FRAMES)
    found = faults(FaultKind.UNSYNCHRONISED, late & ~drifting, delays.frames, Remedy.REPAIRED)
    found += faults(FaultKind.RATE_DIFFERS, drifting, 2 * delays.drift, Remedy.REPAIRED)
    if unknown[seeing].all():
        found.append(Fault(FaultKind.DELAY_UNKNOWN, "", 0, last, 0.0, Remedy.REPORTED))
    else:
        found += faults(FaultKind.DELAY_UNKNOWN, unknown, np.zeros(len(cameras)), Remedy.REPORTED)
    if moved.any():
        moving = moved | every
        keypoints = synchronised(keypoints, np.where(moving[:, None], np.nan_to_num(delays.at(last + 1)), 0.0))
        triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence)
    return keypoints, triangulation, found


def _fault_of(cameras: Cameras, fault: ViewFault) -> Fault:
    """Return what is said about a view that was repaired."""
    where = cameras.names[fault.view_range.view], fault.view_range.first, fault.view_range.last
    cause = fault.explanation
    if isinstance(cause, Mirrored):
        kind = FaultKind.IMAGE_MIRRORED if cause.image else FaultKind.SIDES_EXCHANGED
        return Fault(kind, *where, 0.0, Remedy.REPAIRED)
    if isinstance(cause, NamedLike):
        return Fault(FaultKind.NAMES_EXCHANGED, *where, 0.0, Remedy.REPAIRED, cameras.names[cause.other])
    return Fault(FaultKind.CAMERA_TURNED, *where, round(cause.degrees, 2), Remedy.REPAIRED)


def _repetitions(cameras: Cameras, again: np.ndarray, skipped: np.ndarray) -> list[Fault]:
    """Return the views that repeat frames (C, F) often enough to be named, and the frames (F,) that all skip."""
    share, last = 100.0 * again.mean(axis=1), len(skipped) - 1
    faults = [(FaultKind.FRAMES_REPEATED, cameras.names[v], share[v]) for v in np.flatnonzero(share >= LEAST_REPEATED)]
    faults += [(FaultKind.FRAMES_SKIPPED, "", 100.0 * skipped.mean())] * bool(skipped.any())
    return [Fault(kind, camera, 0, last, round(float(size), 1), Remedy.BRIDGED) for kind, camera, size in faults]


def _absences(seen: np.ndarray, fps: float) -> list[Fault]:
    """Return the stretches in which no two cameras see the person."""
    return [
        Fault(FaultKind.PERSON_AWAY, "", first, last, 0.0, Remedy.BRIDGED)
        for first, last in true_runs(~seen)
        if last - first + 1 >= AWAY_S * fps
    ]
