"""Views, or stretches of them, that somebody leaves out of a solve by hand."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from solver_backend.exchange.errors import JobInvalid, TooFewViews
from solver_backend.types import Capture

_FORM = re.compile(r"(?P<camera>.+?)(?::(?P<first>\d+)-(?P<last>\d+))?")


@dataclass(frozen=True)
class LeftOut:
    """A view that takes no part, in some frames or in all."""

    camera: str
    """Name of the camera."""
    first: int | None = None
    """First frame, from 0; None for the whole take."""
    last: int | None = None
    """Last frame, included."""

    @classmethod
    def parse(cls, text: str) -> LeftOut:
        """Return what ``CAMERA`` or ``CAMERA:FIRST-LAST`` means.

        Raises:
            JobInvalid: it means nothing, or ends before it begins.
        """
        found = _FORM.fullmatch(text)
        ends = (None, None) if found is None or found["first"] is None else (int(found["first"]), int(found["last"]))
        if found is None or (ends[0] is not None and ends[1] is not None and ends[0] > ends[1]):
            raise JobInvalid(
                f"'{text}' names no view to be left out.", where="leave_out", hint="Write CAMERA or CAMERA:FIRST-LAST."
            )
        return cls(found["camera"], *ends)


def without_views(capture: Capture, texts: Sequence[str]) -> Capture:
    """Return a capture in which views take no part where they are to be left out.

    Args:
        capture: calibrated cameras and keypoints.
        texts: each ``CAMERA`` or ``CAMERA:FIRST-LAST``, frames from 0.

    Raises:
        JobInvalid: a text means nothing, there is no such camera, or its frames lie beyond the take.
        TooFewViews: fewer than two cameras are left.
    """
    if not texts:
        return capture
    cameras, keypoints = capture.require_multiview()
    confidence = keypoints.confidence.copy()
    for text in texts:
        item = LeftOut.parse(text)
        if item.camera not in cameras.names:
            raise JobInvalid(
                f"There is no camera '{item.camera}' to be left out.", where="leave_out",
                hint=f"Cameras: {', '.join(cameras.names)}.",
            )  # fmt: skip
        if item.first is not None and item.first >= keypoints.num_frames:
            raise JobInvalid(f"'{text}' lies beyond the take of {keypoints.num_frames} frames.", where="leave_out")
        stop = None if item.last is None else item.last + 1
        confidence[cameras.names.index(item.camera), item.first : stop] = 0.0
    if (confidence > 0).any(axis=(1, 2)).sum() < 2:
        raise TooFewViews(
            "Fewer than two cameras with detections are left.", where=capture.name, hint="Leave fewer cameras out."
        )
    return replace(capture, keypoints=replace(keypoints, confidence=confidence))
