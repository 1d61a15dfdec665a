"""Find faults of single views before a solve. Repair them, or exclude the views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.agreement.hypotheses import diagnose_views
from solver_backend.agreement.reading import ENOUGH, limb_keypoints
from solver_backend.agreement.repeated_frames import (
    LEAST_REPEATED,
    filled_frames,
    repeated_frames,
    skipped_frames,
    without_repeats,
)
from solver_backend.agreement.synchronisation import estimate_delays, reach_frames, synchronised
from solver_backend.agreement.view_faults import (
    BRIEF_S,
    ViewFault,
    exclude_bystanders,
    repair_views,
    turned_by,
    undo_swaps,
    without_faults,
)
from solver_backend.cameras.robust_triangulation import Triangulation, triangulate
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, Severity, diagnostic, merge, sentence
from solver_backend.exchange.errors import NotSynchronised
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SYNC_AUTO, SYNC_OFF, SYNC_ON
from solver_backend.fitters.problem import seen_frames
from solver_backend.geometry.arrays import true_runs
from solver_backend.types import Cameras, Capture, Keypoints2D

STAGE = "Checking the cameras"


@dataclass(frozen=True)
class CheckedCapture:
    """Capture with its faults repaired, its triangulation, and its diagnostics."""

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
    """Repair faults of single views: repeated frames, wrong conventions, delays, bystanders and exchanged limbs.

    Detections of bystanders and in unrelated views are excluded.

    Args:
        triangulation: triangulation of the capture without repairs.
        estimate_sync: also correct the small delays of other cameras if one camera is late.
        sync: "off" corrects no delays (see ``SolveSettings``).

    Raises:
        NotSynchronised: ``sync`` is "on", and a delay cannot be estimated.
    """
    steps = 4
    cameras, keypoints = capture.require_multiview()
    progress(STAGE, 0, steps)
    again, skipped, filled = (find(keypoints) for find in (repeated_frames, skipped_frames, filled_frames))
    sound = (keypoints.confidence > 0).any(-1) & ~filled
    replaced = filled & (sound.sum(0) >= 2)  # others show where the person was
    lost = again | skipped | replaced
    if lost.any():
        keypoints = without_repeats(keypoints, lost)
        triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence)
    views = repair_views(cameras, keypoints, triangulation)
    progress(STAGE, 1, steps)
    timed, triangulation, late = views.keypoints, views.triangulation, list[Diagnostic]()
    if sync != SYNC_OFF:
        others = _others(capture, lost, views.found)
        timed, triangulation, late = _in_time(cameras, timed, triangulation, others, estimate_sync, progress)
    if sync == SYNC_ON and (unknown := [item for item in late if item.code in ("delay_unknown", "delay_beyond")]):
        hint = "To solve the take anyway, use --sync auto or --sync off."
        raise NotSynchronised(sentence(unknown[0]), where=capture.name, hint=hint)
    progress(STAGE, 2, steps)
    alone = exclude_bystanders(cameras, timed, triangulation)
    progress(STAGE, 3, steps)
    sides = undo_swaps(cameras, alone.keypoints, alone.triangulation)
    progress(STAGE, 4, steps)
    found = [item for fault in views.found for item in _faults(cameras, fault)]
    found += late + _alterations(cameras, again, skipped, filled, replaced)
    for swap in sides.found:
        where = {"cameras": [cameras.names[swap.view]], "frames": [(swap.first, swap.last)]}
        found.append(diagnostic("limbs_exchanged", **where, remedy=Remedy.REPAIRED, part=swap.limb, gain=swap.gain))
    for excluded in alone.found:
        where = {"cameras": [cameras.names[excluded.view]], "frames": [(excluded.first, excluded.last)]}
        found.append(diagnostic("contradicts", **where, remedy=Remedy.EXCLUDED))
    away = true_runs(~seen_frames(sides.triangulation.points))
    away = [run for run in away if run[1] - run[0] + 1 >= BRIEF_S * keypoints.fps]
    found += [diagnostic("person_away", frames=[run], remedy=Remedy.BRIDGED) for run in away]
    found.sort(key=lambda item: (item.where.frames, item.where.cameras, item.code))
    return CheckedCapture(replace(capture, keypoints=sides.keypoints), sides.triangulation, merge(found))


def _others(capture: Capture, repeated: np.ndarray, faults: Sequence[ViewFault]) -> list[Keypoints2D]:
    cameras, chosen = capture.require_multiview()
    seeing = (chosen.confidence > 0).any(axis=(1, 2))[:, None, None]
    others: list[Keypoints2D] = []
    for person in capture.people:
        if person.name != capture.person:
            keypoints = replace(person.keypoints, confidence=np.where(seeing, person.keypoints.confidence, 0.0))
            keypoints = without_repeats(keypoints, repeated) if repeated.any() else keypoints
            for fault in faults:
                keypoints = without_faults(cameras, keypoints, fault.reading, fault.frames)
            others.append(keypoints)
    return others


def _in_time(
    cameras: Cameras, keypoints: Keypoints2D, triangulation: Triangulation, others: Sequence[Keypoints2D], every: bool,
    progress: Progress,
) -> tuple[Keypoints2D, Triangulation, list[Diagnostic]]:  # fmt: skip
    reach = min(reach_frames(keypoints.fps), keypoints.num_frames // 3)
    limbs = limb_keypoints(keypoints.joint_set)
    xy = np.concatenate([person.xy[:, :, limbs] for person in (keypoints, *others)], axis=2)
    delays = estimate_delays(cameras, xy, reach, progress=progress)
    drifting = np.nan_to_num(delays.drift) != 0
    moved, count = delays.moved, keypoints.num_frames
    whole, found = [(0, count - 1)], list[Diagnostic]()

    def diagnose(code: str, which: np.ndarray, **more: Any) -> None:
        for view in np.flatnonzero(which):
            values = {name: each[view].item() if isinstance(each, np.ndarray) else each for name, each in more.items()}
            values |= {"size": abs(values["size"])} if "size" in values else {}
            found.append(diagnostic(code, cameras=[cameras.names[view]], frames=whole, **values))

    seeing = (keypoints.confidence > 0).any(axis=(1, 2))
    unknown = np.isnan(delays.frames) & seeing & ~delays.beyond & (count >= ENOUGH)
    diagnose("delay_beyond", delays.beyond & seeing)
    for direction, sign in (("late", 1), ("early", -1)):
        which = moved & ~drifting & (sign * delays.frames > 0)
        diagnose("camera_late", which, size=delays.frames, remedy=Remedy.REPAIRED, direction=direction)
    diagnose("rate_differs", drifting, size=2 * delays.drift, remedy=Remedy.REPAIRED)
    seen = (keypoints.confidence > 0).any(axis=2).sum(axis=1)
    together = int(((keypoints.confidence > 0).any(axis=2).sum(axis=0) > 1).sum())
    brief = seeing & ((2 * seen < seen.max()) | (together < ENOUGH))
    told = {"severity": Severity.WARNING, "extent": "camera", "reason": "brief"}
    diagnose("delay_unknown", unknown & brief, count=seen, of=count, **told)
    seeing &= ~brief
    unknown &= seeing & (seeing.sum() > 1)  # what only brief views are compared with is not at fault
    low, high = delays.possible.T
    if unknown[seeing].all() and unknown.any():
        low, high = float(low[seeing].min()), float(high[seeing].max())
        reason = "still" if min(-low, high) >= reach else "open"
        found.append(diagnostic("delay_unknown", extent="all", reason=reason, frames=whole, low=low, high=high))
    else:
        reasons = np.where(np.minimum(-low, high) >= reach, "still", "open")
        diagnose("delay_unknown", unknown, extent="camera", reason=reasons, low=low, high=high)
    if moved.any():
        moving = moved | every
        keypoints = synchronised(keypoints, np.where(moving[:, None], np.nan_to_num(delays.at(count)), 0.0))
        triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence)
    return keypoints, triangulation, found


def _faults(cameras: Cameras, fault: ViewFault) -> list[Diagnostic]:
    where: dict[str, Any] = {"frames": [(fault.first, fault.last)], "remedy": Remedy.REPAIRED}
    found = list[Diagnostic]()
    for view, name in enumerate(cameras.names):
        if (turn := turned_by(cameras, fault.reading, view)) is not None:
            size = float(np.degrees(np.linalg.norm(turn)))
            found.append(diagnostic("camera_turned", cameras=[name], size=size, **where))
    in_place = replace(fault.reading, moved=(None,) * len(cameras))
    return found + diagnose_views(in_place, cameras.names, **where)


def _alterations(
    cameras: Cameras, again: np.ndarray, skipped: np.ndarray, filled: np.ndarray, replaced: np.ndarray
) -> list[Diagnostic]:
    whole, found = [(0, len(skipped) - 1)], list[Diagnostic]()
    for view, name in enumerate(cameras.names):
        where: dict[str, Any] = {"cameras": [name], "frames": whole}
        if (share := 100.0 * again[view].mean()) >= LEAST_REPEATED:
            found.append(diagnostic("frames_repeated", **where, remedy=Remedy.BRIDGED, size=share))
        for some, remedy in ((replaced, Remedy.EXCLUDED), (filled & ~replaced, Remedy.REPORTED)):
            if runs := true_runs(some[view]):
                where |= {"frames": runs, "remedy": remedy, "size": 100.0 * some[view].mean()}
                found.append(diagnostic("detections_altered", **where, kind="filled"))
    where = {"frames": whole, "remedy": Remedy.BRIDGED, "size": 100.0 * skipped.mean()}
    return found + [diagnostic("detections_altered", **where, kind="skipped")] * bool(skipped.any())
