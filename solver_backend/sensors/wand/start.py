"""Where sensors stand to begin with: pairs of them by what both saw, chained along the pairs that saw most."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from solver_backend.camera_calibration.extrinsics.chained_poses import Pose, chained
from solver_backend.camera_calibration.extrinsics.two_views import essential_matrix, intersected, pose_from_essential
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.geometry.alignment import umeyama
from solver_backend.sensors.wand.errors import WandInvalid, WandNotSeen
from solver_backend.sensors.wand.leds import Wand, distances
from solver_backend.types.shapes import Float

LEAST_TOGETHER = 20
"""Moments that a pair must have seen together."""
HYPOTHESES = 200
"""Samples of three pairs of points."""
_REFINEMENTS = 15
START_SIGMA_PX = 2.0
"""Distance to an epipolar line at which a point loses its weight, before anything is refined."""


def robust_umeyama(
    source: Float[np.ndarray, "n 3"], target: Float[np.ndarray, "n 3"], sigma: Float[np.ndarray, " n"],
    rng: np.random.Generator,
) -> tuple[Pose, np.ndarray]:  # fmt: skip
    """Return the rigid move that brings most points onto their partners, and which do, (n,).

    Samples of three propose, Cauchy's penalty of ``|R x + t - y| / σ`` decides, the best is refined with its weights.

    Args:
        source: (n, 3) metres, n at least 3.
        target: (n, 3) metres.
        sigma: (n,) metres, standard deviation of a pair's distance.
        rng: seeded.

    Reference: Umeyama 1991; Fischler and Bolles 1981 (the samples).
    """
    picks = np.stack([rng.permutation(len(source))[:3] for _ in range(HYPOTHESES)])
    _, R, t = umeyama(source[picks], target[picks])
    square = ((np.einsum("hij,nj->hni", R, source) + t[:, None] - target) ** 2).sum(-1) / sigma**2
    best = int(np.argmin(np.log1p(square / 9.0).sum(-1)))
    R, t, square = R[best], t[best], square[best]
    for _ in range(_REFINEMENTS):
        weight = 1.0 / (1.0 + square / 9.0) / sigma**2
        _, R, t = umeyama(source, target, weight)
        square = ((source @ R.T + t - target) ** 2).sum(-1) / sigma**2
    return (R, t), square < 25.0


def poses_by_depth(
    names: Sequence[str], points: Float[np.ndarray, "views moments 3"], sigma: Float[np.ndarray, "views moments"],
    rng: np.random.Generator,
) -> list[Pose]:  # fmt: skip
    """Return each sensor's pose, the first one's axes to its own, from one marker's places in every sensor's axes.

    Args:
        names: of the C sensors, for messages.
        points: (C, M, 3) metres, NaN where not seen.
        sigma: (C, M) metres.
        rng: seeded.

    Raises:
        WandNotSeen: a sensor saw it at no moment at which another one did.
    """
    together, relative = {}, {}
    for i, j in combinations(range(len(names)), 2):
        both = np.isfinite(points[[i, j]]).all((0, 2))
        if both.sum() >= LEAST_TOGETHER:
            spread = np.hypot(sigma[i, both], sigma[j, both])
            relative[i, j], agree = robust_umeyama(points[i, both], points[j, both], spread, rng)
            together[i, j] = int(agree.sum())
    return _chained(names, together, relative)


def poses_by_lights(
    names: Sequence[str], flat: Float[np.ndarray, "views moments 3 2"], focal_px: float, wand: Wand,
    rng: np.random.Generator,
) -> list[Pose]:  # fmt: skip
    """Return each camera's pose, the first one's axes to its own, in metres by the wand's lengths.

    Args:
        names: of the C cameras, for messages.
        flat: (C, M, 3, 2) undistorted normalised coordinates of the lights in their order, NaN where not seen.
        focal_px: of a typical camera.
        wand: its lengths.
        rng: seeded.

    Raises:
        WandNotSeen: a camera saw it at no moment at which another one did.
    """
    together, relative = {}, {}
    for i, j in combinations(range(len(names)), 2):
        both = np.isfinite(flat[[i, j]]).all((0, 2, 3))
        if both.sum() < LEAST_TOGETHER:
            continue
        first, second = flat[i, both].reshape(-1, 2), flat[j, both].reshape(-1, 2)
        E, agree = essential_matrix(first, second, START_SIGMA_PX / focal_px, rng)
        R, t = pose_from_essential(E, first[agree], second[agree])
        at = intersected(np.stack([np.eye(3), R]), np.stack([np.zeros(3), t]), np.stack([first, second]))
        seen = np.nanmedian(distances(at.reshape(-1, 3, 3)), axis=0)
        scale = wand.distances_m[2] / max(float(seen[2]), 1e-9)
        relative[i, j], together[i, j] = (R, scale * t), int(agree.sum())
    return _chained(names, together, relative)


def require_proportion(wand: Wand, measured_m: Float[np.ndarray, " 3"]) -> None:
    """Refuse a wand whose parts are seen in another proportion than was given.

    Args:
        wand: what the user gave.
        measured_m: (3,) distances of the lights as triangulated.

    Raises:
        WandInvalid: the shorter part's share differs by more than a tenth.
    """
    share = float(min(measured_m[:2]) / measured_m[:2].sum())
    if abs(share / wand.short_share - 1.0) > 0.1:
        raise WandInvalid(
            f"The lights are seen in a proportion of {share:.3f}; the stated lengths give {wand.short_share:.3f}.",
            hint="Measure the wand from light to light, and give both lengths in metres: --wand 0.13 0.26",
        )


def _chained(names: Sequence[str], together: dict, relative: dict) -> list[Pose]:
    try:
        return chained(names, together, relative)
    except CalibrationInvalid as error:
        raise WandNotSeen(
            error.message.replace("sees the same", "sees the wand"), where=", ".join(names),
            hint=f"Wave it where both see it, for {LEAST_TOGETHER} frames and more.",
        ) from error  # fmt: skip
