"""Diagnostics of readers of markers: what a file holds, its unit and axes, and what in it cannot be so."""

from __future__ import annotations

from .entry import DiagnosticEntry, note, warning

_UNIT_ADVICE = "Give the unit with --unit if that is wrong."
_AXIS_ADVICE = "Give the axis with --up-axis if that is wrong."

_UNIT_AND_AXIS: dict[str, DiagnosticEntry] = {
    "marker_unit_given": note("Lengths are read as {unit} (as given)", "The unit was given."),
    "marker_unit_stated": note("Lengths are read as {unit} (as the file states)", "The file states its unit."),
    "marker_unit_estimated": note(
        "Lengths are read as {unit} (estimated: the markers spread over {spread:.4g} units)",
        "The file states no unit; in this one the markers have a person's size.",
    ),
    "marker_unit_corrected": note(
        "Lengths are read as {unit} (estimated against the file's statement)",
        "In the unit that the file states the markers would have no person's size.",
    ),
    "marker_unit_assumed": note(
        "Lengths are read as {unit} (assumed, as the file states none: files of this kind are mostly in {unit})",
        "The file states no unit, and the markers have a person's size in none.",
    ),
    "marker_unit_not_as_stated": warning(
        "The file states {stated}, in which the markers would spread over {spread:.4g} m; lengths are read as {unit}",
        "The file's header was written by a program that did not know the unit.",
        _UNIT_ADVICE,
    ),
    "marker_spread_unlikely": warning(
        "The markers spread over {spread:.4g} m, which is not a person's size",
        "The unit is another than the file states, or the markers are on no person.",
        _UNIT_ADVICE,
    ),
    "markers_look_like_unit": warning(
        "The markers spread over {spread:.3g} m, which is not a person's size: they look like {unit}",
        "The capture's markers were written in another unit than metres.",
        "Write them in metres.",
    ),
    "markers_not_in_metres": warning(
        "The markers spread over {spread:.3g} m, which is not a person's size",
        "The capture's markers were written in another unit than metres, or are on no person.",
        "Check that the capture's markers are in metres.",
    ),
    "marker_axis_given": note("{axis} points up (as given)", "The axis was given."),
    "marker_axis_stated": note("{axis} points up (as the file states)", "The file states its axis."),
    "marker_axis_by_body": note(
        "{axis} points up (as the body stands)", "The file states no axis; the body stands along this one."
    ),
    "marker_axis_corrected": note(
        "{axis} points up (as the body stands, against the file's statement)",
        "The body stands along another axis than the file states, with its feet at 0 of it.",
    ),
    "marker_axis_by_floor": note(
        "{axis} points up (as the markers are above a floor at 0)",
        "The file states no axis; along this one alone all markers are above 0.",
    ),
    "marker_axis_assumed": note(
        "{axis} points up (assumed, as files of this kind mostly have it)",
        "The file states no axis, and how the body stands is not seen.",
    ),
    "body_along_other_axis": warning(
        "The file states that {stated} points up, but the body stands along {along}, which is used",
        "The file's header was written by a program that did not know the axes.",
        _AXIS_ADVICE,
    ),
    "body_across_stated_axis": warning(
        "The file states that {stated} points up, but the body stands along {along}; {stated} is used",
        "The person lies or hangs, or the file's header names a wrong axis.",
        _AXIS_ADVICE,
    ),
    "body_along_unusual_axis": warning(
        "The file states no axis; {along} is taken as up, along which the body is long, but nothing stands at 0 of it",
        "The person lies, or the program that wrote the file has other axes than most, which have Y or Z up.",
        _AXIS_ADVICE,
    ),
    "body_across_usual_axis": warning(
        "Files of this kind mostly state that {stated} points up, but the body stands along {along}; {stated} is used",
        "The person stands on the hands or hangs, or the program that wrote the file has other axes than most.",
        _AXIS_ADVICE,
    ),
    "markers_along_axis": warning(
        "The markers' body stands along {along}, not along Z",
        "The capture's markers were written in a world whose Z does not point up.",
        "Check that Z points up in the capture.",
    ),
}

_FRAMES_AND_COUNTS: dict[str, DiagnosticEntry] = {
    "markers_read": note(
        "{format}: {count} markers in {length} frames at {fps:g} Hz", "Every file of markers is described so."
    ),
    "marker_count_not_as_stated": warning(
        "The file states {stated:g} markers but holds {count}",
        "The file was edited, or is truncated.",
        "Export it again if markers are missing.",
    ),
    "marker_names_not_as_stated": warning(
        "The file states {stated:g} markers but names {count}",
        "The file was edited, or some of its markers have no names.",
        "Export it again if markers are missing.",
    ),
    "frame_count_not_as_stated": warning(
        "The file states {stated:g} frames but holds {count}",
        "The file was cut or edited, or is truncated.",
        "Export it again if frames are missing.",
    ),
    "file_truncated": warning(
        "The file states {stated} frames but holds {count}: it is truncated",
        "The file was not copied or written to its end.",
        "Export it again.",
    ),
    "frame_number_jumps": warning(
        "Frame {before} is followed by {after}; frames are read as following each other",
        "Rows were left out when the file was exported or edited.",
        "Export every frame.",
    ),
    "frame_numbers_jump": warning(
        "Frame {before} is followed by {after} ({jumps} such jumps); frames are read as following each other",
        "Rows were left out when the file was exported or edited.",
        "Export every frame.",
    ),
    "marker_rate_not_as_stated": warning(
        "The header states {stated:g} Hz, the times {timed:.4g}; {fps:.4g} is used",
        "A file that was thinned out has new times and the old header.",
        "Give the frame rate if that is wrong.",
    ),
    "marker_rates_contradict": warning(
        "The file states several frame rates: {rate:g} is read, but {others}",
        "A program that thinned out or converted the file renewed some entries and not others.",
        "Compare the take's length in seconds with the real one; if the rate is wrong, give it with --fps.",
    ),
    "live_recording_unfinished": warning(
        "The live recording was not finished: it ends with frame {count}, at {time:.2f} s",
        "Blender or the computer ended while it was recording.",
        "What was recorded up to there is whole.",
    ),
    "live_recording_damaged": warning(
        "{bytes} bytes of no whole frame are left out",
        "The disk was full, or the computer ended while a frame was written.",
        "The frames around them may be some moments apart.",
    ),
}

_POINTS: dict[str, DiagnosticEntry] = {
    "marker_never_moves": warning(
        "Markers that never move: {markers}",
        "Something in the room was recorded, or a program wrote a constant.",
        "Leave them out of the file if they are on nobody.",
    ),
    "markers_at_origin": note(
        "{count} markers are exactly at the origin in some frames, {markers}: read as not seen ({positions} positions)",
        "Many programs write 0 0 0 for a marker that is not seen.",
    ),
    "markers_at_sentinel": warning(
        "{count} markers are at [{place}] or the like in some frames, {markers}: read as not seen "
        "({positions} positions)",
        "Some programs write one number, or nines, for a marker that is not seen.",
        "Compare with the recording if markers are missing.",
    ),
    "residuals_mark_nothing": warning(
        "Every residual marks the point as not seen",
        "The program that wrote the file keeps no residuals.",
        "The positions are read as seen.",
    ),
    "model_outputs_left_out": note(
        "{count} points that are not positions (angles, forces, moments, powers) are left out",
        "Programs keep what their models compute as points.",
    ),
    "analog_channels_left_out": note(
        "{count} analog channels (forces, muscles) are not read: {channels}",
        "The file holds the signals of force plates or of muscles.",
    ),
    "blocks_left_out": warning(
        "{count} blocks of trajectories of other frames are left out",
        "Exports of several trials were joined in one file.",
        "Export each trial to a file of its own.",
    ),
    "bones_left_out": note(
        "{count} bones are left out: they are computed from the markers", "Motive exports its skeleton's bones, too."
    ),
    "expected_places_left_out": note(
        "{count} places where assets expect their markers are left out: measured ones are there",
        "Motive exports where an asset's model has its markers, beside the measured ones.",
    ),
    "expected_places_read": note(
        "Markers are where their assets expect them, not as measured: the file holds no others",
        "The file was exported without 'Markers'.",
        "Export it with 'Markers' switched on for what was measured.",
    ),
    "segments_read_as_joints": note(
        "The file holds no points but rotations of {count} segments: their origins are read as joint centres",
        "A solver without markers wrote the file.",
        "'motion' reads their rotations, too.",
    ),
    "rigid_bodies_read": note("Rigid bodies ({count}): {bodies}", "The file holds poses of bodies without markers."),
    "body_poses_left_out": note(
        "Poses of rigid bodies are left out, as their markers are there: {bodies}",
        "The file holds a body's pose and its markers.",
    ),
    "body_poses_in_euler_angles": note(
        "Poses of rigid bodies in Euler angles are not supported: {bodies}",
        "The file was exported with another rotation type than quaternions.",
        "Export quaternions.",
    ),
}

MARKERS: dict[str, DiagnosticEntry] = {**_UNIT_AND_AXIS, **_FRAMES_AND_COUNTS, **_POINTS}
"""What readers find in files of markers."""
