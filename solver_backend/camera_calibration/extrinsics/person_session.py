"""Calibrate cameras from a take of a person: poses, scale, gravity and floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens
from solver_backend.camera_calibration.extrinsics.from_person import (
    FRAMES_ALIKE,
    PersonCalibration,
    calibrate_from_person,
    refined_by_person,
)
from solver_backend.camera_calibration.extrinsics.two_views import CalibratedCameras, moved_world, result_of
from solver_backend.cameras.refinement import view_distances
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import NoDetections
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import log_so3
from solver_backend.io.recognition.gravity import upright_from_person
from solver_backend.io.recognition.person_scale import scale_from_length, scale_from_stature
from solver_backend.types import Cameras, Keypoints2D

SURE_TILT = np.radians(2.0)
"""Largest standard deviation of a sure up axis, in radians. Chosen by hand."""
WALKED_M = 0.6
"""Least path of the feet that determines floor and cameras, in metres."""
LEAST_GAIN = 0.03
"""Least gain of refined cameras, as a share. They always gain a little, because they are fitted to the take
(1.3 % on 120 frames with true cameras, 28 % with a slightly wrong real calibration)."""
MOVED_SIGMAS = 3.0
"""A camera with a larger displacement has moved, in standard deviations. Chosen by hand."""
_ARMS, _ROUNDS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), 60


@dataclass(frozen=True)
class PersonOptions:
    """Facts about the person."""

    stature_m: float | None = None
    """Stature of the person, in metres."""
    known_length: tuple[str, str, float] | None = None
    """Two keypoints and their distance in metres, instead of the stature."""
    free_focal: bool = False
    """Estimate focal lengths too."""
    seed: int = 0
    """Seed of the random samples."""


def calibrate_by_person(
    names: Sequence[str], lenses: Sequence[Lens], keypoints: Keypoints2D, options: PersonOptions = PersonOptions()
) -> CalibratedCameras:
    """Return cameras in metres with Z up and the floor at zero, from one person's keypoints alone."""
    solved = calibrate_from_person(names, lenses, keypoints, free_focal=options.free_focal, seed=options.seed)
    joints = keypoints.joint_set
    words: list[Diagnostic] = []
    if options.known_length is not None:
        a, b, length = options.known_length
        scale = scale_from_length(solved.points, joints, (a, b), length)
        note = diagnostic("cameras_scale", source="length", joints=[a, b], length=length)
    else:
        scale, share = scale_from_stature(solved.points, joints, options.stature_m)
        if options.stature_m:
            note = diagnostic("cameras_scale", source="stature", stature=options.stature_m, percent=100 * share)
        else:
            note = diagnostic("cameras_scale", source="mean", percent=100 * share)
            words.append(diagnostic("cameras_stature_unknown", percent=200 * share))
    upright = upright_from_person(scale * solved.points, joints)
    found = _result("person", solved)
    calibration = moved_world(found, upright.R, upright.t, scale)
    if upright.tilt_sigma > SURE_TILT:
        words.append(diagnostic("cameras_up_unsure", angle=np.degrees(upright.tilt_sigma)))
    if upright.walked_m < WALKED_M:
        words.append(diagnostic("cameras_person_stayed", size=upright.walked_m))
    if solved.inlier_share < 0.8:
        words.append(diagnostic("cameras_keypoints_left", percent=100 * (1 - solved.inlier_share)))
    used = {"evidence": "keypoints", "count": len(solved.frames), "size": solved.sigma_px}
    return replace(calibration, findings=tuple(words), notes=(note, diagnostic("calibration_evidence", **used)))


def refine_by_person(cameras: Cameras, keypoints: Keypoints2D, *, free_focal: bool = False) -> CalibratedCameras:
    """Fit an earlier calibration to a take in its own world and scale, or keep it if it fits as well.

    Unmoved cameras stay where they are, so that moved ones are visible, see ``align_cameras``.

    Raises:
        NoDetections: no two cameras see the person at once.
    """
    solved = refined_by_person(cameras, keypoints, free_focal=free_focal)
    found = _result("refine", solved)
    refined = moved_world(found, *align_cameras(found.cameras, cameras))
    xy, confidence = keypoints.xy[:, solved.frames], keypoints.confidence[:, solved.frames]
    before, after = (_mean_distance(view_distances(c, xy, confidence)) for c in (cameras, refined.cameras))
    if not after < (1.0 - LEAST_GAIN) * before:
        return replace(refined, cameras=cameras, notes=(diagnostic("cameras_kept", after=after, before=before),))
    note = diagnostic("cameras_refined", after=after, before=before)
    return replace(refined, findings=_moved(refined, cameras), notes=(note,))


def _mean_distance(distances: np.ndarray) -> float:
    known = distances[np.isfinite(distances)]
    if not len(known):
        hint = "Check which video is which camera's, and their times."
        raise NoDetections("No keypoint is seen by two cameras at once.", hint=hint)
    return float(known.mean())


def _moved(refined: CalibratedCameras, cameras: Cameras) -> tuple[Diagnostic, ...]:
    far, away = (np.sqrt(s**2 + (s**2).mean()) for s in (refined.centre_sigma_m, refined.turn_sigma))
    moved = np.linalg.norm(refined.cameras.centres - cameras.centres, axis=1)
    turned = np.linalg.norm(log_so3(refined.cameras.R @ cameras.R.swapaxes(-1, -2)), axis=-1)
    found: list[Diagnostic] = []
    for c, name in enumerate(cameras.names):
        parts: list[str] = []
        if moved[c] > MOVED_SIGMAS * far[c]:
            parts.append(f"stands {1000 * moved[c]:.0f} mm (± {1000 * far[c]:.0f}) from")
        if turned[c] > MOVED_SIGMAS * away[c]:
            parts.append(f"points {np.degrees(turned[c]):.1f}° (± {np.degrees(away[c]):.1f}) away from")
        if parts:
            found.append(diagnostic("camera_moved", amount="refined", cameras=[name], moves=" and ".join(parts)))
    return tuple(found)


def align_cameras(cameras: Cameras, to: Cameras) -> tuple[np.ndarray, np.ndarray, float]:
    """Return rotation, translation and scale that align cameras with others, exactly for unmoved ones.

    Each camera is represented by its centre and two points on its axes, as far away as cameras are apart. Reweighted
    least squares minimise the sum of distances, and then the sum of their roots, so that a moved camera does not drag
    the others along.
    """
    arm = np.linalg.norm(to.centres - to.centres.mean(0), axis=1).mean()
    theirs = to.centres[:, None] + arm * _ARMS @ to.R
    s = arm / np.linalg.norm(cameras.centres - cameras.centres.mean(0), axis=1).mean()
    R, t, weight = np.eye(3), np.zeros(3), np.ones(len(cameras))
    for number in range(_ROUNDS):
        # Arms must have the length of the last scale, because otherwise no camera fits exactly.
        own = cameras.centres[:, None] + arm / s * _ARMS @ cameras.R
        s, R, t = umeyama(own.reshape(-1, 3), theirs.reshape(-1, 3), np.repeat(weight, 3), with_scale=True)
        off = np.sqrt(((s * own @ R.T + t - theirs) ** 2).sum((-1, -2)))
        weight = np.maximum(off, 1e-3 * arm) ** (-1.0 if number < _ROUNDS // 2 else -1.5)
    return R, t, float(s)


def _result(method: str, solved: PersonCalibration) -> CalibratedCameras:
    found = result_of(method, solved.adjusted)
    alike = np.sqrt(min(FRAMES_ALIKE, len(solved.frames)))
    return replace(found, centre_sigma_m=found.centre_sigma_m * alike, turn_sigma=found.turn_sigma * alike)
