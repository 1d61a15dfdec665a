"""Sentences of capture files of earlier versions that later steps depend on, read as the diagnostics they are today."""

from __future__ import annotations

import re

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic

_NUMBER = r"(-?\d+(?:\.\d+)?)"
_NOISE_MAP = re.compile(
    r"Confidences stand for variances as measured of (.+?) on (\d+) keypoints\."
    r"(?: These detections are of (.+)\.)?"
)
_DETECTOR = re.compile(rf"Detector: (.+?); (\d+) moments at {_NUMBER} a second that all (\d+) videos show\.")
_PERSON = re.compile(
    rf"Triangulated, the person is about {_NUMBER} m tall by the legs; keypoints span {_NUMBER} m upwards from "
    rf"z = {_NUMBER} m; median residual {_NUMBER} px\."
)


def as_today(item: Diagnostic) -> Diagnostic:
    """Return what an earlier version's sentence reports by its code of today, or the item itself.

    Confidences that were weighted once must not be weighted again, and a world that was checked is not checked twice.
    """
    text = str(item.values.get("text", ""))
    if found := _NOISE_MAP.fullmatch(text):
        code = "noise_map_of_another" if found[3] else "noise_map_applied"
        return diagnostic(code, measured=found[1], keypoints=int(found[2]), detector=found[3] or found[1])
    if found := _DETECTOR.fullmatch(text):
        moments, videos = int(found[2]), int(found[4])
        return diagnostic("detector_used", detector=found[1], moments=moments, rate=float(found[3]), videos=videos)
    if found := _PERSON.fullmatch(text):
        stature, span, lowest, size = (float(number) for number in found.groups())
        return diagnostic("person_triangulated", stature=stature, span=span, lowest=lowest, size=size)
    return item
