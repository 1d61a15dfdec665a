"""Diagnostics of a recording: what is wrong with single views or markers, as a solve finds it."""

from __future__ import annotations

from .entry import DiagnosticEntry, note, warning

RECORDING: dict[str, DiagnosticEntry] = {
    "joints_doubted": warning(
        "Labels name a skeleton's joint centres, but the points fit none. The hips are {size:.0f} % of a thigh apart, "
        "limb joints up to {off:.0f} mm from the body's, the shape up to {shape:.1f} deviations from the mean",
        "Markers on the skin are named like a skeleton's joints.",
        "Write the markers' places with `layout`, and solve with `--layout`.",
    ),
    "markers_off_place": warning(
        "Markers sit far from where their names would put them: {places}. Their names are not used",
        "The names mean other places, or the markers are on a chair or a tool. The solve finds the bone that each "
        "moves with, or leaves it out.",
        "Write how labels are read with `layout`, correct the places, and solve with `--layout`.",
    ),
    "limb_side_found": note(
        "{markers} name no side: read as the {side} one's, where they are beside the trunk",
        "The set is of one arm or leg.",
        "Write the labels' places with `layout`, and solve with `--layout`, if it is the other one.",
    ),
    "limb_side_by_name": note(
        "One {limb} alone has markers: that it is the {side} one is known from its labels alone",
        "The other side's {limb} moves its markers alike, mirrored.",
        "Exchange L and R in the labels if it is the other one.",
    ),
    "marker_in_two_places": warning(
        "Markers sit elsewhere in one take than in another: {places}. They are left out of the person",
        "Two different markers have one name in different takes, or a marker fell off and was attached elsewhere.",
        "Give the marker its own name in each take, or calibrate from the takes that agree.",
    ),
    "names_exchanged_in_takes": note(
        "Names are exchanged in single takes: {places}. They are corrected",
        "Distances and sides of these markers agree with the other takes, or a wrist's with the bend of its elbow, "
        "once their names are exchanged.",
        "To keep the files' names, write them with `layout` and calibrate with `--layout`.",
    ),
    "names_differ_between_takes": warning(
        "Takes differ in names: {places}. They are left as they are",
        "Some takes show these markers the other way round, and neither the number of takes nor the layout decides.",
        "Correct the labels of the takes that are wrong, or calibrate from those that agree.",
    ),
    "limbs_exchanged": note(
        "Camera {camera}: left and right {part} are exchanged",
        "The detector took left for right for a while, often when the person turns away from the camera.",
        "Compare with the footage if the limbs look wrong there.",
    ),
    "limbs_jump_sides": warning(
        "Camera {camera}: left and right {part} jump to each other's places, and not back soon",
        "The detector took left for right before or after this moment, and which of the two is open.",
        "Look at its footage there. Where limbs are wrong, pin a pose, or correct the detections' sides.",
    ),
    "sides_exchanged": warning(
        "Camera {camera}: left and right are exchanged",
        "The keypoints of this view have their left and right names exchanged.",
        "Check the names of the keypoints in this view's files.",
    ),
    "hands_exchanged": note(
        "Camera {camera}: the left and the right hand are exchanged",
        "The detector took one hand for the other; hands are sorted by the wrists they lie at.",
        "Compare with the footage if fingers look wrong there.",
    ),
    "hand_elsewhere": note(
        "Camera {camera}: a hand lies at neither wrist and is left out",
        "The detector found somebody else's hand, or a thing that looks like one.",
        "Look at its footage there if fingers are at rest that the camera sees.",
    ),
    "own_point_placed": note(
        "{joint} is on {bone}, at {offset_mm} mm from its joint in the rest pose; the body is {size:.1f} px from its "
        "detections",
        "keypoints.json puts the point on a bone, and the take shows where.",
    ),
    "own_point_loose": warning(
        "{joint} does not stay with {bone}: it moves by {size:.0f} cm about a place {reach:.0f} cm from the joint. It "
        "is not used",
        "The point is on another bone, or its detections change between places.",
        "Correct its bone in keypoints.json, or leave it out.",
    ),
    "own_point_unseen": warning(
        "{joint} is located in {count} frames, which is too few to place it on {bone}. It is not used",
        "Fewer than two cameras see the point at a time, or the body has no such bone.",
        "Leave it out in keypoints.json, or detect it in more views.",
    ),
    "own_points_one_view": warning(
        "A single camera does not show where {joints} are. They are not used",
        "The place of an own point on its bone is found from two cameras or more.",
        "Give the detections of a second camera.",
    ),
    "hands_one_view": warning(
        "A single camera shows the fingers: how they and the palm turn in depth is estimated",
        "A palm and its mirror image in depth look alike in one view.",
        "Compare the hands with the footage, set them by hand where they are wrong, or add a second camera.",
    ),
    "fingers_through_fingers": warning(
        "Fingers of the {joint} run through one another, by up to {size_mm:.1f} mm",
        "Views disagree on which finger is which, or fingers are crossed.",
        "Compare with the footage there, and set the fingers by hand.",
    ),
    "hand_markers_left_out": warning(
        "Markers near the {side} hand that move with none of its segments are not used: {markers}",
        "They slip, flicker, or are a prop's that the hand holds.",
        "Name them in a layout (L_FT2), or leave them out there (an empty text).",
    ),
    "hands_without_fingers": warning(
        "Hands were detected, and the body has no finger joints",
        "The body file is SMPL's, or one of its own layout.",
        "Solve with the body that ships, or with an SMPL-H or SMPL-X file.",
    ),
    "image_mirrored": warning(
        "Camera {camera}: the image is mirrored",
        "The camera, or the program that records it, mirrors its pictures.",
        "Turn off mirroring in the camera or in what records it.",
    ),
    "names_exchanged": warning(
        "Camera {camera} and camera {other_camera} are exchanged",
        "A folder of detections, or a calibration, has the name of another camera.",
        "Give their folders of detections, or their calibrations, each other's names.",
    ),
    "camera_turned": warning(
        "Camera {camera} is turned by {size:.1f}° against its calibration",
        "The camera was bumped or moved after it was calibrated.",
        "Calibrate it again.",
    ),
    "camera_early": warning(
        "Camera {camera} runs {size:.1f} frames early",
        "The recordings did not start together. The detections are moved in time.",
        "Synchronise the recordings to use every frame.",
    ),
    "camera_late": warning(
        "Camera {camera} runs {size:.1f} frames late",
        "The recordings did not start together. The detections are moved in time.",
        "Synchronise the recordings to use every frame.",
    ),
    "rate_differs": warning(
        "Camera {camera} runs at another rate, by {size:.1f} frames over the take",
        "The camera's clock, or its conversion, has another frame rate. The detections are moved in time.",
        "Record, or convert, all cameras at one rate.",
    ),
    "frames_repeated": warning(
        "Camera {camera} repeats frames, {size:.0f} % of its own",
        "The video was converted to a higher rate, or the detector skips frames.",
        "Use each camera's own rate.",
    ),
    "picture_cuts": warning(
        "Camera {camera}: the picture cuts, or the person jumps from place to place",
        "The video is edited, or the detector switched to somebody else.",
        "Split the video there: what lies before and after the cut is solved as one motion.",
    ),
    "frames_skipped": warning(
        "Frames at regular distances, {size:.0f} % of all, have no detections in any view",
        "The detector looked at some frames alone.",
        "Run the detector on all frames, or convert the videos to the rate it looked at.",
    ),
    "delay_unknown": note(
        "Whether camera {camera} is synchronised is unknown, for too little moves",
        "A delay is measured by movement, and this view shows too little of it.",
        "If the recordings are not synchronised, let the person wave or step before all cameras.",
    ),
    "delay_beyond": warning(
        "Camera {camera} may have started long before or after the others",
        "At its start times within the usual reach it agrees with the others nowhere: it started further apart, or is "
        "of another recording. It is not moved.",
        "Give its start with --offset CAMERA=FRAMES, or check that its files belong to this take.",
    ),
    "delays_unknown": note(
        "Whether the cameras are synchronised is unknown, for too little moves",
        "A delay is measured by movement, and the take has too little of it.",
        "If the recordings are not synchronised, let the person wave or step before all cameras.",
    ),
    "contradicts": warning(
        "Camera {camera} shows something else than the others",
        "Another person, a mirror, or a bumped camera.",
        "Look at its footage there.",
    ),
    "person_away": note(
        "No two cameras see the person",
        "The person left the volume, or is hidden from all cameras but one.",
        "Add a camera that sees the place, or animate the stretch by hand.",
    ),
    "prop_found": note(
        "{count} markers that the person does not wear move as one rigid body, within {size:.1f} mm: solved as the "
        "prop '{prop}'",
        "Somebody holds or moves a thing with markers: a stick, a racket, a box, a chair.",
    ),
    "prop_read": note(
        "The rigid body '{prop}' of the file is a prop",
        "The file holds the poses of a thing, which the program that recorded it found from its markers.",
    ),
    "prop_hidden": note(
        "The pose of the prop '{prop}' is hardly known",
        "Fewer than three of its markers are seen, or those that are lie on one line.",
        "Look at the prop there; its standard deviations show how far it may be off.",
    ),
    "prop_turn_open": note(
        "The markers of the prop '{prop}' lie on one line: its turn about that line is not known, and is kept smooth",
        "A stick with markers along it.",
        "Add a marker beside the line if the turn matters.",
    ),
    "markers_exchanged": note(
        "The markers {marker} and {other_marker} have each other's labels",
        "The labels were exchanged where the take was recorded or labelled.",
        "Correct the labels where the take is kept.",
    ),
    "marker_ghost": note(
        "The marker {marker} is recorded where it cannot be",
        "A reflection, or a wrong label.",
        "Look at the marker there.",
    ),
    "marker_ghosts": note(
        "{count} markers are recorded where they cannot be at times, {markers}",
        "Reflections or wrong labels; a program that writes 0 for one coordinate of a marker that is not seen.",
        "Look at the markers there.",
    ),
    "marker_stills": warning(
        "{count} markers stand still while the person moves, {markers}",
        "The recording repeats the last positions of markers that are not seen.",
        "Export it with gaps left open, or fill them there.",
    ),
    "marker_still": warning(
        "The marker {marker} stands still while the person moves",
        "The marker fell off, or the recording repeats its last position.",
        "Look at the marker there.",
    ),
}
"""By code."""
