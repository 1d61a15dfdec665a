"""Diagnostics of calibrations: what a file was taken for, whose cameras it has, and how the views show it is meant."""

from __future__ import annotations

from .entry import DiagnosticEntry, note, warning

_KEEP = "To keep it as written: --as-calibrated."

CALIBRATION: dict[str, DiagnosticEntry] = {
    "calibration_read": note(
        "Calibration: {count} cameras from {file} ({kind})",
        "Every capture of calibrated cameras names the file that they come from.",
    ),
    "calibration_unit_stated": note(
        "Lengths are read as {unit} (as stated)",
        "The unit was given.",
    ),
    "calibration_unit_assumed": note(
        "Lengths are read as {unit} (the cameras are up to {width:.4g} units apart)",
        "Files of calibrations state no unit; how far apart the cameras are suggests one.",
    ),
    "calibration_unit_of_qualisys": note(
        "Lengths are read as mm, focal lengths as 1/64 pixel (Qualisys)",
        "Qualisys writes these units and no other.",
    ),
    "calibration_up_stated": note(
        "The calibration's world is taken with {axis} up (as stated)",
        "The up axis was given.",
    ),
    "calibration_up_assumed": note(
        "The calibration's world is taken with {axis} up (the default)",
        "Files of calibrations state no up axis; most worlds have Z up.",
    ),
    "calibration_up_of_qualisys": note(
        "The calibration's world is taken with {axis} up (as Qualisys has it)",
        "Qualisys writes worlds with Z up.",
    ),
    "qualisys_view_turned": warning(
        "The view of {camera} is turned by {angle}°",
        "The camera is mounted on its side, and Qualisys Track Manager shows its pictures upright.",
        "If its video is turned too, the calibration does not fit it.",
    ),
    "qualisys_resolution": warning(
        "Videos were recorded with {rows} rows, as the calibration states, and it is of {calibrated}: {cameras}",
        "Qualisys keeps the calibration of the whole sensor when videos are recorded at a lower resolution.",
        "If the views do not show it, detect in videos of the size that was calibrated.",
    ),
    "calibrated_not_recorded": note(
        "Calibrated but not recorded: {cameras}",
        "The recording has fewer cameras than the calibration.",
    ),
    "calibration_of_several": warning(
        "The folder holds several calibrations of these cameras: {used} is used, by which {percent:.0f} % of the "
        "keypoints agree between views; by {other} {percent_other:.0f} % do",
        "Calibrations of several days lie beside one another.",
        "Keep only the recording's calibration in the folder.",
    ),
    "camera_names_matched": note(
        "Recorded cameras by their names in the calibration: {pairs}",
        "Names of recorded and calibrated cameras differ in more than fillers and leading zeros.",
    ),
    "cameras_assigned_by_views": warning(
        "The calibration has other names for its cameras; by the agreement of the views {pairs}",
        "The names of recorded and calibrated cameras have nothing in common.",
        "Another assignment: --camera {camera}={calibrated} and so on.",
    ),
    "cameras_are_others": warning(
        "The recorded cameras are others of the calibration than their names state: by the agreement of the views "
        "{pairs}",
        "Recorders number the cameras that they see from 1, whichever were calibrated.",
        "Another assignment: --camera RECORDED=CALIBRATED for each.",
    ),
    "intrinsics_in_shares": warning(
        "Focal lengths and principal points are shares of the picture: they are taken times its width and height",
        "A script divided the intrinsics by the size of the picture.",
        "Write them in pixels.",
    ),
    "principal_points_missing": warning(
        "All principal points are 0: they are taken to be in the middle of the pictures",
        "The calibration leaves out cx and cy.",
        "Write them, or calibrate the lenses (calibrate-cameras).",
    ),
    "principal_points_offsets": warning(
        "All principal points are near 0: they are taken to be counted from the middle of the pictures",
        "Programs such as Metashape write cx and cy as offsets from the middle.",
        "Write them from the pictures' upper left corner.",
    ),
    "rotations_in_degrees": warning(
        "The rotation vectors are longer than two turns in radians: they are taken to be in degrees",
        "A script or a spreadsheet converted the angles.",
        "Write them in radians.",
    ),
    "world_left_handed": warning(
        "The calibration's world is left-handed (all rotations have determinant -1): its x axis is reversed",
        "It comes from a program such as Unreal, or one axis was negated.",
        "To have another axis reversed, negate that column of all rotations.",
    ),
    "camera_names_exchanged": warning(
        "Cameras have each other's names: by the agreement of the views {pairs}",
        "Folders of cameras were named in another order than the calibration's.",
        _KEEP,
    ),
    "calibration_corrected": warning(
        "The calibration is corrected: {meanings}. With that {percent:.0f} % of the keypoints agree between views, as "
        "written {percent_written:.0f} %",
        "The calibration was made with pictures of another size or turn, or is written in another convention.",
        _KEEP,
    ),
    "calibration_corrected_out_of_step": warning(
        "The calibration is corrected: {meanings}. As written the views agree at no time",
        "The calibration was made with pictures of another size or turn, and the cameras did not start together.",
        _KEEP,
    ),
    "detections_corrected": warning(
        "The detections of all cameras are corrected: {found}",
        "A detector or exporter counts pixels from another edge, mirrors pictures, or exchanges left and right.",
        _KEEP,
    ),
    "person_mirrored": warning(
        "The person is the mirror image of a body: left and right may be exchanged in the keypoints' names, or the "
        "pictures may be mirrored. Which of them is unknown, so the detections stay as they are",
        "A detector or exporter mirrors pictures, or exchanges left and right.",
        "Correct the names or the pictures where they come from.",
    ),
    "camera_rates_differ": warning(
        "Cameras have other frame rates than the take's {rate:.4g} a second: {rates}. Their detections are brought to "
        "it; their videos are not shown",
        "Cameras were set to different frame rates, or their videos were converted.",
        "Record all cameras at one frame rate to see their videos.",
    ),
    "frame_rate_ambiguous": warning(
        "Cameras have several frame rates, and no majority shares one: {cameras}, the fastest, are taken to run at "
        "{rate:.4g} a second",
        "The views show how the rates are related, not which of them is stated. If the stated one is that of the "
        "others, the movement is solved too slow.",
        "Give the fastest cameras' frames a second with --fps.",
    ),
    "focal_lengths_off": warning(
        "All focal lengths seem about {percent:.0f} % too {way}: with others the views agree better. The person's size "
        "and place are off by as much",
        "Lenses were zoomed after the calibration, or recorded in a mode that uses another part of the sensor.",
        "Calibrate the lenses in the mode that was recorded (calibrate-cameras).",
    ),
    "pixels_undistorted": warning(
        "The detections seem to be of undistorted pictures, while the calibration has distortion: without it the views "
        "agree better",
        "A program removed the lenses' distortion from the pictures before it detected in them.",
        "Set the distortion in the calibration to 0, or detect in the pictures as recorded.",
    ),
    "cameras_refined": note(
        "Cameras were refined by the people they film: {before:.1f} px before, {after:.1f} px after (median of views, "
        "on other frames than those fitted to)",
        "The cameras of this capture were refined.",
    ),
}
"""By code."""
