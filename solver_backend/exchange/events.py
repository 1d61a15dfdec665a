"""Check the lines of the progress protocol, and write the lines of live runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NotRequired, TypedDict, cast

Form = str | list[Any] | dict[str, Any]
"""Expected form of a JSON value: a key in ``_KINDS``, a list with the form of all items, or forms by key. A value may
be null if its key ends in "?". The key "*" matches all keys."""


def _is_number(value: Any) -> bool:
    if isinstance(value, int):
        return not isinstance(value, bool) and abs(value) < 2**63  # a float may not represent larger values exactly
    return isinstance(value, float) and math.isfinite(value)


_KINDS: dict[str, Callable[[Any], bool]] = {
    "text": lambda value: isinstance(value, str),
    "whole": lambda value: _is_number(value) and isinstance(value, int) and abs(value) < 2**31,
    "number": _is_number,
    "object": lambda value: isinstance(value, dict),
}
"""Function that checks each kind of value."""
_DIAGNOSTICS = [{"code": "text", "severity": "text", "where": "object", "values": "object"}]
# fmt: off
_CAPTURE: dict[str, Form] = {
    "capture": "text", "name": "text", "frames": "whole", "fps": "number", "joint_set?": "text", "markers?": "whole",
    "cameras": [{"name": "text", "seen_percent?": "number"}],
    "people": [{"name": "text", "frames": "whole", "views": "number"}],
    "person": "text", "notes": ["text"], "problems": ["text"], "diagnostics": _DIAGNOSTICS,
}
_SOLVED: dict[str, Form] = {
    "motion": "text", "report?": "text", "diagnostics": _DIAGNOSTICS, "frames": "whole",
    "reprojection_median_px?": "number", "unsure_frames": "whole", "unseen_frames": "whole",
}
_CHANGE = {"name": "text", "before_px?": "number", "after_px?": "number", "moved_mm?": "number",
           "turned_degrees?": "number"}
_EVENTS: dict[str, dict[str, Form]] = {
    "progress": {"stage": "text", "done": "whole", "total": "whole", "eta_s?": "number"},
    "error": {"code": "text", "message": "text", "where": "text", "hint": "text"},
    "result": {},
}
_RESULTS: dict[str, dict[str, Form]] = {
    "convert": _CAPTURE, "dataset demo": _CAPTURE, "solve": _SOLVED,
    "cameras refine": {**_CAPTURE, "refined": [_CHANGE]},
    "cameras check": {
        "verdict": "text", "findings": ["text"], "problems?": ["text"], "stature_m": "number", "tilt_deg": "number",
        "tilt_sigma_deg": "number", "diagnostics": _DIAGNOSTICS, "capture_diagnostics?": _DIAGNOSTICS,
    },
    "cameras fit": {
        "calibration": "text", "format": "text", "cameras": ["text"], "residual_px?": "number", "stature_m?": "number",
        "diagnostics": _DIAGNOSTICS,
    },
    "from-videos": {"takes": {"*": {"folder": "text", "source": "text", "read?": _CAPTURE}}},
}
"""Keys in the verbs' results that other programs depend on."""
_SEVERAL: dict[str, dict[str, Form]] = {
    "convert": {"captures": [{**_CAPTURE, "source": "text"}]},
    "solve": {"takes": [{**_SOLVED, "name": "text"}], "failed": [{"name": "text", "message": "text"}]},
}
"""Keys in a result for several captures or takes. Such a result contains the first of these keys."""
# fmt: on


def fits(form: Form, value: Any) -> bool:
    """Return whether a JSON value has the given form (see ``Form``)."""
    if isinstance(form, str):
        return _KINDS[form](value)
    if isinstance(form, list):
        return isinstance(value, list) and all(fits(form[0], item) for item in value)
    if "*" in form:
        return isinstance(value, dict) and all(fits(form["*"], item) for item in value.values())
    return isinstance(value, dict) and not _misfits(form, value)


def _misfits(form: dict[str, Form], value: Mapping[str, Any]) -> list[str]:
    wrong = []
    for key, inner in form.items():
        name = key.rstrip("?")
        item = value.get(name, {} if inner == "object" else None)
        if not fits(inner, item) and (item is not None or name == key):
            wrong.append(name)
    return wrong


def what_is_wrong(event: Mapping[str, Any], verb: str) -> str:
    """Describe how a solver event violates the progress protocol, or return "" if it is valid."""
    kind = event.get("event")
    if not isinstance(kind, str) or kind not in _EVENTS:
        return f"the event {str(kind)[:40]!r} is unknown"
    form = _EVENTS[kind]
    if kind == "result":
        several = _SEVERAL.get(verb, {})
        form = several if next(iter(several), "") in event else _RESULTS.get(verb, {})
    wrong = _misfits(form, event)
    return f"a {kind} event lacks {', '.join(wrong)} as it should be" if wrong else ""


class EventLine(TypedDict):
    """An event of a live run."""

    event: str
    t: float | None  # Seconds on the source's clock, or None if unknown.
    message: str
    betas: NotRequired[list[float]]  # Only in the event ``shape``.


class PoseValues(TypedDict):
    """A pose: rotation vectors of root and joints in radians, and translation in metres."""

    root: list[float]
    pose: list[float]
    trans: list[float]


class FrameLine(TypedDict):
    """A frame of a live run, with a pose or with the reason why there is none."""

    frame: int
    t: float
    state: str
    why: NotRequired[str]
    root: NotRequired[list[float]]
    pose: NotRequired[list[float]]
    trans: NotRequired[list[float]]
    points: NotRequired[int]
    markers: NotRequired[int]  # Number of points recognised as markers.
    views: NotRequired[int]  # Number of cameras used for the pose.
    off_mm: NotRequired[float]
    latency_ms: NotRequired[float]
    lag_ms: NotRequired[float]
    face: NotRequired[dict[str, float]]  # Channels by name.
    coverage: NotRequired[dict[str, float]]  # Fraction of each camera's image that the wand has covered.
    cloud: NotRequired[list[list[float]]]
    cloud_off_mm: NotRequired[list[float | None]]
    sigma_mm: NotRequired[list[float | None]]  # Standard deviation per joint in mm.
    dropped: NotRequired[int]
    views_left_out: NotRequired[int]
    rate_hz: NotRequired[float]


LiveLine = EventLine | FrameLine


def frame_line(number: int, t: float, state: str, latency_s: float, lag_s: float, **values: Any) -> FrameLine:
    """Build the output line for one frame. ``values`` are further keys of ``FrameLine``."""
    delays = {"latency_ms": round(1e3 * latency_s, 3), "lag_ms": round(1e3 * lag_s, 3)}
    return cast("FrameLine", {"frame": number, "t": round(t, 6), "state": state, **values, **delays})


def event_line(event: str, message: str, t: float | None = None) -> EventLine:
    """Build the line for an event of a live run, with its time in seconds on the source's clock."""
    return {"event": event, "t": t, "message": message}
