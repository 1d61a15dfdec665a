"""Diagnostics of what is made of videos and sensors."""

from __future__ import annotations

from .entry import DiagnosticEntry, note

VIDEOS: dict[str, DiagnosticEntry] = {
    "detector_used": note(
        "Detector: {detector}; {moments} moments at {rate:g} a second that all {videos} videos show",
        "The detections of videos come from this detector.",
    ),
    "noise_map_applied": note(
        "Confidences stand for variances as measured of {measured} on {keypoints} keypoints",
        "A noise map was given.",
    ),
    "noise_map_of_another": note(
        "Confidences stand for variances as measured of {measured} on {keypoints} keypoints",
        "A noise map was given that was measured of another detector.",
        "These detections are of {detector}.",
    ),
}
