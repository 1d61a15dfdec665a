"""Views, or stretches of them, that somebody leaves out of a solve by hand."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.exchange.errors import JobInvalid, TooFewViews
from solver_backend.types import Capture
from solver_backend.types.shapes import Bool

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
        TooFewViews: no camera is left.
    """
    if not texts:
        return capture
    cameras, keypoints = capture.require_views()
    out = left_out_views(texts, cameras.names, keypoints.num_frames)
    confidence = np.where(out[..., None], 0.0, keypoints.confidence)
    if not (confidence > 0).any():
        raise TooFewViews("No camera with detections is left.", where=capture.name, hint="Keep more cameras.")
    return replace(capture, keypoints=replace(keypoints, confidence=confidence))


def left_out_views(texts: Sequence[str], names: Sequence[str], frames: int) -> Bool[np.ndarray, "views frames"]:
    """Return (C, F) which views of which frames are left out.

    Args:
        texts: each ``CAMERA`` or ``CAMERA:FIRST-LAST``, frames from 0.
        names: of C cameras.
        frames: of the take.

    Raises:
        JobInvalid: a text means nothing, there is no such camera, or its frames lie beyond the take.
    """
    out = np.zeros((len(names), frames), bool)
    for text in texts:
        item = LeftOut.parse(text)
        if item.camera not in names:
            raise JobInvalid(
                f"There is no camera '{item.camera}' to be left out.", where="leave_out",
                hint=f"Cameras: {', '.join(names)}.",
            )  # fmt: skip
        if item.first is not None and item.first >= frames:
            raise JobInvalid(f"'{text}' lies beyond the take of {frames} frames.", where="leave_out")
        stop = None if item.last is None else item.last + 1
        out[list(names).index(item.camera), item.first : stop] = True
    return out
