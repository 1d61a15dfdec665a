"""Diagnostics of recordings of views: who is solved, when cameras started, frame rates, frames, videos."""

from __future__ import annotations

from .entry import DiagnosticEntry, note, warning

_TIMES: dict[str, DiagnosticEntry] = {
    "start_given": note("{camera} started {size} frames {direction}, as given", "The offset was given with --offset."),
    "start_unknown": note(
        "Whether {cameras} started with the others is unknown: too little moves there, or the views agree at no offset",
        "The person stands still or is hardly seen, or the calibration is of other cameras.",
    ),
    "start_ambiguous": warning(
        "The cameras may have started apart, but agree alike at several offsets, as in movement that repeats: {camera} "
        "by {one:+.0f} or {other:+.0f} frames against {other_camera}",
        "Walking or another movement that repeats looks the same again after a period.",
        "None is moved: give --offset CAMERA=FRAMES, or --sync off if they started together.",
    ),
    "starts_apart": warning(
        "The cameras did not start together (against {reference}, {starts})",
        "The cameras were started by hand.",
        "To keep them as recorded: --sync off.",
    ),
    "start_left_out": warning(
        "When {cameras} started is unknown, for it shows too little",
        "The camera sees the person for too short a time, or sees nobody.",
        "Give --offset CAMERA=FRAMES to use it.",
    ),
    "take_in_common": note(
        "The take is the {count} frames that the cameras recorded together: it begins at frame {starts}, counted from "
        "each camera's first",
        "The cameras started or stopped at different moments.",
    ),
}
"""When cameras started."""

_RATES: dict[str, DiagnosticEntry] = {
    "frame_rate_given": note("{rate:g} frames a second, as given", "The frame rate was given with --fps."),
    "frame_rate_configured": note(
        "{rate:g} frames a second, from {file}",
        "The recording's settings state the frame rate.",
    ),
    "frame_rate_of_videos": note(
        "{rate:g} frames a second, from the videos",
        "The headers of the videos state the frame rate.",
    ),
    "frame_rate_assumed": warning(
        "Neither Config.toml nor a video states the frame rate; {rate:g} fps is assumed",
        "No videos lie beside the detections, and frame_rate in Config.toml is missing or 'auto'.",
        "Give the frame rate with --fps.",
    ),
    "frame_rate_not_recorded": warning(
        "No config.toml states fps_recording; {rate:g} fps is assumed",
        "The table lies outside of its caliscope project.",
        "Give the frame rate with --fps.",
    ),
    "frame_rate_contradicts": warning(
        "Config.toml states {rate:g} fps, the videos {video:g}; {rate:g} is used",
        "Config.toml is of another recording, or the videos were converted.",
        "Give the frame rate with --fps if it is another.",
    ),
    "video_rates_differ": warning(
        "The videos have different frame rates: {rates} fps",
        "The cameras were set to different rates, or phones vary theirs.",
        "Check that every video is of this recording.",
    ),
}
"""Frames a second."""

_FRAMES: dict[str, DiagnosticEntry] = {
    "frames_configured": note(
        "Frames {first} to {last} of {count}, from Config.toml",
        "Config.toml states frame_range.",
        "Others: --frames FIRST LAST.",
    ),
    "frames_configured_lacking": warning(
        "Config.toml restricts the frames to {first}-{stop}, which the take lacks; all are read",
        "Config.toml is of another recording.",
        "Choose frames with --frames FIRST LAST.",
    ),
    "single_frame": warning(
        "The take is a single frame: a pose, not a motion",
        "The file holds a calibration pose or a picture.",
        "Choose a longer recording for a motion.",
    ),
    "frames_in_text_order": warning(
        "The frames are in the order of their names as texts ({first}, {third}, {second}), and not of their numbers",
        "A detector looked at pictures whose numbers have no leading zeros, in the order of their names.",
        "Run the detector on pictures whose numbers have leading zeros.",
    ),
    "takes_joined": warning(
        "The person jumps in all views at frame {cuts}: several takes may follow one another",
        "The files hold takes that were recorded one after another, or a cut film.",
        "Solve each by itself: --frames 0 {first_end}, and --frames {last_start} {end}.",
    ),
}
"""Which frames are read."""

_VIDEOS: dict[str, DiagnosticEntry] = {
    "video_lengths_differ": warning(
        "The videos have {lengths} frames, the detections {count}",
        "The detector skipped frames, or the videos are of another take.",
        "Check that the detections were made from these videos.",
    ),
    "video_size_differs": warning(
        "The video of {camera} is {video_width} x {video_height} pixels, its calibration is for {width} x {height}; "
        "detections are taken to be in the calibration's pixels",
        "The video was scaled or cropped, or the camera was calibrated at another resolution.",
        "Detect in videos of the calibration's size, or calibrate at the videos'.",
    ),
    "calibration_resized": note(
        "The calibration of {camera} was scaled from {width} x {height} to {video_width} x {video_height} pixels, the "
        "size of its video",
        "The camera was calibrated at another resolution than the one it recorded at.",
    ),
    "image_size_assumed": warning(
        "The image size of {cameras} is not stated; it is taken as twice the principal point",
        "The calibration has no image size, and no video lies beside the detections.",
        "State the size in the calibration.",
    ),
}
"""Videos beside detections."""

_PEOPLE: dict[str, DiagnosticEntry] = {
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
    "largest_person_chosen": note(
        "One camera: the person is whoever is largest for longest, in {seen} of {of} frames",
        "A single camera shows nothing that views could agree on.",
    ),
    "other_tracks": note(
        "{count} other tracks are seen; {solvable} of them can be solved",
        "Other people or a reflection are in the picture, or the person was lost for a while and found again.",
        "Choose another with --person.",
    ),
    "few_views_agree": warning(
        "Of {views:.1f} views that see somebody only {agreeing:.1f} agree on the person",
        "The calibration is of other cameras or another day, or the cameras are not synchronised.",
        "Check that the calibration is the recording's and that the cameras are synchronised.",
    ),
    "camera_sees_elsewhere": warning(
        "Camera {camera} sees one person, but never where the other cameras do",
        "The camera is turned, mirrored, zoomed or late, or has another camera's name; a solve finds which.",
        "It may be turned, mirrored, zoomed, late or named like another.",
    ),
}
"""Who is solved, and who else is seen."""

CAPTURES: dict[str, DiagnosticEntry] = {**_TIMES, **_RATES, **_FRAMES, **_VIDEOS, **_PEOPLE}
