"""Diagnostics of files of detections: joint sets, names of keypoints, confidences, pixels, missing files."""

from __future__ import annotations

from .entry import DiagnosticEntry, note, warning

DETECTIONS: dict[str, DiagnosticEntry] = {
    "joint_set_given": note("Joint set {joint_set}, as given", "The joint set was chosen with --joint-set."),
    "joint_set_configured": note(
        "Joint set {joint_set}, from Config.toml",
        "Config.toml states pose_model, and the keypoints fit it.",
    ),
    "joint_set_by_count": note(
        "Joint set {joint_set}: the only one with {count} keypoints",
        "The files do not name their keypoints, and one joint set alone has as many.",
    ),
    "joint_set_unlike": note(
        "Joint set {joint_set}: the only one with {count} keypoints, though its bones are too long",
        "The detector writes its keypoints in another order.",
    ),
    "joint_set_recognised": note(
        "Joint set {joint_set}, recognised by anatomy: as {rival} the bones would be {ratio:.1f} times as long",
        "The files do not name their keypoints, and several joint sets have as many.",
    ),
    "joint_set_unseen": note(
        "Joint set {joint_set} is assumed: nobody is seen well enough to recognise it",
        "Hardly any keypoint has a confidence.",
    ),
    "joint_set_uncertain": warning(
        "The joint set is not certain; it is taken as {joint_set}",
        "Several joint sets fit the keypoints almost as well, or none fits them.",
        "Others: --joint-set.",
    ),
    "joint_set_contradicts": warning(
        "Config.toml names {configured}, but the keypoints are {joint_set}'s",
        "The detections were made with another model than the one in Config.toml.",
        "Correct pose_model in Config.toml, or give the joint set with --joint-set.",
    ),
    "keypoints_named": note(
        "Joint set {joint_set}, by the names of the keypoints",
        "The files name their keypoints.",
    ),
    "keypoints_named_by_file": note(
        "Joint set {joint_set}, by the names of the keypoints and {file}",
        "A file keypoints.json beside the recording states what its keypoints are.",
    ),
    "keypoints_unknown": note(
        "Named keypoints that {joint_set} lacks are left out: {joints}",
        "The detector finds points that are not on the body, or are named unusually.",
    ),
    "keypoints_lacking": warning(
        "The cameras' files name different keypoints: {camera} lacks {joints}",
        "The cameras' files were written by different models, or columns were deleted.",
        "Export all cameras with one model, in one format.",
    ),
    "own_points_absent": warning(
        "The files name no {joints}, which keypoints.json puts on bones",
        "A name in keypoints.json is spelled otherwise, or the model has another version.",
        "Correct the names under points in keypoints.json.",
    ),
    "keypoints_nan": warning(
        "{count} keypoints are NaN with a confidence; they are taken as not seen",
        "The program that wrote the files keeps the confidence of keypoints that it removed.",
        "Write 0 0 0 for a keypoint that was not seen.",
    ),
    "placeholder_unseen": note(
        "Keypoints at ({u:g}, {v:g}) are taken as not seen: most kinds of keypoints stand there",
        "The detector writes this place for keypoints that it does not find.",
    ),
    "frame_files_missing": warning(
        "{count} frame files are missing; nobody is seen there",
        "Files were lost, or the detector writes none where it finds nobody.",
        "Run the detector on these frames again, if the person is there.",
    ),
    "frames_counted_together": note(
        "One counter ran over the pictures of all cameras: each camera's frames are counted in their order",
        "A recorder numbers what it receives, whichever camera it is from.",
    ),
    "confidence_above_one": note(
        "Confidences reach {largest:.3g}; those above 1 are taken as 1",
        "The detector's scores go a little beyond 1.",
    ),
    "confidence_per_cent": warning(
        "The confidences are per cent (up to {largest:.3g}); they are divided by 100",
        "The detector, or an export, writes confidences from 0 to 100.",
        "Write confidences from 0 to 1, if these are not confidences.",
    ),
    "confidence_beyond": warning(
        "The confidences reach {largest:.3g}, neither 0..1 nor per cent; those above 1 are taken as 1",
        "The file holds other scores, such as logits, or another column in their place.",
        "Write confidences from 0 to 1.",
    ),
    "confidence_flat": warning(
        "Every keypoint that is seen has the same confidence, {largest:.3g}; it does not show which to trust. It is "
        "taken as 1, and keypoints are weighed by their agreement alone",
        "The program that wrote the files has no confidences and fills in a constant.",
        "Export the detector's own confidences, if it has any.",
    ),
    "shares_of_picture": note(
        "The detections are shares of the picture (0..1); they are multiplied by its width and height",
        "MediaPipe and Ultralytics write coordinates as shares of the picture.",
    ),
    "shares_about_centre": note(
        "The detections run from -1 to 1 over the picture (OpenPose's keypoint_scale 4); they are made pixels",
        "OpenPose was run with --keypoint_scale 4.",
    ),
}
