"""Diagnostics of a capture's numbers: what cannot be is an error, what is merely odd a warning."""

from __future__ import annotations

from .entry import DiagnosticEntry, error, warning

_CHECK = "Check the file's units and the order of its values."
_FOCAL_LENGTHS = (
    "The focal lengths of {camera} are {fx:.4g} and {fy:.4g} pixels for a picture of {width} x {height}",
    "The intrinsic matrix is in another unit than pixels, or of pictures of another size.",
)

RANGES: dict[str, DiagnosticEntry] = {
    "intrinsics_impossible": error(
        "The intrinsic matrix of {camera} has the rows {second} and {third}; (0, fy, cy) and (0, 0, 1) are expected",
        "The matrix is transposed, or its values are in another order.",
        _CHECK,
    ),
    "focal_length_impossible": error(*_FOCAL_LENGTHS, _CHECK),
    "focal_length_odd": warning(*_FOCAL_LENGTHS, "Check that the intrinsic matrix is in pixels, and for this size."),
    "centre_outside": warning(
        "The principal point of {camera}, ({x:.5g}, {y:.5g}), lies outside its picture of {width} x {height}",
        "The intrinsic matrix is of pictures of another size, or of a part of them.",
        "Check the intrinsic matrix and the picture's size.",
    ),
    "distortion_folds": warning(
        "The distortion of {camera} folds inside its picture, {size:.0f} pixels from its centre",
        "The board was never seen near the edges, or the coefficients are in another order.",
        "Check the coefficients and their order.",
    ),
    "camera_place_impossible": error(
        "The camera {camera} would stand {size:.3g} km from the origin",
        "The file has another unit, or is damaged.",
        _CHECK,
    ),
    "cameras_far": warning(
        "Cameras stand more than {most:g} m from the others: {places}",
        "The calibration has another unit.",
        "Check the calibration's unit.",
    ),
    "cameras_coincide": warning(
        "The cameras {camera} and {other_camera} stand {size:.1f} mm apart",
        "A camera was copied in the calibration.",
        "Check whether one is a copy of the other.",
    ),
    "rate_impossible": error(
        "The frame rate must be {least:g} to {most:g}, not {rate:g}",
        "The file states another unit, or its rate is damaged.",
        _CHECK,
    ),
    "rate_odd": warning(
        "{rate:g} frames a second is not what cameras record",
        "The file states another unit or no rate.",
        "Give the rate if it is another.",
    ),
    "detections_impossible": error(
        "{percent:.0f} % of the detections lie more than {most:g} picture sizes outside",
        "The detections are in another unit than pixels.",
        _CHECK,
    ),
    "detections_outside": warning(
        "{percent:.0f} % of the detections lie far outside their pictures",
        "The pictures were calibrated in another size than they were detected in.",
        "Check that they are in pixels of the calibration's pictures.",
    ),
    "capture_empty": error(
        "The capture holds no keypoints, and no frame of its markers",
        "The export was stopped, or of an empty stretch.",
        "Export the recording again.",
    ),
    "marker_place_impossible": error(
        "The marker {marker} would be {size:.3g} km from the origin",
        "The file has another unit, or is damaged.",
        _CHECK,
    ),
}
"""By code."""
