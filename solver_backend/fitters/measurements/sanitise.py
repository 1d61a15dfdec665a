"""Checks of a capture before it is solved: faults of views are found, repaired where that is sure, and reported."""

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
from solver_backend.fitters.problem import seen_frames
from solver_backend.geometry.arrays import true_runs
from solver_backend.types import Cameras, Capture, Keypoints2D

STAGE = "Checking the cameras"
STEPS = 5
LEAST_DELAY_FRAMES, LEAST_DELAY_SIGMAS = 0.3, 8.0
"""Least delay that is reported, in frames and in deviations: a detector's errors last longer than these allow for."""
_UNKNOWN = ("delay_unknown", "delay_beyond")  # Diagnostics that refuse a capture where synchronisation is required.
AWAY_S = 0.25  # Least absence that is reported. Shorter ones are only interpolated and flagged.


@dataclass(frozen=True)
class CheckedCapture:
    """A capture with its faults repaired or left out, its triangulation, and the diagnostics by first frame."""

    capture: Capture
    triangulation: Triangulation
    diagnostics: tuple[Diagnostic, ...]


def check_capture(
    capture: Capture,
    triangulation: Triangulation,
    progress: Progress,
    *,
    estimate_sync: bool = False,
    sync: str = SYNC_AUTO,
) -> CheckedCapture:
    """Find faults of single views and repair them.

    Repeated frames come first, then whole views (names, mirrored, turned), time, passers-by and limbs. Remaining faults
    are excluded.

    Args:
        triangulation: of the capture as it was read.
        estimate_sync: where some camera is late, move the others by their delays too, however small.
        sync: "off" moves no camera in time (see ``SolveSettings``).

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
        hint = "Pass --sync auto to solve it as it is, or --sync off."
        raise NotSynchronised(sentence(unknown[0]), where=capture.name, hint=hint)
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
    away = true_runs(~seen_frames(rest.triangulation.points))
    away = [run for run in away if run[1] - run[0] + 1 >= AWAY_S * keypoints.fps]
    found += [diagnostic("person_away", frames=[run], remedy=Remedy.BRIDGED) for run in away]
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
    """Return the detections with late (or all) cameras moved, their triangulation, and diagnostics."""
    delays = estimate_delays(cameras, keypoints, triangulation, others, progress)
    late = np.abs(delays.frames) >= np.maximum(LEAST_DELAY_FRAMES, LEAST_DELAY_SIGMAS * delays.sigma)
    drifting = np.nan_to_num(delays.drift) != 0
    moved, count = late | drifting, keypoints.num_frames
    whole, found = [(0, count - 1)], list[Diagnostic]()

    def diagnose(code: str, which: np.ndarray, **more: Any) -> None:
        for view in np.flatnonzero(which):
            values = {key: abs(value[view]) if key == "size" else value for key, value in more.items()}
            found.append(diagnostic(code, cameras=[cameras.names[view]], frames=whole, **values))

    seeing = (keypoints.confidence > 0).any(axis=(1, 2))
    unknown = np.isnan(delays.frames) & seeing & ~delays.beyond & (count >= LEAST_FRAMES)
    diagnose("delay_beyond", delays.beyond & seeing)
    for direction, sign in (("late", 1), ("early", -1)):
        which = late & ~drifting & (sign * delays.frames > 0)
        diagnose("camera_late", which, size=delays.frames, remedy=Remedy.REPAIRED, direction=direction)
    diagnose("rate_differs", drifting, size=2 * delays.drift, remedy=Remedy.REPAIRED)
    if unknown[seeing].all() and unknown.any():
        found.append(diagnostic("delay_unknown", extent="all", frames=whole))
    else:
        diagnose("delay_unknown", unknown, extent="camera")
    if moved.any():
        moving = moved | every
        keypoints = synchronised(keypoints, np.where(moving[:, None], np.nan_to_num(delays.at(count)), 0.0))
        triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence)
    return keypoints, triangulation, found


def _diagnose_view(cameras: Cameras, fault: ViewFault) -> Diagnostic:
    names, cause = [cameras.names[fault.view_range.view]], fault.explanation
    more: dict[str, Any] = {}
    if isinstance(cause, Mirrored):
        code = "image_mirrored" if cause.image else "sides_exchanged"
    elif isinstance(cause, NamedLike):
        code = "names_exchanged"
        names.append(cameras.names[cause.other])
    else:
        code, more = "camera_turned", {"size": cause.degrees}
    frames = [(fault.view_range.first, fault.view_range.last)]
    return diagnostic(code, cameras=names, frames=frames, remedy=Remedy.REPAIRED, **more)


def _repetitions(cameras: Cameras, again: np.ndarray, skipped: np.ndarray) -> list[Diagnostic]:
    """Return the diagnostics of views that repeat frames (C, F) often, and of frames (F,) that all skip."""
    share, where = 100.0 * again.mean(axis=1), {"frames": [(0, len(skipped) - 1)], "remedy": Remedy.BRIDGED}
    repeating = np.flatnonzero(share >= LEAST_REPEATED)
    found = [diagnostic("frames_repeated", cameras=[cameras.names[v]], **where, size=share[v]) for v in repeating]
    return found + [diagnostic("frames_skipped", **where, size=100.0 * skipped.mean())] * bool(skipped.any())
