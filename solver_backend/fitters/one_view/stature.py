"""The person's size, which one camera does not see: given, or from where the feet meet the floor, or the average's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.priors.lifted_take import surest_feet
from solver_backend.types import Capture

PEOPLE_SIGMA = 0.055
"""Standard deviation of adults' statures as a share, women and men together (ANSUR II: 93 mm of 1.71 m)."""
FLOOR_SIGMA_M = 0.05
"""Error of the floor under the feet: of its height, of up, and of the lifted legs."""
SHAPE_SIGMA = 0.01
"""What a known shape leaves open of the size."""
LARGEST = 10.0
"""Times as large as the average: nobody, and so is whoever would stand above the camera."""
LEAST_HEIGHT_M = 0.3
"""A camera that is less far above the feet sees no size in them."""
_AVERAGE = "what adults are"
AT_ODDS_SIGMAS = 3.0
"""A floor at which the person would be so many deviations larger or smaller than people are is none."""


@dataclass(frozen=True)
class Size:
    """How many times as large as the average a person is."""

    factor: float
    """Of the stature."""
    sigma: float
    """Its standard deviation, a share."""
    source: str
    """What it is from, for people."""
    has_floor: bool = True
    """The person's feet are where the world has its floor."""
    at_odds: tuple[float, float] = (0.0, 0.0)
    """Size by the floor and its deviation, where that cannot be together with what is given, or with what people are;
    zero where it can."""


def size_of(
    capture: Capture, body: Body, betas: tuple[float, ...] | None, points: np.ndarray, names: tuple[str, ...],
    seen: np.ndarray, camera_height: float, sigma: np.ndarray,
) -> Size:  # fmt: skip
    """Return how large the person is: of the known shape or stature, else by the floor.

    Args:
        capture: states the stature, and whether the floor was found from the person.
        body: whose stature is the average's.
        betas: the known shape, or None.
        points, names, seen, camera_height, sigma: see ``measured_size``.
    """
    if capture.floor_from_person:
        by_floor, measured = Size(1.0, PEOPLE_SIGMA, _AVERAGE), None
    else:
        measured = measured_size(points, names, seen, camera_height, sigma)
        by_floor = size_by_floor(measured)
    if betas is not None:
        factor, source = _size_of_shape(body, betas), "the given shape"
    elif capture.stature_m:
        factor, source = capture.stature_m / body.stature_m, "the given stature"
    else:
        return by_floor
    doubted = measured is not None and _at_odds(measured, factor, SHAPE_SIGMA)
    known = Size(factor, SHAPE_SIGMA, source, by_floor.has_floor and not doubted)
    return replace(known, at_odds=measured) if doubted and measured is not None else known


def measured_size(
    points: np.ndarray, names: tuple[str, ...], seen: np.ndarray, camera_height: float, sigma: np.ndarray
) -> tuple[float, float] | None:  # fmt: skip
    """Return the size at which an average person's feet reach the floor, and its deviation; None: no foot shows it.

    All that one camera sees of a person ``s`` times as large is ``s`` times as far away: a foot at height h comes down
    to ``H - s (H - h)`` below a camera at height H.

    Args:
        points: (F, L, 3) an average person's points in the world, metres.
        names: of the L points.
        seen: (F, L) bool, which of them the camera sees.
        camera_height: H above the floor, metres.
        sigma: (F, L) deviations of the points' heights, metres.
    """
    lowest = surest_feet(points, names, seen, sigma)
    if lowest is None or abs(camera_height) < LEAST_HEIGHT_M:
        return None
    drop = camera_height - lowest
    deviation = float(FLOOR_SIGMA_M * np.sqrt(2.0) / max(abs(drop), 1e-6))
    size = camera_height / drop if drop * camera_height > 0 else LARGEST
    return min(size, LARGEST), deviation


def size_by_floor(measured: tuple[float, float] | None) -> Size:
    """Return the size that was measured, weighed against what adults are; theirs where the two cannot be together."""
    if measured is None:
        return Size(1.0, PEOPLE_SIGMA, _AVERAGE, has_floor=False)
    if _at_odds(measured, 1.0, PEOPLE_SIGMA):
        return Size(1.0, PEOPLE_SIGMA, _AVERAGE, has_floor=False, at_odds=measured)
    by_feet, sigma = measured
    weight = sigma**-2 / (sigma**-2 + PEOPLE_SIGMA**-2)
    return Size(1.0 + weight * (by_feet - 1.0), (sigma**-2 + PEOPLE_SIGMA**-2) ** -0.5, "feet on the floor")


def _at_odds(measured: tuple[float, float], factor: float, sigma: float) -> bool:
    return not abs(measured[0] - factor) < AT_ODDS_SIGMAS * np.hypot(measured[1], sigma)


def _size_of_shape(body: Body, betas: tuple[float, ...]) -> float:
    """Return how many times as tall as the average's the skeleton of a shape is."""
    names = body.layout.joints
    top, bottom = names.index("head"), [names.index("left_ankle"), names.index("right_ankle")]
    height = [
        joints[top, 1] - joints[bottom, 1].mean()
        for joints in (body.rest_joints(np.asarray(betas)), body.joints_template)
    ]
    return float(height[0] / height[1])


def betas_of_size(body: Body, factor: float) -> np.ndarray:
    """Return the (10,) smallest shape whose skeleton is so many times as tall as the average's.

    Height is linear in the shape: ``b = g (f - 1) h / |g|²`` with its gradient g.
    """
    names = body.layout.joints
    top, bottom = names.index("head"), [names.index("left_ankle"), names.index("right_ankle")]
    rest, by_shape = body.joints_template[:, 1], body.joints_shapedirs[:, 1]
    height = rest[top] - rest[bottom].mean()
    gradient = by_shape[top] - by_shape[bottom].mean(axis=0)
    return gradient * (factor - 1.0) * height / float(gradient @ gradient)
