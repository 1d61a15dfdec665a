"""Diagnostics of the world that a person stands in: unit, axes, scale, level, floor."""

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
    "limb_halves_odd": warning(
        "The upper half of the {limb} is {ratio:.2f} times as long as the lower one: {middle} and {end} may bear each "
        "other's names",
        "The keypoints are in another order than the file states.",
        "Check the names of the keypoints (keypoints.json).",
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
        "Check that the calibration is the recording's and that the cameras are synchronised.",
    ),
    "cameras_shifted": warning(
        "Against the other cameras some see everything shifted: {shifts}",
        "A camera was moved, or its lens was calibrated badly.",
        "Their calibration is a little off; refine it.",
    ),
    "cameras_elsewhere": warning(
        "Cameras see everything in other places than the others do: {shifts}",
        "Their calibration is of another place or in another convention, or they are late, or named like another.",
        "Check their names, their start, and whether they were moved after the calibration.",
    ),
    "nothing_located": warning(
        "The views locate no keypoint",
        "The calibration is of other cameras, or belongs to other names.",
        "Check that the calibration is the recording's.",
    ),
}
"""What the person shows of the world; a world that is changed is checked anew."""

WORLD: dict[str, DiagnosticEntry] = {
    **WORLD_CHECK,
    "unit_by_person": warning(
        "The calibration's lengths are read as {unit}: the person is {stature:.2f} m tall with that, and {read:.3g} m "
        "as {guessed}",
        "Files of calibrations state no unit; the person shows which one is meant.",
        "To keep them: --unit {guessed}. Of a board's squares: --stature METRES, or --scale with their length.",
    ),
    "scale_as_asked": note(
        "The calibration's lengths are taken {scale:g} times, as asked for",
        "A scale was given.",
    ),
    "scale_by_stature": note(
        "The calibration's lengths are taken {scale:.4g} times (± {percent:.1f} %, as are all sizes and places), so "
        "that the person is {stature:g} m tall",
        "The person's stature was given.",
    ),
    "stature_contradicts": warning(
        "By the calibration the person is {size:.2f} m tall, and not {stature:g} m, which was given: all sizes and "
        "places are taken {scale:.3g} times",
        "The stature is wrong, or the size of the board's squares was.",
        "Check both; without --stature the calibration's scale stays.",
    ),
    "up_by_person": warning(
        "The person stands along {axis} of the calibration's world: {axis} is taken as up",
        "The calibration has another up axis than Z, or is relative to a camera or a board.",
        "To keep Z: --up-axis z.",
    ),
    "world_levelled": warning(
        "The world is levelled by {tilt:.1f}° (± {sigma:.1f}°), and its floor, at z = {floor:+.3f} m, is laid at 0, as "
        "{witnesses} show",
        "The calibration's world is tilted: a board did not lie on the floor, or there was none.",
        "To keep it as calibrated: --level off.",
    ),
    "world_levelled_as_asked": note(
        "The world is levelled by {tilt:.1f}° (± {sigma:.1f}°), and its floor, at z = {floor:+.3f} m, is laid at 0, as "
        "asked for",
        "Levelling by the person was asked for.",
    ),
    "floor_by_feet": warning(
        "The feet stand {depth:.2f} m below z = 0, so the floor is laid there",
        "The calibration's origin is not on the floor.",
        "To keep it: --level off.",
    ),
    "one_camera_placed": note(
        "Up and floor are the person's: the camera is {height:.2f} m high and looks {angle:.0f}° {way}",
        "Levelling by the person was asked for, or the single camera has no world of its own.",
    ),
    "one_camera_up_by_person": warning(
        "The person stands {angle:.0f}° off the calibration's up: up and floor are taken from the person",
        "The calibration of the single camera has another up axis than Z, or no world at all.",
        "To keep the calibration's: --level off.",
    ),
}
