"""What is seen first when somebody goes near: face, eye, lips, hand, wrist, armpit, elbow, toes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from assets_procedural.arrays import Array
from assets_procedural.layout import JOINT
from assets_procedural.quality.poses import Degrees
from assets_procedural.quality.raster import RasterView

_UP: Degrees = {"left_collar": (0, 0, 22), "left_shoulder": (0, 0, 65)}
_BENT: Degrees = {"left_elbow": (0, -110, 0)}
_HANGING: Degrees = {"left_collar": (0, 0, -8), "left_shoulder": (0, 0, -70), "left_elbow": (0, -15, 0)}
_REST: Degrees = {}
_PLACES: tuple[tuple[Degrees, str, tuple[float, float, float], float, tuple[tuple[float, float], ...]], ...] = (
    (_REST, "head", (0.0, 0.07, 0.0), 0.30, ((0, 0), (-40, 0), (-90, 0))),
    (_REST, "head", (0.032, 0.077, 0.10), 0.07, ((0, 0), (-45, 10))),
    (_REST, "head", (0.0, 0.010, 0.10), 0.09, ((0, 0), (-45, 0))),
    (_REST, "left_hand", (0.02, -0.02, 0.01), 0.26, ((0, 90), (0, -90), (0, 10), (-70, 15))),
    (_HANGING, "left_hand", (0.0, -0.04, 0.0), 0.30, ((-60, 0), (60, 0))),
    (_REST, "left_wrist", (0.0, 0.0, 0.0), 0.16, ((180, 30), (0, 30))),
    (_UP, "left_shoulder", (0.0, -0.08, 0.0), 0.60, ((0, 0), (-60, 0), (180, 0))),
    (_BENT, "left_elbow", (0.0, 0.0, 0.04), 0.34, ((40, 35), (0, 90))),
    (_REST, "left_foot", (0.0, 0.0, -0.02), 0.22, ((0, 35), (-45, 25), (50, 25))),
)
"""Pose, joint, offset from it in the rest frame and height of the picture (metres), yaws and pitches (degrees)."""


def close_views(joints_of: dict[int, Array]) -> Iterator[tuple[Degrees, RasterView]]:
    """Yield each pose with a view of it.

    Args:
        joints_of: by ``id`` of a pose of ``close_poses``, the (24, 3) posed joints, metres.
    """
    for pose, joint, offset, height_m, ways in _PLACES:
        centre = joints_of[id(pose)][JOINT[joint]] + np.array(offset)
        for yaw, pitch in ways:
            yield pose, RasterView(yaw=yaw, pitch=pitch, centre=tuple(centre), height_m=height_m, size=(360, 360))


def close_poses() -> list[Degrees]:
    """Return the poses that are looked at."""
    return list({id(pose): pose for pose, *_ in _PLACES}.values())
