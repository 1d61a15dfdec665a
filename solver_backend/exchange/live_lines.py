"""The lines of a live run (docs/reference/live-streams.md): frames, and events between them."""

from __future__ import annotations

from typing import Any, NotRequired, TypedDict, cast


class EventLine(TypedDict):
    """An event."""

    event: str
    t: float | None  # Seconds on the source's clock, None where it is not known.
    message: str
    betas: NotRequired[list[float]]  # Of the event ``shape``.


class PoseValues(TypedDict):
    """One pose: rotation vectors of the root and of the other joints in radians, and metres."""

    root: list[float]
    pose: list[float]
    trans: list[float]


class FrameLine(TypedDict):
    """One frame: a pose, or the reason why there is none."""

    frame: int
    t: float
    state: str
    why: NotRequired[str]
    root: NotRequired[list[float]]
    pose: NotRequired[list[float]]
    trans: NotRequired[list[float]]
    points: NotRequired[int]
    markers: NotRequired[int]  # Points that are taken for markers.
    views: NotRequired[int]  # Cameras that a pose is made of.
    off_mm: NotRequired[float]
    latency_ms: NotRequired[float]
    lag_ms: NotRequired[float]
    face: NotRequired[dict[str, float]]  # Channels by name.
    coverage: NotRequired[dict[str, float]]  # Share of each camera's picture that a wand visited.
    cloud: NotRequired[list[list[float]]]
    cloud_off_mm: NotRequired[list[float | None]]
    sigma_mm: NotRequired[list[float | None]]  # Of each joint.
    dropped: NotRequired[int]
    views_left_out: NotRequired[int]
    rate_hz: NotRequired[float]


LiveLine = EventLine | FrameLine


def frame_line(number: int, t: float, state: str, latency_s: float, lag_s: float, **values: Any) -> FrameLine:
    """Return the line of one frame. Delays are in seconds, and values are keys of ``FrameLine``."""
    delays = {"latency_ms": round(1e3 * latency_s, 3), "lag_ms": round(1e3 * lag_s, 3)}
    return cast("FrameLine", {"frame": number, "t": round(t, 6), "state": state, **values, **delays})


def event_line(event: str, message: str, t: float | None = None) -> EventLine:
    """Return an event."""
    return {"event": event, "t": t, "message": message}
