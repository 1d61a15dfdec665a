"""Interpolation along the manifold: steps towards the end pose, each projected (Tiwari et al. 2022, eq. 12)."""

from __future__ import annotations

from array_api_compat import array_namespace

from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.arrays import Array
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.pose_ndf.pose_ndf import RECORDED_RAD, PoseNDF, ProjectionSettings

ALONG = ProjectionSettings(level=RECORDED_RAD)
"""Recorded poses stay where they are; nearer to all others, steps would lead to the middle of them."""


def interpolate_poses(
    prior: PoseNDF,
    start: Array,
    end: Array,
    count: int,
    settings: ProjectionSettings = ALONG,
    progress: Progress = silent,
) -> Array:
    """Return ``count`` poses between each pair, on the manifold, ends not included.

    ``θ_t = θ'_{t-1} + τ (θ'_T - θ'_{t-1})`` with ``τ = 1/(T - t + 1)``, so that the way is shared out evenly, and along
    each joint's geodesic; θ' is projected by (6).

    Args:
        prior: the manifold.
        start: (N, 21, 3, 3).
        end: (N, 21, 3, 3).
        count: poses between.
        settings: of the projection.
        progress: called after every pose.

    Returns:
        (N, count, 21, 3, 3).

    Raises:
        PoseInvalid: poses that are NaN or off SO(3).
    """
    xp = array_namespace(start, end)
    here, target = prior.project(start, settings), prior.project(end, settings)
    found = []
    for step in range(count):
        share = 1.0 / (count + 1 - step)
        way = log_so3(xp.matmul(target, xp.matrix_transpose(here)))
        here = prior.project(xp.matmul(exp_so3(share * way), here), settings)
        found.append(here)
        progress("Interpolating", step + 1, count)
    return xp.stack(found, axis=1)
