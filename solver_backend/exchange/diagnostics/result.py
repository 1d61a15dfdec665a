"""Diagnostics of a result: what a solve shows of itself, and what no person does."""

from __future__ import annotations

from .entry import DiagnosticEntry, error, note, warning

_FAR = "A limb is swapped, hidden or badly detected."
_FAR_MARKERS = "Markers are labelled wrongly, exchanged or loose."
_COMPARE = "Compare with the footage there."

RESULT: dict[str, DiagnosticEntry] = {
    "setting_without_effect": warning(
        "The method '{method}' does not use {settings}: the motion is the same without",
        "The setting is one of another method.",
        "Choose the method that has it, or leave the setting out.",
    ),
    "one_camera": warning(
        "One camera: distance and the depth of limbs are estimated, not measured. Limbs are known to ± {size:.0f} cm "
        "along the line of sight, the person's size and distance to ± {share:.0f} %, from {source}",
        "A picture holds neither how far away a person is nor how far a limb points towards the camera.",
        "Look at the motion from the side, pin poses that are wrong, or add a second camera.",
    ),
    "focal_length_unsure": warning(
        "Camera {camera}: the focal length is known to {share:.0f} %, distances may be off by as much",
        "The video has no calibration: its focal length is a guess, or a 35 mm equivalent.",
        "Give the lens with --lenses or --focal, or calibrate the camera.",
    ),
    "up_from_person": warning(
        "Camera {camera}: up and floor are estimated from the person, the motion may lean by 10°",
        "One camera without a calibrated floor sees neither.",
        "Calibrate where the camera stands, or turn the body in the scene.",
    ),
    "stature_at_odds": warning(
        "The person is taken to be {given:.2f} m tall, by {source}; with feet on the floor it would be "
        "{measured:.2f} ± {sigma:.2f} m. The floor is not used",
        "The stature is another person's, the calibration's floor is not where the feet are, or the camera moved.",
        "Check the stature, and the height of the camera over the floor.",
    ),
    "person_glides": warning(
        "The person moves by up to {size:.1f} m without a step",
        "The camera zooms or moves, or the person rides on something: one camera cannot distinguish these.",
        "Film with a camera that stands still and does not zoom.",
    ),
    "feet_never_stand": note(
        "No foot stands still on the floor for long",
        "The person jumps, hangs or swims, the feet are not in the picture, or the floor is elsewhere.",
        "The height over the floor follows from the person's size alone: check it.",
    ),
    "limb_depth_open": warning(
        "The depth of the {part} is open",
        "From this side, poses that differ in depth look alike; a limb may point the other way.",
        "Look at it from the side, and pin a pose there if it is wrong.",
    ),
    "frames_unseen": warning(
        "Fewer than two cameras see the person; the pose is interpolated",
        "The person is hidden, out of view or not detected.",
        "Detect again there, add a camera that sees the place, or animate the stretch by hand.",
    ),
    "frames_unseen_one_view": warning(
        "The camera does not see the person; the pose is interpolated",
        "The person is hidden, out of the picture or not detected.",
        "Detect again there, or animate the stretch by hand.",
    ),
    "frames_unseen_markers": warning(
        "Too few markers are seen; the pose is interpolated",
        "Markers are hidden, or missing in the file.",
        "Fill the gaps in the program that recorded them, or animate the stretch by hand.",
    ),
    "frames_unsure": warning(
        "The body is far from the detections, or some joint is hardly known ({percent:.1f} % of the frames)",
        _FAR,
        _COMPARE,
    ),
    "few_frames_unsure": note(
        "The body is far from the detections, or some joint is hardly known ({percent:.1f} % of the frames)",
        _FAR,
        _COMPARE,
    ),
    "frames_unsure_markers": warning(
        "The body is far from the markers, or some joint is hardly known ({percent:.1f} % of the frames)",
        _FAR_MARKERS,
        "Look for markers that are labelled wrongly, exchanged or loose there.",
    ),
    "few_frames_unsure_markers": note(
        "The body is far from the markers, or some joint is hardly known ({percent:.1f} % of the frames)",
        _FAR_MARKERS,
        "Look for markers that are labelled wrongly, exchanged or loose there.",
    ),
    "parts_at_rest": warning(
        "{part} by two cameras: shown at rest",
        "Cameras see the body in part, or the recording's keypoints are of a part.",
        "Their posture is assumed, and its stated deviation is what people do; add cameras if it matters.",
    ),
    "parts_at_rest_markers": note(
        "{part}: shown at rest",
        "The marker set is of a part of the body, or a limb's markers are missing there.",
        "Their posture is assumed, and its stated deviation is what people do; add markers if it matters.",
    ),
    "place_assumed": warning(
        "Nothing is seen near {part}: their places are assumed, to ± {mm:.0f} mm",
        "Markers or keypoints are of a limb or two, of the feet, or of an upper body without the pelvis.",
        "Use what is seen; add markers at the pelvis and trunk for the rest.",
    ),
    "views_disagree_with_result": warning(
        "Only {percent:.0f} % of the detections agree with the solved body",
        "Cameras are not synchronised, moved, calibrated for another recording, or follow different people.",
        "Check the calibration, the synchronisation and who is detected in each view.",
    ),
    "views_apart": warning(
        "Only {percent:.0f} % of the views that see somebody see the person where the body is",
        "Some cameras are not synchronised, moved, calibrated for another recording, or follow somebody else.",
        "Check the calibration, the synchronisation and who is detected in {cameras}.",
    ),
    "views_contradict": error(
        "Only {percent:.0f} % of the views that see somebody see the person where the body is",
        "The cameras are not synchronised, or the calibration is of other pictures, places or names.",
        "Check the calibration and the synchronisation of {cameras}.",
    ),
    "residual_large": warning(
        "The solved body is {size:.0f} px (median) from the detections, {share:.0f} % of the person's size; "
        "detectors are within {limit:.0f} %",
        "The calibration does not belong to the recording, or the cameras are not synchronised.",
        "Check the calibration and the synchronisation.",
    ),
    "residual_impossible": error(
        "The solved body is {size:.0f} px (median) from the detections, {share:.0f} % of the person's size; "
        "detectors are within {limit:.0f} %",
        "The calibration does not belong to the recording, or the cameras are not synchronised.",
        "Check the calibration and the synchronisation.",
    ),
    "markers_far": warning(
        "The solved body is {size:.0f} mm (median) from the {kind}; it follows them within {limit:.0f} mm elsewhere",
        "Labels or axes are wrong, tracks are shifted in time, the subject file is of somebody else, or the points are "
        "not of a person.",
        "Check the labels and the subject file, and look at the recording in the program that wrote it.",
    ),
    "marker_far": warning(
        "The marker {marker} is {size:.0f} mm (median) from where the body has it",
        "It is labelled wrongly, sits elsewhere than its name states, or the body is wrong there.",
        "Look at the marker; correct its label or place (`layout`), or leave it out.",
    ),
    "marker_far_for_a_while": warning(
        "The marker {marker} is up to {size:.0f} mm from where the body has it",
        "It is labelled wrongly there, was touched, or the body did not follow.",
        "Look at the marker there.",
    ),
    "markers_of_nobody": error(
        "{count} of the {named} markers with names of a body sit where none of a person can",
        "The markers are on an animal or a machine, or the names mean other places.",
        "Correct the names; or write how labels are read with `layout`, correct the places, and solve with `--layout`.",
    ),
    "markers_impossible": error(
        "The solved body is {size:.0f} mm (median) from the {kind}; it follows them within {limit:.0f} mm elsewhere",
        "Labels or axes are wrong, tracks are shifted in time, the subject file is of somebody else, or the points are "
        "not of a person.",
        "Check the labels and the subject file, and look at the recording in the program that wrote it.",
    ),
    "camera_disagrees": warning(
        "Camera {camera} disagrees with the others: {size:.1f} px against {usual:.1f} px",
        "The camera moved during the take, is not synchronised, or its calibration is off.",
        "Check its calibration, whether it moved during the take, and whether it is synchronised.",
    ),
    "camera_sees_little": note(
        "Camera {camera} detects only {percent:.0f} % of the keypoints",
        "The person is seldom in its view, or the picture is too dark, too small or blurred.",
        "Check that the person is in its view, its exposure, and the detector's input.",
    ),
    "keypoints_seldom_seen": note(
        "Seldom detected by two cameras: {shares}",
        "These keypoints are hidden in most views, or the detector does not find them.",
        "What hangs on them comes from the pose prior and the neighbouring frames.",
    ),
    "keypoints_seldom_seen_one_view": note(
        "Seldom detected: {shares}",
        "These keypoints are hidden or outside the picture, or the detector does not find them.",
        "What hangs on them comes from the pose prior and the neighbouring frames.",
    ),
    "keypoints_often_outliers": note(
        "Often an outlier: {shares}",
        "Swapped sides or an occlusion in that view. The solve gives these detections little weight.",
        "If they matter, look for swapped sides or an occlusion in that view.",
    ),
    "take_drifts": warning(
        "The body {way} by {size:.1f} m over the take, with its lowest joint",
        "Inertial suits and single cameras lose their height; or the person climbs, or walks up or down.",
        "Level the take by its contacts in the program that recorded it, if the ground was flat.",
    ),
    "floor_too_high": warning(
        "A foot goes {size:.0f} cm below the floor in most frames",
        "The calibration's origin is not on the floor, or its Z does not point up.",
        "Check that the calibration's origin lies on the floor and that Z points up.",
    ),
    "floor_too_high_markers": warning(
        "A foot goes {size:.0f} cm below z = 0 in most frames",
        "The recording's origin is above the floor, as where a wand stood on a box, or is a camera.",
        "Move the body to the floor (*Feet to Floor*), or set the origin on the floor in the program that recorded it.",
    ),
    "foot_below_floor": note(
        "A foot goes {size:.0f} cm below the floor",
        "The floor is not level or not at z = 0, or the feet are badly detected.",
        "Check that the calibration's origin lies on the floor and that Z points up.",
    ),
    "foot_below_floor_markers": note(
        "A foot goes {size:.0f} cm below z = 0",
        "The floor is not at z = 0 there, the person steps down, or a foot's markers are wrong.",
        "Look at the feet there; move the body to the floor (*Feet to Floor*) if all of it is too low.",
    ),
    "feet_above_floor": warning(
        "The feet are {size:.0f} cm above the floor in most frames",
        "The calibration's origin is below the floor, or the person stands on something.",
        "Level the world with --level on, or check that the calibration's origin lies on the floor.",
    ),
    "feet_above_floor_markers": warning(
        "The feet are {size:.0f} cm above z = 0 in most frames",
        "The recording's origin is below the floor, or the person stands on something.",
        "Move the body to the floor (*Feet to Floor*) if the person stands on it.",
    ),
    "hips_never_move": warning(
        "The middle of the hips is at one place in all frames: positions are relative to it",
        "The program writes points relative to the hips, as MediaPipe's world landmarks are.",
        "Export positions in the room if the person's travel and the floor matter.",
    ),
    "person_tilted": warning(
        "The person stands tilted by {size:.0f}° (± {sigma:.0f}°) against the world's up",
        "The calibration's world is not level, or the person leans for the whole take.",
        "Level the world with --level on, unless the person leans.",
    ),
    "person_tilted_markers": warning(
        "The person stands tilted by {size:.0f}° (± {sigma:.0f}°) against the world's up",
        "The points have a camera's axes, or the person leans for the whole take.",
        "Turn the points upright in the program that computed them, unless the person leans.",
    ),
    "feet_slide": warning(
        "The feet slide by {size:.2f} cm a frame while they are on the floor",
        "The toes are seldom detected, or the cameras are not synchronised.",
        "Look at the feet in the baked scene.",
    ),
    "feet_slide_markers": warning(
        "The feet slide by {size:.2f} cm a frame while they are on the floor",
        "The person slides or walks on a treadmill, or a foot's markers are wrong.",
        "Look at the feet in the baked scene.",
    ),
    "frame_rate_implausible": warning(
        "The frame rate of {rate:g} a second seems too {way}: people {movement} so at about {likely:g}",
        "The recording was converted, filmed in slow motion or thinned out, or the rate was assumed.",
        "Compare the take's length in seconds with the real one; if the rate is wrong, give it: --fps {likely:g}.",
    ),
    "stature_odd": warning(
        "The solved body is {size:.2f} m tall; adults are {least:g} to {most:g} m",
        "It is a child; or the calibration has another unit or scale, or the detections are not of a person.",
        "Unless it is a child, check the unit of the calibration, or the size of the board's squares.",
    ),
    "stature_odd_markers": warning(
        "The solved body is {size:.2f} m tall; adults are {least:g} to {most:g} m",
        "It is a child; or the file's unit is another than it is read in, or the markers are not of a person.",
        "Unless it is a child, give the unit with --unit (mm, cm, m, inch, foot).",
    ),
    "stature_impossible": error(
        "The solved body is {size:.2f} m tall; people are {least:g} to {most:g} m",
        "The calibration has another unit or scale: squares of a board, or none at all.",
        "Give the person's stature with --stature, or the calibration's scale or unit with --scale or --unit.",
    ),
    "stature_impossible_markers": error(
        "The solved body is {size:.2f} m tall; people are {least:g} to {most:g} m",
        "The file's unit is another than it is read in, or the markers are not of a person.",
        "Give the unit with --unit (mm, cm, m, inch, foot).",
    ),
    "shape_odd": warning(
        "A shape coefficient is {size:.3g}; those of adults lie within {limit:g}",
        "It is a child, or the shape follows wrong measurements: scale, labels or calibration.",
        "Unless it is a child, check the scale (of keypoints: --stature) and the labels; or give a calibrated subject "
        "or a known shape.",
    ),
    "motion_rate_odd": warning(
        "{rate:g} frames a second is not what is recorded",
        "The file states another unit or no rate.",
        "Give the frame rate if it is another.",
    ),
    "motion_too_fast": warning(
        "The body moves at up to {size:.3g} m/s",
        "The frame rate or the unit is wrong, or the pose jumps.",
        "Check the rate and the unit, and look at the motion there.",
    ),
    "pose_outside_anatomy": warning(
        "Joints are turned far beyond what people's can, in {count} frames: {excess}",
        "Left and right are exchanged, the axes or the order of the joints is another, or the pose is wrong.",
        "Check left and right, the axes and the order of the joints, and look at the motion there.",
    ),
    "motion_rate_impossible": error(
        "The frame rate must be {least:g} to {most:g}, not {rate:g}",
        "The file states another unit, or its rate is damaged.",
        "Check the file's rate.",
    ),
    "motion_place_impossible": error(
        "The body would be {size:.3g} km from the origin",
        "The file has another unit, or is damaged.",
        "Check the file's units.",
    ),
}
"""By code."""
