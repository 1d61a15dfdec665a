"""Displacement fields that lengthen segments and swell girths; smooth functions of the rest position alone.

Because the T-pose lies along the axes, lengths are one-dimensional maps along y (trunk, legs) and x (arms), and girths
are radial swellings about the bones. Joints are moved by the same functions as the skin around them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from assets_procedural.arrays import Array
from assets_procedural.layout import JOINT

Field = Callable[[Array], Array]
Profile = Callable[[Array], Array]


@dataclass(frozen=True)
class RestFrame:
    """Rest joints of the body to deform, floor at y = 0."""

    joints: Array
    """(24, 3) metres."""
    top: float
    """Height of the vertex of the head, metres."""

    def at(self, name: str) -> Array:
        """Return a joint by name."""
        return self.joints[JOINT[name]]


def build_fields(frame: RestFrame) -> dict[str, Field]:
    """Return one field a measure of ``statistics.MEASURES``; each maps (N, 3) points to (N, 3) displacements."""
    return _length_fields(frame) | _girth_fields(frame)


def displace(fields: dict[str, Field], points: Array) -> Array:
    """Return the (M, N, 3) displacements of all fields; odd in x by construction."""
    side = np.where(points[:, :1] < 0, np.array([[-1.0, 1.0, 1.0]]), 1.0)
    left = points * side
    moved = np.stack([field(left) for field in fields.values()])
    moved[:, points[:, 0] == 0.0, 0] = 0.0
    return moved * side


def _length_fields(frame: RestFrame) -> dict[str, Field]:
    hip, knee, ankle, wrist = (frame.at(f"left_{n}") for n in ("hip", "knee", "ankle", "wrist"))
    shoulder, elbow, neck = frame.at("left_shoulder"), frame.at("left_elbow"), frame.at("neck")

    def along_y(low: float, high: float) -> Field:
        return lambda p: np.stack([0 * p[:, 0], _ramp(p[:, 1], low, high), 0 * p[:, 0]], axis=1)

    def along_x(low: float, high: float) -> Field:
        return lambda p: np.stack([_ramp(p[:, 0], low, high) * _arm(p), 0 * p[:, 0], 0 * p[:, 0]], axis=1)

    def breadth(p: Array) -> Array:
        return np.stack([_ramp(p[:, 0], 0.03, shoulder[0]) * _step(p[:, 1], 1.14, 1.36), 0 * p[:, 0], 0 * p[:, 0]], 1)

    def hand(p: Array) -> Array:
        return _step(p[:, 0], wrist[0] - 0.03, wrist[0] + 0.03)[:, None] * (p - wrist)

    def foot(p: Array) -> Array:
        moved = (p - ankle) * [1.0, 0.0, 1.0]
        return (1.0 - _step(p[:, 1], 0.035, 0.110))[:, None] * moved

    return {
        "stature": along_y(neck[1] - 0.01, frame.top - 0.02),
        "cervicaleheight": along_y(hip[1] + 0.03, 1.29),
        "crotchheight": along_y(knee[1] + 0.03, hip[1] - 0.12),
        "kneeheightmidpatella": along_y(ankle[1] + 0.03, knee[1] - 0.03),
        "span": along_x(shoulder[0] + 0.04, elbow[0] - 0.02),
        "biacromialbreadth": breadth,
        "radialestylionlength": along_x(elbow[0] + 0.02, wrist[0] - 0.02),
        "handlength": hand,
        "footlength": foot,
    }


def _girth_fields(frame: RestFrame) -> dict[str, Field]:
    at = frame.at
    spine = np.stack([at(n) for n in ("pelvis", "spine1", "spine2", "spine3", "neck", "head")])
    hip, knee, ankle = at("left_hip"), at("left_knee"), at("left_ankle")
    shoulder, elbow, wrist = at("left_shoulder"), at("left_elbow"), at("left_wrist")

    def trunk(profile: Profile, inside: Field) -> Field:
        def field(p: Array) -> Array:
            z = np.interp(p[:, 1], spine[:, 1], spine[:, 2])
            share = profile(p[:, 1]) * inside(p)
            return share[:, None] * np.stack([p[:, 0], 0 * z, p[:, 2] - z], axis=1)

        return field

    def leg(start: Array, end: Array, profile: Profile) -> Field:
        def field(p: Array) -> Array:
            t = (p[:, 1] - start[1]) / (end[1] - start[1])
            out = (p - (start + t[:, None] * (end - start))) * [1.0, 0.0, 1.0]
            out[:, 0] += 0.055 * _step(p[:, 1], knee[1] - 0.1, knee[1] + 0.25)  # keeps the thighs apart
            return profile(p[:, 1])[:, None] * out

        return field

    def arm(start: Array, end: Array, profile: Profile) -> Field:
        def field(p: Array) -> Array:
            t = np.clip((p[:, 0] - start[0]) / (end[0] - start[0]), -0.5, 1.5)
            out = (p - (start + t[:, None] * (end - start))) * [0.0, 1.0, 1.0]
            return (profile(p[:, 0]) * _arm(p))[:, None] * out

        return field

    def not_arm(p: Array) -> Array:
        return 1.0 - _step(p[:, 0], 0.12, 0.22) * _step(p[:, 1], 1.17, 1.36)

    def near_axis(p: Array) -> Array:
        return 1.0 - _step(p[:, 0], 0.07, 0.12)

    def head(p: Array) -> Array:
        centre = at("head") * [1.0, 0.0, 1.0]
        return _step(p[:, 1], at("neck")[1] + 0.01, at("head")[1] + 0.06)[:, None] * (p * [1.0, 0.0, 1.0] - centre)

    return {
        "headcircumference": head,
        "neckcircumference": trunk(_profile({1.40: 0, 1.455: 1, 1.515: 0}), near_axis),
        "chestcircumference": trunk(_profile({1.045: 0, 1.265: 1, 1.41: 0}), not_arm),
        "waistcircumference": trunk(_profile({0.885: 0, 1.045: 1, 1.265: 0}), not_arm),
        "buttockcircumference": trunk(_profile({0.70: 0, 0.885: 1, 1.045: 0}), _everywhere),
        "thighcircumference": leg(hip, knee, _profile({0.35: 0, 0.48: 0.4, 0.70: 1, 0.885: 0})),
        "calfcircumference": leg(knee, ankle, _profile({0.125: 0, 0.35: 1, 0.48: 0.4, 0.70: 0})),
        "anklecircumference": leg(knee, ankle, _profile({0.02: 0, 0.11: 1, 0.35: 0})),
        "bicepscircumferenceflexed": arm(shoulder, elbow, _profile({0.15: 0, 0.29: 1, 0.44: 0.45, 0.505: 0})),
        "forearmcircumferenceflexed": arm(elbow, wrist, _profile({0.29: 0, 0.44: 0.45, 0.505: 1, 0.65: 0})),
        "wristcircumference": arm(elbow, wrist, _profile({0.505: 0, 0.65: 1, 0.73: 0})),
    }


def _profile(knots: dict[float, float]) -> Profile:
    """Return a smooth curve through the knots, flat at each of them and constant beyond the ends."""
    at, values = list(knots), list(knots.values())

    def curve(x: Array) -> Array:
        out = np.full_like(x, values[0])
        for low, high, before, after in zip(at, at[1:], values, values[1:], strict=False):
            out = out + (after - before) * _step(x, low, high)
        return out

    return curve


def _everywhere(p: Array) -> Array:
    return np.ones(len(p))


def _arm(p: Array) -> Array:
    """Mark the arm: above the chest and outside it."""
    return _step(p[:, 0], 0.13, 0.21) * _step(p[:, 1], 1.10, 1.24)


def _step(x: Array, low: float, high: float) -> Array:
    """Return a smooth step from 0 below ``low`` to 1 above ``high``."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * t * (t * (6.0 * t - 15.0) + 10.0)


def _ramp(x: Array, low: float, high: float) -> Array:
    """Return 0 below ``low``, 1 above ``high`` and a line with rounded ends between."""
    soft = 0.08 * (high - low)

    def bend(y: Array) -> Array:
        return soft * np.logaddexp(0.0, y / soft)

    return (bend(x - low) - bend(x - high)) / (high - low)
