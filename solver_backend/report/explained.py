"""What a reader doubted about a camera, and the solve then explained and corrected: the explanation alone stays."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace

from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.exchange.diagnostics.diagnostic import EARLIER_WARNING, Remedy
from solver_backend.io.recognition.world_check import SHIFTED
from solver_backend.people.person_selection import ELSEWHERE

EXPLANATIONS = ("image_mirrored", "sides_exchanged", "names_exchanged", "camera_turned", "camera_early", "camera_late")
"""Codes of what a solve corrects in a camera."""
MOST_FRAMES = 0.9
"""Share of the take in which a camera is corrected, from which it is explained."""
_OFF = re.compile(r"([^:,]+) by \d+ px")


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
        text = str(item.values.get("text", "")) if item.code == EARLIER_WARNING else ""
        if text.startswith(SHIFTED):
            head, _, rest = text.partition(": ")
            rest, end, tail = rest.partition(". ")
            parts = [part for part in _OFF.finditer(rest) if part[1].strip() not in explained]
            if parts:
                listed = ", ".join(part[0].strip() for part in parts)
                yield replace(item, values={**item.values, "text": f"{head}: {listed}{end}{tail}"})
        elif not (ELSEWHERE in text and any(text.startswith(f"Camera {name} {ELSEWHERE}") for name in explained)):
            yield item
