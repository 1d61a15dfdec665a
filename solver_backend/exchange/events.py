"""What a line of the progress protocol must look like before anybody acts on it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

_Test = Callable[[Any], bool]


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**31


def _number(value: Any) -> bool:
    if isinstance(value, int):
        return not isinstance(value, bool) and abs(value) < 2**63  # a larger one may be none that a float holds
    return isinstance(value, float) and math.isfinite(value)


def _texts(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(item, str) for item in value)


def _diagnostics(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(item, dict)
        and all(_text(item.get(key)) for key in ("code", "severity"))
        and all(isinstance(item.get(key, {}), dict) for key in ("where", "values"))
        for item in value
    )


def _or_none(test: _Test) -> _Test:
    return lambda value: value is None or test(value)


def _cameras(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(item, dict) and _text(item.get("name")) and _or_none(_number)(item.get("seen_percent"))
        for item in value
    )


_EVENTS: dict[str, dict[str, _Test]] = {
    "progress": {"stage": _text, "done": _whole, "total": _whole, "eta_s": _or_none(_number)},
    "error": {"code": _text, "message": _text, "where": _text, "hint": _text},
    "result": {},
}


def _people(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(item, dict) and _text(item.get("name")) and _whole(item.get("frames")) and _number(item.get("views"))
        for item in value
    )


_CAPTURE: dict[str, _Test] = {
    "capture": _text, "name": _text, "frames": _whole, "fps": _number, "joint_set": _or_none(_text),
    "markers": _or_none(_whole), "cameras": _cameras, "people": _people, "person": _text,
    "notes": _texts, "problems": _texts, "diagnostics": _diagnostics,
}  # fmt: skip
_SOLVED: dict[str, _Test] = {
    "motion": _text, "report": _or_none(_text), "diagnostics": _diagnostics, "frames": _whole,
    "reprojection_median_px": _or_none(_number), "unsure_frames": _whole, "unseen_frames": _whole,
}  # fmt: skip
_RESULTS: dict[str, dict[str, _Test]] = {"convert": _CAPTURE, "demo-capture": _CAPTURE, "solve": _SOLVED}
"""What the results of the verbs hold that somebody acts on."""


def _each(tests: dict[str, _Test]) -> _Test:
    def holds(value: Any) -> bool:
        return isinstance(value, list) and all(
            isinstance(item, dict) and all(test(item.get(key)) for key, test in tests.items()) for item in value
        )

    return holds


_REFINED: dict[str, _Test] = {
    "name": _text, "before_px": _or_none(_number), "after_px": _or_none(_number), "moved_mm": _or_none(_number),
    "turned_degrees": _or_none(_number),
}  # fmt: skip
_RESULTS["refine-cameras"] = {**_CAPTURE, "refined": _each(_REFINED)}


def _takes_of_videos(value: Any) -> bool:
    """Return whether takes state where their results are and, those that were read, what was recognised."""
    return isinstance(value, dict) and all(
        isinstance(item, dict)
        and _text(item.get("folder"))
        and _text(item.get("source"))
        and (item.get("read") is None or all(test(item["read"].get(key)) for key, test in _CAPTURE.items()))
        for item in value.values()
    )


_RESULTS["check-cameras"] = {
    "verdict": _text, "findings": _texts, "problems": _or_none(_texts), "stature_m": _number, "tilt_deg": _number,
    "tilt_sigma_deg": _number, "diagnostics": _diagnostics, "capture_diagnostics": _or_none(_diagnostics),
}  # fmt: skip
_RESULTS["fit-cameras"] = {
    "calibration": _text, "format": _text, "cameras": _texts, "residual_px": _or_none(_number),
    "stature_m": _or_none(_number), "diagnostics": _diagnostics,
}  # fmt: skip
_RESULTS["from-videos"] = {"takes": _takes_of_videos}
_SEVERAL: dict[str, tuple[str, dict[str, _Test]]] = {
    "convert": ("captures", {"captures": _each({**_CAPTURE, "source": _text})}),
    "solve": (
        "takes",
        {"takes": _each({**_SOLVED, "name": _text}), "failed": _each({"name": _text, "message": _text})},
    ),
}
"""The key that marks a result of several captures or takes, and what such a result holds."""


def _tests_of(event: Mapping[str, Any], verb: str) -> dict[str, _Test]:
    key, several = _SEVERAL.get(verb, ("", {}))
    return several if key and key in event else _RESULTS.get(verb, {})


def what_is_wrong(event: Mapping[str, Any], verb: str) -> str:
    """Return a sentence on an event that is not as the protocol has it, "" where it is.

    Args:
        event: a line of the solver's, as an object that has the key ``event``.
        verb: verb of the run.
    """
    kind = event.get("event")
    if not isinstance(kind, str) or kind not in _EVENTS:
        return f"the event {str(kind)[:40]!r} is unknown"
    tests = _EVENTS[kind] | (_tests_of(event, verb) if kind == "result" else {})
    wrong = [key for key, test in tests.items() if not test(event.get(key))]
    return f"a {kind} event lacks {', '.join(wrong)} as it should be" if wrong else ""
