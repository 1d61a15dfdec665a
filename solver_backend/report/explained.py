"""What a reader doubted about a camera, and the solve then explained and corrected: the explanation alone stays."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from solver_backend.agreement.epipolar_fit import report_focal_lengths
from solver_backend.exchange.diagnostics import Diagnostic, Remedy
from solver_backend.types import Capture

EXPLANATIONS = ("image_mirrored", "sides_exchanged", "names_exchanged", "camera_turned", "camera_late")
"""Codes of what a solve corrects in a camera."""
MOST_FRAMES = 0.9
"""Share of the take in which a camera is corrected, from which it is explained."""
LEAST_OTHERS = 3
"""Other cameras from which a shift of one of them is seen without the one that is corrected."""


def without_explained(
    found: Iterable[Diagnostic], num_frames: int, capture: Capture | None = None
) -> Iterator[Diagnostic]:
    """Yield what was found without a reader's doubts about cameras that are corrected in nearly all frames.

    What was doubted of the others by comparison with such a camera is left out as well: shifts of two that are left,
    and all focal lengths, which are compared anew.

    Args:
        found: of the reader and of the solve.
        num_frames: of the take.
        capture: what was solved.
    """
    found = tuple(found)
    explained = {
        camera
        for item in found
        if item.code in EXPLANATIONS and item.remedy is Remedy.REPAIRED
        and sum(last - first + 1 for first, last in item.where.frames) >= MOST_FRAMES * num_frames
        for camera in item.where.cameras
    }  # fmt: skip
    others = _others(capture, explained)
    for item in found:
        if item.code == "focal_lengths_off" and others is not None:
            yield from _focal_lengths(capture, others)
        elif (
            item.code in ("cameras_shifted", "cameras_elsewhere") and others is not None and len(others) < LEAST_OTHERS
        ):
            continue
        elif item.code in ("cameras_shifted", "cameras_elsewhere"):
            kept = [k for k, name in enumerate(item.where.cameras) if name not in explained]
            if kept:
                cameras, shifts = item.where.cameras, list(item.values.get("shifts", ()))
                where = replace(item.where, cameras=tuple(cameras[k] for k in kept))
                yield replace(item, where=where, values={"shifts": [shifts[k] for k in kept if k < len(shifts)]})
        elif not (item.code == "camera_sees_elsewhere" and explained.intersection(item.where.cameras)):
            yield item


def _others(capture: Capture | None, explained: set[str]) -> list[int] | None:
    """Return the cameras that nothing explains, None where none is explained."""
    if capture is None or capture.cameras is None or not explained:
        return None
    return [c for c, name in enumerate(capture.cameras.names) if name not in explained]


def _focal_lengths(capture: Capture | None, chosen: list[int]) -> tuple[Diagnostic, ...]:
    if capture is None or capture.cameras is None or capture.keypoints is None or len(chosen) < 2:
        return ()
    return report_focal_lengths(capture.cameras.subset(chosen), capture.keypoints.views(chosen))
