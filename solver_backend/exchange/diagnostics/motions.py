"""Diagnostics of motions of other programs that are brought onto our body."""

from __future__ import annotations

from .entry import DiagnosticEntry, note, warning

_SKELETONS: dict[str, DiagnosticEntry] = {
    "motion_limbs_missing": warning(
        "No joints were found for {parts}: they stay as at rest",
        "The clip has no such joints, or neither names nor lengths show which of its joints they are.",
        "Give the joints usual names (LeftArm, LeftForeArm, LeftHand), or map the rig in Blender and import it there.",
    ),
    "motion_skeleton_unclear": note(
        "{doubt}",
        "Joints can be seen as a person's in several ways that are nearly as good.",
    ),
    "motion_rest_bent": warning(
        "The rest pose is not a T- or A-pose: the {part} is bent by {angle:.0f}°. Trunk and twists are counted from it "
        "and may be off",
        "The file keeps no rest pose, and the importer took the pose of a frame for it.",
        "Export the clip with its skin, or from a T-pose.",
    ),
    "motion_lengths_strange": warning(
        "The lengths are unusual for a person: shape {size:.1f} deviations from the mean",
        "The skeleton is a cartoon's or lacks a bone, such as that of the upper chest.",
        "Compare the motion with the clip.",
    ),
    "motion_joints_elsewhere": warning(
        "Joints that the skeleton has elsewhere than a person of its lengths: {off}",
        "Bones are stretched, or joints are not those of a person.",
        "Compare the motion with the clip there.",
    ),
}
"""Of the skeleton that moves."""

_CLIPS: dict[str, DiagnosticEntry] = {
    "motion_unit_estimated": note(
        "Unit estimated from the legs: {unit}, legs of {length:.2f} m",
        "The file states no unit.",
    ),
    "motion_up_detected": note(
        "The trunk points along {axis}, which is used as the up axis",
        "The file states no up axis.",
    ),
    "motion_segments_unseen": warning(
        "Segments are not seen and stay as they were last",
        "Markers or cameras lost a part of the person.",
        "Edit or cut the motion there.",
    ),
    "motion_first_frame_apart": warning(
        "The first frame is apart from the second by {angle:.0f}°",
        "The file begins with a T-pose that is not part of the motion.",
        "Cut the first frame before smoothing or retargeting.",
    ),
    "motion_one_frame": note(
        "One frame: the clip is a pose",
        "The file holds a single frame.",
    ),
    "motion_on_floor": note(
        "{way} by {size:.2f} m, so that the soles stand on the floor; see --keep-height",
        "The clip's floor is elsewhere, or its height is counted from the hips.",
    ),
    "motion_mean_shape": note(
        "Joints turn as in the file, on a body of mean shape: AMASS' shapes are those of other bodies",
        "Coefficients of a shape belong to the body that they were fitted with.",
    ),
}
"""Of the clip and its file."""

MOTIONS: dict[str, DiagnosticEntry] = {**_SKELETONS, **_CLIPS}
"""By code."""
