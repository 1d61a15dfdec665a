"""Diagnostics of cameras that are calibrated or checked: by a board, a person, clicked points or several of them."""

from __future__ import annotations

from .entry import DiagnosticEntry, note, warning

_LENSES: dict[str, DiagnosticEntry] = {
    "board_pictures_few": warning(
        "{camera}: only {count} pictures show the board",
        "The footage is short, or the board is hard to find in it.",
        "Film 20 or more.",
    ),
    "board_parts_bare": warning(
        "{camera}: the board was hardly ever at the picture's {parts}",
        "The board was carried through the middle of the picture alone.",
        "Carry the board there.",
    ),
    "board_tilts_few": warning(
        "{camera}: the board was tilted in {count} pictures",
        "The board was held square to the camera, which hides its focal length.",
        "Turn it by 20 to 45 degrees, each way.",
    ),
    "board_small": warning(
        "{camera}: the board fills {percent:.0f} % of the picture's height",
        "The board is far away, or too small for the room.",
        "Bring it nearer.",
    ),
    "lens_of_another_zoom": warning(
        "{camera} has a focal length of {size:.0f} px here, not {stated:.0f} px as stated: its lens was filmed in "
        "another zoom or mode",
        "The footage of the lens was filmed in another zoom or video mode.",
        "Film the board again in the mode of the takes.",
    ),
}
"""What pictures of a board lack, and lenses that do not fit them."""

_BOARDS: dict[str, DiagnosticEntry] = {
    "board_seen": note(
        "The {board} was seen at {count} moments; {left_out} corners contradict, are left out",
        "Cameras were calibrated by a board.",
    ),
    "board_mirrored": warning(
        "{camera} shows the board mirrored in {count} pictures, as in a mirror or a window",
        "The camera saw a reflection.",
        "Film the board itself.",
    ),
    "camera_off_board": warning(
        "{camera} is off by {size:.1f} px: its lens was filmed in another zoom or mode, it was moved, or the board was "
        "not held still",
        "The corners that a camera saw fit no pose.",
        "Film the board again.",
    ),
    "camera_delayed": warning(
        "{camera} is {way} than {other_camera} by {size:.0f} ms",
        "The cameras did not record at the same moments.",
        "The takes are too: synchronise them.",
    ),
    "corners_contradict": warning(
        "{percent:.0f} % of the corners contradict the others; a camera was moved or is not synchronous",
        "A camera was touched while the board was filmed, or frames were lost.",
        "Film the board again.",
    ),
    "halves_differ": note(
        "Halves of the footage differ by {size:.1f} mm and {angle:.2f}° (median of the cameras)",
        "Each half of the footage gives cameras of its own, which shows how sure they are.",
    ),
    "halves_short": warning(
        "Halves of the footage are too short to check how sure the cameras are",
        "The board was seen by several cameras at few moments.",
        "Film the board for longer.",
    ),
    "world_by_board": note(
        "Origin, axes and floor are the board's at frame {frame}",
        "The frame at which the board lies on the floor was given.",
    ),
    "world_upright": note(
        "Up is the cameras' own upright",
        "No frame at which the board lies on the floor was given.",
        "Lay the board on the floor to know it (--origin).",
    ),
}
"""Of cameras that filmed a board."""

_PERSONS: dict[str, DiagnosticEntry] = {
    "cameras_scale_by_length": note(
        "The scale is by {joint} to {other_joint}, {length:g} m",
        "The distance of two keypoints was given.",
    ),
    "cameras_scale_by_stature": note(
        "The scale is by a stature of {stature:g} m, {percent:.1f} % sure",
        "The person's stature was given.",
    ),
    "cameras_scale_by_mean": note(
        "The scale is by people's mean stature, {percent:.1f} % sure",
        "No stature was given.",
    ),
    "cameras_stature_unknown": warning(
        "The stature is unknown: lengths may be wrong by {percent:.0f} %",
        "No stature was given, and people differ.",
        "Give it with --stature.",
    ),
    "cameras_up_unsure": warning(
        "Up is known to {angle:.0f} degrees only",
        "The person stood seldom, or in one place.",
        "Let the person stand tall and walk.",
    ),
    "cameras_person_stayed": warning(
        "The person stayed within {size:.1f} m, which constrains cameras poorly",
        "The person hardly walked.",
        "Let them walk through all of the space that takes will use.",
    ),
    "cameras_keypoints_left": warning(
        "{percent:.0f} % of the keypoints fit no cameras",
        "Views show different people, or are not synchronous.",
        "Check that all views show one person and are synchronised.",
    ),
    "cameras_keypoints_off": note(
        "Keypoints of {count} frames are off by {size:.1f} px per axis",
        "Cameras were calibrated by a person.",
    ),
    "cameras_kept": note(
        "Refined cameras explain the take to {after:.1f} px, the calibration to {before:.1f} px: it is kept",
        "The calibration is as good as the take can show.",
    ),
    "cameras_refined_by_person": note(
        "The take's keypoints are {after:.1f} px from where the cameras agree, and {before:.1f} px as calibrated",
        "Cameras were refined by a person.",
    ),
    "camera_moved": warning(
        "{camera} {moves} where it was calibrated; it was moved, or calibrated badly",
        "The camera was touched after it was calibrated.",
        "Use the refined cameras for takes from then on.",
    ),
}
"""Of cameras that filmed a person."""

_TOGETHER: dict[str, DiagnosticEntry] = {
    "points_clicked": note(
        "{count} points, {known} of them with known places",
        "Cameras were calibrated by clicked points.",
    ),
    "click_far": warning(
        "{point} was clicked {size:.0f} px from where it should be in {camera}",
        "Another point was clicked, or its known place is wrong.",
        "Click it again, or measure its place.",
    ),
    "source_points": note(
        "{source}: {count} points, off by {size:.2f} px per axis",
        "Cameras were calibrated by several sources.",
    ),
    "source_contradicts": warning(
        "What {camera} saw of the {source} is {after:.1f} px off beside the other sources, {before:.1f} px alone",
        "The camera was moved between the sources, or one of them is of another camera array or size.",
        "Leave one of the sources out, or record it again.",
    ),
    "camera_off_held": warning(
        "{camera} stands {size:.0f} mm from where it was calibrated; it was moved, or was calibrated badly",
        "The sources contradict the calibration that is held.",
        "Calibrate the camera again, or give a larger --hold.",
    ),
    "world_by_places": note(
        "Origin, axes and floor are those of the known places",
        "Places of clicked points were given.",
    ),
    "world_held": note(
        "The world is that of the calibration that is held",
        "The calibration counts as a source.",
    ),
    "world_of_start": note(
        "The world is the start's; scale is the start's",
        "No source shows another world, nor a length.",
    ),
    "world_of_start_scaled": note(
        "The world is the start's; scale is the sources'",
        "A source shows a length.",
    ),
}
"""Of cameras calibrated by clicks, or by several sources at once."""

_CHECKS: dict[str, DiagnosticEntry] = {
    "camera_moved_since": warning(
        "{camera} seems to have moved after calibration ({size:.1f} px, {best:.1f} px if refined)",
        "The camera was touched after it was calibrated.",
        "Refine it.",
    ),
    "lens_off_at_rim": warning(
        "{camera} is off by {size:.1f} px at the picture's rim and {inner:.1f} px in its middle: its lens is of "
        "another zoom or mode",
        "The lens was calibrated in another zoom or video mode.",
        "Calibrate its intrinsics in the mode of the takes.",
    ),
    "camera_drifts": warning(
        "{camera} fits by {first:.1f} px in the first half of the take and {last:.1f} px in the second: it was "
        "touched, or its clock runs at another rate",
        "The camera was moved during the take, or frames were lost.",
        "Cut the take there, or synchronise it again.",
    ),
    "scale_doubted": warning(
        "The person would be {stature:.2f} m tall: the board's squares do not have the stated size",
        "The printer scaled the board, or its squares were measured badly.",
        "Measure one square, or give the stature.",
    ),
    "tilt_doubted": warning(
        "The person stands {angle:.0f} degrees from the world's up: the board lay on no level floor, or another axis "
        "is up (--up-axis)",
        "The calibration's world is tilted, or relative to a camera.",
        "Level the world with --level on, or give the axis.",
    ),
}
"""Of calibrations that are held against a take."""

EXTRINSICS: dict[str, DiagnosticEntry] = {**_LENSES, **_BOARDS, **_PERSONS, **_TOGETHER, **_CHECKS}
"""By code."""
