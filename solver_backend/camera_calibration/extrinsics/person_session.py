"""A rig's calibration from a take of a person: poses, scale, gravity and floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens
from solver_backend.camera_calibration.extrinsics.from_person import PersonRig, refined_by_person, rig_from_person
from solver_backend.camera_calibration.extrinsics.result import RigCalibration, moved_world, result_of
from solver_backend.cameras.projection import project
from solver_backend.geometry.alignment import umeyama
from solver_backend.io.recognition.gravity import upright_from_person
from solver_backend.io.recognition.person_scale import scale_from_length, scale_from_stature
from solver_backend.types import Cameras, Keypoints2D

SURE_TILT = np.radians(2.0)
WALKED_M = 0.6
"""Feet that stayed nearer than this tell little of floor and cameras."""

FRAMES_ALIKE = 10
"""Frames that tell the same, for a detector errs alike from frame to frame; by the benchmark's known cameras."""


@dataclass(frozen=True)
class PersonOptions:
    """What is known of the person."""

    stature_m: float | None = None
    """Of the person."""
    known_length: tuple[str, str, float] | None = None
    """Two keypoints and their distance in metres, instead of the stature."""
    free_focal: bool = False
    """Focal lengths are guesses."""
    seed: int = 0
    """Of the samples."""


def calibrate_by_person(
    names: Sequence[str], lenses: Sequence[Lens], keypoints: Keypoints2D, options: PersonOptions = PersonOptions()
) -> RigCalibration:
    """Return cameras in metres with Z up and the floor at zero, from one person's keypoints alone.

    Args:
        names: C names.
        lenses: C lenses of one distortion model.
        keypoints: C synchronous views.
        options: what is known of the person.

    Raises:
        NoDetections, CalibrationInvalid: see ``rig_from_person`` and ``upright_from_person``.
        JobInvalid: see ``scale_from_stature`` and ``scale_from_length``.
    """
    rig = rig_from_person(names, lenses, keypoints, free_focal=options.free_focal, seed=options.seed)
    joints = keypoints.joint_set
    if options.known_length is not None:
        a, b, length = options.known_length
        scale = scale_from_length(rig.points, joints, (a, b), length)
        note, doubt = f"The scale is by {a} to {b}, {length:g} m.", ()
    else:
        scale, share = scale_from_stature(rig.points, joints, options.stature_m)
        who = f"a stature of {options.stature_m:g} m" if options.stature_m else "people's mean stature"
        note = f"The scale is by {who}, {share:.1%} sure."
        doubt = () if options.stature_m else (f"The stature is unknown: lengths may be wrong by {2 * share:.0%}.",)
    upright = upright_from_person(scale * rig.points, joints)
    found = _result("person", rig)
    calibration = moved_world(found, upright.R, upright.t, scale)
    words = list(doubt)
    if upright.tilt_sigma > SURE_TILT:
        words.append(
            f"Up is known to {np.degrees(upright.tilt_sigma):.0f} degrees only: let the person stand tall and walk."
        )
    if upright.walked_m < WALKED_M:
        words.append(
            f"The person stayed within {upright.walked_m:.1f} m, which holds cameras badly; let her walk through all "
            "of the space that takes will use."
        )
    if rig.inlier_share < 0.8:
        words.append(
            f"{1 - rig.inlier_share:.0%} of the keypoints fit no cameras: is it one person, are views synchronous?"
        )
    return replace(
        calibration,
        findings=tuple(words),
        notes=(note, f"Keypoints of {len(rig.frames)} frames err by {rig.sigma_px:.1f} px per axis."),
    )


def refine_by_person(cameras: Cameras, keypoints: Keypoints2D, *, free_focal: bool = False) -> RigCalibration:
    """Return an earlier calibration made to fit a take, in its own world and scale.

    Args:
        cameras: as they were calibrated.
        keypoints: of one person in the same views.
        free_focal: focal lengths change too.

    Raises:
        NoDetections: no two cameras see the person at once.
    """
    rig = refined_by_person(cameras, keypoints, free_focal=free_focal)
    found = _result("refine", rig)
    scale, R, t = umeyama(found.cameras.centres, cameras.centres, with_scale=True)
    refined = moved_world(found, np.asarray(R), np.asarray(t), float(scale))
    moved = np.linalg.norm(refined.cameras.centres - cameras.centres, axis=1)
    words = [
        f"{name} stands {1000 * far:.0f} mm from where it was calibrated; it was moved, or was calibrated badly."
        for name, far in zip(cameras.names, moved, strict=True)
        if far > 0.03
    ]
    before = _rmse(cameras, rig, keypoints)
    note = (
        f"The take's keypoints err by {rig.sigma_px:.1f} px per axis, with the calibration as it was by {before:.1f}."
    )
    return replace(refined, findings=tuple(words), notes=(note,))


def _result(method: str, rig: PersonRig) -> RigCalibration:
    found = result_of(method, rig.adjusted)
    alike = np.sqrt(min(FRAMES_ALIKE, len(rig.frames)))
    return replace(found, centre_sigma_m=found.centre_sigma_m * alike, turn_sigma=found.turn_sigma * alike)


def _rmse(cameras: Cameras, rig: PersonRig, keypoints: Keypoints2D) -> float:
    """Return the median error per axis of points located by the given cameras."""
    from solver_backend.cameras.triangulation.triangulate import triangulate

    xy, confidence = keypoints.xy[:, rig.frames], keypoints.confidence[:, rig.frames]
    points = triangulate(cameras, xy, confidence).points
    px = project(cameras.K, cameras.distortion, cameras.R, cameras.t, points, cameras.distortion_model)
    return float(np.nanmedian(np.linalg.norm(px - xy, axis=-1)) / 1.1774)
