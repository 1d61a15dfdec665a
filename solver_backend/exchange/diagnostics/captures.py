"""Diagnostics of recordings of views: detections, people, footage, frame rates."""

from __future__ import annotations

from .entry import DiagnosticEntry, note, warning

CAPTURES: dict[str, DiagnosticEntry] = {
    "person_chosen": note(
        "The person is the one most views agree on: {views:.1f} of {cameras_count} views, in {seen} of {of} frames",
        "Every recording is searched for the person that most views agree on.",
    ),
    "people_left_out": note(
        "Other people are left out: {shares}",
        "Views show more people than the one that is solved.",
    ),
    "person_seen_too": note(
        "{person} is seen as well: {views:.1f} views in {seen} frames",
        "Several people are in the recording.",
        "Each person can be solved.",
    ),
    "few_views_agree": warning(
        "Of {views:.1f} views that see somebody only {agreeing:.1f} agree on the person",
        "The calibration is of other cameras or another day, or the cameras are not synchronised.",
        "Is this the recording's calibration, are the cameras synchronised?",
    ),
    "camera_sees_elsewhere": warning(
        "Camera {camera} sees one person, but never where the other cameras do",
        "The camera is turned, mirrored or late, or has another camera's name; a solve finds which.",
        "It may be turned, mirrored, late or named like another.",
    ),
}
