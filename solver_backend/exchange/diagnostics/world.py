"""Diagnostics of calibrations and of the world that a person stands in: units, axes, scale, floor, times."""

from __future__ import annotations

from .entry import DiagnosticEntry, note, warning

WORLD_CHECK: dict[str, DiagnosticEntry] = {
    "person_triangulated": note(
        "Triangulated, the person is about {stature:.2f} m tall by the legs; keypoints span {span:.2f} m upwards from "
        "z = {lowest:.2f} m; median residual {size:.1f} px",
        "Every recording of calibrated views is triangulated once, to check its world.",
    ),
    "stature_unlikely": warning(
        "The person would be {stature:.3g} m tall: the calibration {reason}",
        "The calibration's unit is another, or was not written down.",
        "Give the person's height with --stature, or the unit with --unit.",
    ),
    "person_along_axis": warning(
        "The person stands along {axis}: the calibration's world may have {axis} up instead of Z",
        "The calibration has other axes, or is relative to a camera or a board.",
        "Give the axis with --up-axis.",
    ),
    "floor_off": warning(
        "The lowest foot is at z = {lowest:.2f} m: the calibration's floor is not at z = 0",
        "The calibration's origin is not on the floor.",
        "Level the world by the person: --level on.",
    ),
    "views_disagree": warning(
        "The views disagree by {size:.0f} px (median)",
        "The calibration is of other cameras or another day, or the cameras are not synchronised.",
        "Is this the recording's calibration, are the cameras synchronised?",
    ),
    "cameras_shifted": warning(
        "Against the other cameras some see everything shifted: {shifts}",
        "A camera was moved, or its lens was calibrated badly.",
        "Their calibration is a little off; refine it.",
    ),
    "nothing_located": warning(
        "No keypoint can be located from the views",
        "The calibration is of other cameras, or belongs to other names.",
        "Is this the recording's calibration?",
    ),
}
"""What the person shows of the world; a world that is changed is checked anew."""

WORLD: dict[str, DiagnosticEntry] = {**WORLD_CHECK}
