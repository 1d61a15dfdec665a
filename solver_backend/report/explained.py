"""What a reader doubted about a camera, and the solve then explained and corrected: the explanation alone stays."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.exchange.diagnostics.diagnostic import Remedy

EXPLANATIONS = ("image_mirrored", "sides_exchanged", "names_exchanged", "camera_turned", "camera_early", "camera_late")
"""Codes of what a solve corrects in a camera."""
MOST_FRAMES = 0.9
"""Share of the take in which a camera is corrected, from which it is explained."""


def without_explained(found: Iterable[Diagnostic], num_frames: int) -> Iterator[Diagnostic]:
    """Yield what was found without a reader's doubts about cameras that are corrected in nearly all frames.

    Args:
        found: of the reader and of the solve.
        num_frames: of the take.
    """
    found = tuple(found)
    explained = {
        camera
        for item in found
        if item.code in EXPLANATIONS and item.remedy is Remedy.REPAIRED
        and sum(last - first + 1 for first, last in item.where.frames) >= MOST_FRAMES * num_frames
        for camera in item.where.cameras
    }  # fmt: skip
    for item in found:
        if item.code in ("cameras_shifted", "cameras_elsewhere"):
            kept = [k for k, name in enumerate(item.where.cameras) if name not in explained]
            if kept:
                cameras, shifts = item.where.cameras, list(item.values.get("shifts", ()))
                where = replace(item.where, cameras=tuple(cameras[k] for k in kept))
                yield replace(item, where=where, values={"shifts": [shifts[k] for k in kept if k < len(shifts)]})
        elif not (item.code == "camera_sees_elsewhere" and explained.intersection(item.where.cameras)):
            yield item
