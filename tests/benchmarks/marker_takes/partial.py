"""Full marker takes without the markers of some limbs: errors of the other joints, and of resting joints."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_landmarks
from solver_backend.fitters import SolveSettings, solve
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.types import FLAG_RESTING, SMPL_JOINTS, Capture, MarkerCloud, Motion

BOUNDS = np.array([2.366, 4.642, 7.815])  # Squared distances of the 50, 80 and 95 % ellipsoids, in deviations.
_LEG = ("hip", "knee", "ankle", "foot")
_ARM = ("elbow", "wrist", "hand")
_SHOULDER = ("SHO", "FSH", "BSH")
"""Marker positions that remain when an arm's markers are removed."""


@dataclass(frozen=True)
class Removed:
    """Comparison of a partial take with the whole take."""

    kind: str  # Kind of the removed markers.
    squared: np.ndarray  # (n,) squared distances of resting joints from the whole solve's, in deviations.
    flagged: float  # Share of frames that are flagged as resting.
    moved_mm: np.ndarray  # (n,) distances of measured joints from the whole solve's.
    wrists_above: float  # Share of frames with a resting wrist above its shoulder.
    motion: Motion  # The partial solve.


KINDS = ("above the pelvis", "right arm", "legs")


def solved(cloud: MarkerCloud) -> Motion:
    """Return the solve of a take."""
    return solve(Capture("take", markers=cloud), SolveSettings(contacts=False)).motion


def removed(cloud: MarkerCloud, whole: Motion, kind: str) -> Removed:
    """Return the remaining take without some limbs' markers.

    Args:
        cloud: the whole take.
        whole: its solve, which states the position of each marker.
        kind: one of ``KINDS``.
    """
    kept = [label for label, gone in zip(whole.marker_labels or (), _gone(whole, kind), strict=True) if not gone]
    columns = [(cloud.labels or ()).index(label) for label in kept]
    motion = solved(cloud.columns(columns, tuple(kept)))
    assert motion.resting is not None and motion.joint_covariance is not None and motion.flags is not None
    away = motion.joints - whole.joints
    inverse = np.linalg.inv(unpacked(motion.joint_covariance))
    squared = np.einsum("fji,fjik,fjk->fj", away, inverse, away)
    above = []
    for side in ("left", "right"):
        wrist, shoulder = (SMPL_JOINTS.index(f"{side}_{part}") for part in ("wrist", "shoulder"))
        above.append((motion.joints[:, wrist, 2] > motion.joints[:, shoulder, 2]) & motion.resting[:, wrist])
    return Removed(
        kind, squared[motion.resting], float((motion.flags & FLAG_RESTING > 0).mean()),
        1000 * np.linalg.norm(away, axis=-1)[~motion.resting], float(np.mean(above)), motion,
    )  # fmt: skip


def at_rate(cloud: MarkerCloud, rate: float, frames: int) -> MarkerCloud:
    """Return at most ``frames`` frames of a take at about ``rate`` frames per second."""
    step = max(1, round(cloud.fps / rate))
    return replace(cloud, positions=cloud.positions[::step][:frames], residual=None, fps=cloud.fps / step)


def _gone(whole: Motion, kind: str) -> np.ndarray:
    """Return an (M,) mask of the removed markers."""
    places, body = whole.layout or (), load_body()
    carriers = np.argmax(marker_landmarks(body, places).weights, axis=1)
    names = [SMPL_JOINTS[j] for j in carriers]
    if kind == "legs":
        # Markers of the waist move with the hips' skin.
        waist = [place[1:] in ("FWT", "BWT", "MWT") for place in places]
        return np.array([name.endswith(_LEG) and not w for name, w in zip(names, waist, strict=True)])
    if kind == "right arm":
        shoulder = [place[1:] in _SHOULDER for place in places]
        arm = (*(f"right_{part}" for part in _ARM), "right_shoulder")
        return np.array([name in arm and not s for name, s in zip(names, shoulder, strict=True)])
    return np.array([not (name.endswith(_LEG) or name == "pelvis") for name in names])
