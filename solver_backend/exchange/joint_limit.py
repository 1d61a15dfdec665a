"""How far joints turn, and the ranges of motion of healthy adults by the joints' names.

Angles are about the axes of the T-pose (x to the left, y up, z forward): a rotation is split into a twist about the
bone and a swing (Grassia 1998); one of the three angles is the twist, the others are the components of the swing's
rotation vector.
"""

from __future__ import annotations

from dataclasses import dataclass

_X, _Y = 0, 1


@dataclass(frozen=True)
class JointLimit:
    """Range of motion of a joint."""

    twist: int
    """Axis of the twist: 0, 1 or 2."""
    low_deg: tuple[float, float, float]
    """Least angle about x, y and z in degrees."""
    high_deg: tuple[float, float, float]
    """Greatest angle."""

    @property
    def mirrored(self) -> JointLimit:
        """That of the same joint on the other side."""
        (low_x, low_y, low_z), (high_x, high_y, high_z) = self.low_deg, self.high_deg
        return JointLimit(self.twist, (low_x, -high_y, -high_z), (high_x, -low_y, -low_z))


ADULTS: dict[str, tuple[int, tuple[tuple[float, float], tuple[float, float], tuple[float, float]]]] = {
    "hip": (_Y, ((-125, 30), (-50, 50), (-30, 60))),
    "knee": (_Y, ((-5, 145), (-35, 35), (-10, 10))),
    "ankle": (_Y, ((-30, 50), (-30, 30), (-30, 30))),
    "foot": (_Y, ((-70, 40), (-15, 15), (-15, 15))),
    "spine1": (_Y, ((-25, 60), (-20, 20), (-25, 25))),
    "spine2": (_Y, ((-25, 40), (-25, 25), (-25, 25))),
    "spine3": (_Y, ((-20, 30), (-30, 30), (-20, 20))),
    "neck": (_Y, ((-40, 40), (-50, 50), (-30, 30))),
    "head": (_Y, ((-60, 40), (-50, 50), (-30, 30))),
    "collar": (_X, ((-20, 30), (-25, 25), (-15, 40))),
    "shoulder": (_X, ((-100, 100), (-140, 60), (-105, 105))),
    "elbow": (_X, ((-90, 90), (-150, 5), (-15, 150))),
    "wrist": (_X, ((-45, 45), (-40, 35), (-80, 80))),
}
"""Axis of the twist, and least and greatest angle in degrees about x, y and z; of the left side where there are two.
Single joints from Norkin and White 2016 (after AAOS and Boone and Azen 1979); the spine's 130 degrees of flexion, 70 of
extension, 70 to each side and 75 of rotation are shared out to three joints, the neck's to two, the forearm's
pronation to elbow and wrist. The elbow bends forwards or upwards: T-poses differ in the roll of the upper arm."""


def limits_of(joints: tuple[str, ...]) -> dict[str, JointLimit]:
    """Return the limits of those joints that have the name of an adult's, with or without their side."""
    found = {}
    for joint in joints:
        part = joint.removeprefix("left_").removeprefix("right_")
        if part in ADULTS:
            axis, ranges = ADULTS[part]
            low, high = zip(*ranges, strict=True)
            limit = JointLimit(axis, low, high)
            found[joint] = limit.mirrored if joint.startswith("right_") else limit
    return found
