"""Points where two sensors see a marker and neither has its depth: the rays meet."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from solver_backend.sensors.fusion.settings import DEFAULT, FusionSettings

Rays = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Origin (3,), unit directions (R, 3) and standard deviations across (R,) in radians, of one sensor."""


def met_rays(rays: list[Rays], settings: FusionSettings = DEFAULT) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3) points and (N, 3, 3) covariances where rays of two sensors meet and fit no others.

    The midpoint of the shortest way between two rays (Hartley and Sturm 1997) stands if that way is no longer than
    the rays' errors allow, and if neither of both meets a third: of several meetings all but one are ghosts.

    Args:
        rays: of each sensor.
        settings: the constants.
    """
    first, second, points, covariances = [], [], [], []
    begin = np.cumsum([0, *(len(direction) for _, direction, _ in rays)])
    for a, b in combinations(range(len(rays)), 2):
        i, j, point, covariance = _meetings(rays[a], rays[b], settings)
        first.append(begin[a] + i)
        second.append(begin[b] + j)
        points.append(point)
        covariances.append(covariance)
    if not points or not sum(map(len, points)):
        return np.zeros((0, 3)), np.zeros((0, 3, 3))
    one, other = np.concatenate(first), np.concatenate(second)
    met = np.bincount(np.concatenate([one, other]), minlength=int(begin[-1]))
    only = (met[one] == 1) & (met[other] == 1)
    return np.concatenate(points)[only], np.concatenate(covariances)[only]


def _meetings(a: Rays, b: Rays, settings: FusionSettings) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return indices of rays that meet, points and covariances."""
    (at_a, way_a, sigma_a), (at_b, way_b, sigma_b) = a, b
    cosine = way_a @ way_b.T
    between = at_b - at_a
    sine2 = np.maximum(1.0 - cosine**2, 1e-9)
    of_a, of_b = way_a @ between, way_b @ between
    far_a = (of_a[:, None] - cosine * of_b) / sine2
    far_b = (cosine * of_a[:, None] - of_b) / sine2
    near, far = settings.ray_range_m
    inside = (
        (far_a > near) & (far_a < far) & (far_b > near) & (far_b < far) & (sine2 > np.sin(settings.least_angle) ** 2)
    )
    i, j = np.nonzero(inside)
    on_a = at_a + far_a[i, j, None] * way_a[i]
    on_b = at_b + far_b[i, j, None] * way_b[j]
    width = np.stack([sigma_a[i] * far_a[i, j], sigma_b[j] * far_b[i, j]])
    gap2 = ((on_a - on_b) ** 2).sum(-1)
    good = gap2 < settings.joined_rays * ((width**2).sum(0) + 2.0 * settings.calibration_m**2)
    i, j, on_a, on_b, width = i[good], j[good], on_a[good], on_b[good], width[:, good]
    planes = [np.eye(3) - way[k][:, :, None] * way[k][:, None, :] for way, k in ((way_a, i), (way_b, j))]
    weights = [p / (w**2)[:, None, None] for p, w in zip(planes, width, strict=True)]
    covariance = np.linalg.inv(weights[0] + weights[1]) if len(i) else np.zeros((0, 3, 3))
    pulled = weights[0] @ on_a[..., None] + weights[1] @ on_b[..., None]
    return i, j, (covariance @ pulled)[..., 0], covariance
