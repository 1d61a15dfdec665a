"""Names of joint centres on points that are none: markers on the skin are farther apart than joints."""

from __future__ import annotations

import numpy as np

from solver_backend.body.joint_names import is_joint_centre
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.types import MarkerCloud, MarkerSubject

WIDEST = 0.64
"""Distance of the hips by the length of a thigh: 0.40 in an inertial suit's skeleton, 0.3 to 0.45 in bodies, 0.52 in
detections; markers on the outer hip or the waist have 0.7 and more."""
FAR_M = 0.025
"""A calibrated limb joint this far from the body's is none: an inertial suit's differ by up to 11 mm, markers on the
skin by 40 and more."""
STRANGE = 4.0
"""Deviations of a shape coefficient that no person has: a suit's skeleton gives 1.3, markers on waist and knees that
are named hips and knees 6.5, where their width alone passes for a body's."""
_CHAIN = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")


def doubt_joints(cloud: MarkerCloud, person: MarkerSubject) -> list[Diagnostic]:
    """Return that points with a skeleton's names are no joint centres, by their distances, the fit or the shape.

    Args:
        cloud: the take.
        person: as calibrated on it.
    """
    if not any(is_joint_centre(place) for place in person.places):
        return []
    chain = [m for m, place in enumerate(person.places) if is_joint_centre(place) and place.endswith(_CHAIN)]
    off = np.linalg.norm(person.offsets[chain], axis=-1)
    far = [person.labels[m] for m, distance in zip(chain, off, strict=True) if distance > FAR_M]
    wide, shape = _width(cloud, person), float(np.abs(person.betas).max())
    if wide <= WIDEST and 2 * len(far) < len(chain) and (shape <= STRANGE or not far):
        return []
    most = 1000 * float(off.max(initial=0.0))
    return [diagnostic("joints_doubted", markers=far, size=100 * wide, off=most, shape=shape)]


def _width(cloud: MarkerCloud, person: MarkerSubject) -> float:
    """Return the distance of the hips by the length of a thigh, the median of the frames; 0 where it is not known."""
    labels, needed = cloud.labels or (), ("left_hip", "right_hip", "left_knee", "right_knee")
    label_of = {place[1:]: label for place, label in zip(person.places, person.labels, strict=True)}
    if not all(label_of.get(name) in labels for name in needed):
        return 0.0
    left, right, left_knee, right_knee = (cloud.positions[:, labels.index(label_of[name])] for name in needed)
    thigh = 0.5 * (np.linalg.norm(left_knee - left, axis=-1) + np.linalg.norm(right_knee - right, axis=-1))
    ratio = np.linalg.norm(left - right, axis=-1) / np.maximum(thigh, 1e-9)
    ratio = ratio[np.isfinite(ratio)]
    return float(np.median(ratio)) if ratio.size else 0.0
