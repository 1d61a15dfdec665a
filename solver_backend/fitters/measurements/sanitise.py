"""A capture examined before it is solved: faults of its views are found, repaired where that is sure, and named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.agreement.bystanders import exclude_bystanders
from solver_backend.agreement.label_swaps import undo_swaps
from solver_backend.agreement.repeated_frames import LEAST_REPEATED, repeated_frames, skipped_frames, without_repeats
from solver_backend.agreement.synchronisation import LEAST_FRAMES, estimate_delays, synchronised
from solver_backend.agreement.view_faults import Mirrored, NamedLike, ViewFault, exclude_views, repair_views
from solver_backend.cameras.robust_triangulation import Triangulation, triangulate
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic, merge, sentence
from solver_backend.exchange.errors import NotSynchronised
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SYNC_AUTO, SYNC_OFF, SYNC_ON
from solver_backend.fitters.layers import seen_frames
from solver_backend.geometry.arrays import true_runs
from solver_backend.types import Cameras, Capture, Keypoints2D

STAGE = "Checking the cameras"
STEPS = 5
LEAST_DELAY_FRAMES = 0.3
"""Smaller delays are not worth a word ..."""
LEAST_DELAY_SIGMAS = 8.0
"""... nor those that are not sure: a detector's errors last longer than the deviation allows for."""
_UNKNOWN = ("delay_unknown", "delay_beyond")
"""What is not confirmed where synchronisation is required."""
AWAY_S = 0.25
"""Shorter absences are not named, only bridged and flagged."""


@dataclass(frozen=True)
class CheckedCapture:
    """A capture with its faults repaired or left out."""

    capture: Capture
    """What is to be solved."""
    triangulation: Triangulation
    """Of that capture."""
    diagnostics: tuple[Diagnostic, ...]
    """What was found, by first frame."""


def check_capture(
    capture: Capture,
    triangulation: Triangulation,
    progress: Progress,
    *,
    estimate_sync: bool = False,
    sync: str = SYNC_AUTO,
) -> CheckedCapture:
    """Find faults of single views and repair them.

    Frames that are shown twice first, then whole views (names, mirrored, turned), then time, then passers-by and limbs,
    and what is still wrong is left out.

    Args:
        capture: as it was read.
        triangulation: of that capture.
        estimate_sync: where some camera is late, move the others by their delays too, however small.
        sync: "off" moves no camera in time; see ``SolveSettings``.

    Raises:
        NotSynchronised: it is "on", and delays cannot be estimated.
    """
    cameras, keypoints = capture.require_multiview()
    progress(STAGE, 0, STEPS)
    again, skipped = repeated_frames(keypoints), skipped_frames(keypoints)
    if again.any() or skipped.any():
        keypoints = without_repeats(keypoints, again | skipped)
        triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence)
    views = repair_views(cameras, keypoints, triangulation)
    progress(STAGE, 1, STEPS)
    timed, triangulation, late = views.keypoints, views.triangulation, list[Diagnostic]()
    if sync != SYNC_OFF:
        others = _others(capture, again | skipped, views.found)
        timed, triangulation, late = _in_time(cameras, timed, triangulation, others, estimate_sync, progress)
    if sync == SYNC_ON and (unknown := [item for item in late if item.code in _UNKNOWN]):
        raise NotSynchronised(
            sentence(unknown[0]),
            where=capture.name,
            hint="Pass --sync auto to solve it as it is, or --sync off.",
        )
    progress(STAGE, 2, STEPS)
    alone = exclude_bystanders(cameras, timed, triangulation)
    progress(STAGE, 3, STEPS)
    sides = undo_swaps(cameras, alone.keypoints, alone.triangulation)
    progress(STAGE, 4, STEPS)
    rest = exclude_views(cameras, sides.keypoints, sides.triangulation)
    progress(STAGE, 5, STEPS)
    found = [_diagnose_view(cameras, fault) for fault in views.found] + late + _repetitions(cameras, again, skipped)
    for swap in sides.found:
        where = {"cameras": [cameras.names[swap.view]], "frames": [(swap.first, swap.last)]}
        found.append(diagnostic("limbs_exchanged", **where, remedy=Remedy.REPAIRED, part=swap.limb, gain=swap.gain))
    for excluded in alone.found + rest.found:
        where = {"cameras": [cameras.names[excluded.view]], "frames": [(excluded.first, excluded.last)]}
        found.append(diagnostic("contradicts", **where, remedy=Remedy.EXCLUDED))
    found += _absences(seen_frames(rest.triangulation.points), keypoints.fps)
    found.sort(key=lambda item: (item.where.frames, item.where.cameras, item.code))
    return CheckedCapture(replace(capture, keypoints=rest.keypoints), rest.triangulation, merge(found))


def _others(capture: Capture, repeated: np.ndarray, faults: Sequence[ViewFault]) -> list[Keypoints2D]:
    """Return the detections of everybody else with the faults of whole views undone, in the views that take part."""
    cameras, chosen = capture.require_multiview()
    seeing = (chosen.confidence > 0).any(axis=(1, 2))[:, None, None]
    others: list[Keypoints2D] = []
    for person in capture.people:
        if person.name != capture.person:
            keypoints = replace(person.keypoints, confidence=np.where(seeing, person.keypoints.confidence, 0.0))
            keypoints = without_repeats(keypoints, repeated) if repeated.any() else keypoints
            for fault in faults:
                keypoints = fault.explanation.undone(cameras, keypoints, fault.view_range)
            others.append(keypoints)
    return others


def _in_time(
    cameras: Cameras,
    keypoints: Keypoints2D,
    triangulation: Triangulation,
    others: Sequence[Keypoints2D],
    every: bool,
    progress: Progress,
) -> tuple[Keypoints2D, Triangulation, list[Diagnostic]]:
    """Return the detections, those of late (or all) cameras moved, their triangulation, and what is late or unknown."""
    delays = estimate_delays(cameras, keypoints, triangulation, others, progress)
    late = np.abs(delays.frames) >= np.maximum(LEAST_DELAY_FRAMES, LEAST_DELAY_SIGMAS * delays.sigma)
    drifting = np.nan_to_num(delays.drift) != 0
    moved = late | drifting
    last = keypoints.num_frames - 1

    whole = [(0, last)]

    def diagnose(code: str, which: np.ndarray, size: np.ndarray, **more: str) -> list[Diagnostic]:
        repaired: dict[str, Any] = {"frames": whole, "remedy": Remedy.REPAIRED, **more}
        return [
            diagnostic(code, cameras=[cameras.names[v]], size=abs(size[v]), **repaired) for v in np.flatnonzero(which)
        ]

    seeing = (keypoints.confidence > 0).any(axis=(1, 2))
    unknown = np.isnan(delays.frames) & seeing & ~delays.beyond & (keypoints.num_frames >= LEAST_FRAMES)
    found = [
        diagnostic("delay_beyond", cameras=[cameras.names[v]], frames=whole)
        for v in np.flatnonzero(delays.beyond & seeing)
    ]
    for direction, sign in (("late", 1), ("early", -1)):
        which = late & ~drifting & (sign * delays.frames > 0)
        found += diagnose("camera_late", which, delays.frames, direction=direction)
    found += diagnose("rate_differs", drifting, 2 * delays.drift)
    if unknown[seeing].all() and unknown.any():
        found.append(diagnostic("delay_unknown", extent="all", frames=whole))
    else:
        names = [cameras.names[v] for v in np.flatnonzero(unknown)]
        found += [diagnostic("delay_unknown", extent="camera", cameras=[name], frames=whole) for name in names]
    if moved.any():
        moving = moved | every
        keypoints = synchronised(keypoints, np.where(moving[:, None], np.nan_to_num(delays.at(last + 1)), 0.0))
        triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence)
    return keypoints, triangulation, found


def _diagnose_view(cameras: Cameras, fault: ViewFault) -> Diagnostic:
    """Return what was found of a view that was repaired."""
    names, cause = [cameras.names[fault.view_range.view]], fault.explanation
    frames = [(fault.view_range.first, fault.view_range.last)]
    if isinstance(cause, Mirrored):
        code = "image_mirrored" if cause.image else "sides_exchanged"
        return diagnostic(code, cameras=names, frames=frames, remedy=Remedy.REPAIRED)
    if isinstance(cause, NamedLike):
        names.append(cameras.names[cause.other])
        return diagnostic("names_exchanged", cameras=names, frames=frames, remedy=Remedy.REPAIRED)
    return diagnostic("camera_turned", cameras=names, frames=frames, remedy=Remedy.REPAIRED, size=cause.degrees)


def _repetitions(cameras: Cameras, again: np.ndarray, skipped: np.ndarray) -> list[Diagnostic]:
    """Return the views that repeat frames (C, F) often enough to be named, and the frames (F,) that all skip."""
    share, where = 100.0 * again.mean(axis=1), {"frames": [(0, len(skipped) - 1)], "remedy": Remedy.BRIDGED}
    repeating = np.flatnonzero(share >= LEAST_REPEATED)
    found = [diagnostic("frames_repeated", cameras=[cameras.names[v]], **where, size=share[v]) for v in repeating]
    return found + [diagnostic("frames_skipped", **where, size=100.0 * skipped.mean())] * bool(skipped.any())


def _absences(seen: np.ndarray, fps: float) -> list[Diagnostic]:
    """Return the stretches in which no two cameras see the person."""
    runs = [run for run in true_runs(~seen) if run[1] - run[0] + 1 >= AWAY_S * fps]
    return [diagnostic("person_away", frames=[run], remedy=Remedy.BRIDGED) for run in runs]
