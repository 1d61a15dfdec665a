"""Points of a Γ from tables of what calibrated sensors saw: by depth, or where rays of two cameras meet."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.extrinsics.two_views import intersected
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.errors import CalibrationMismatch, FileMissing
from solver_backend.sensors.wand.points_files import points_files, read_table
from solver_backend.types import Cameras

MEETING_PX = 4.0
"""Rays of two cameras meet where both pixels are within this of the point between them."""
MOST_MOMENTS = 300
"""Moments that are looked at, spread over the recording."""


def gamma_clouds(folder: Path, cameras: Cameras) -> list[np.ndarray]:
    """Return the points of each moment, metres in the cameras' world.

    Of sensors with depth a cloud is what one of them saw at one moment; of cameras without, all meetings of rays of two
    of them, most of which are none: the Γ's edges choose.

    Args:
        folder: tables as ``read_points_folder`` reads them, by the sensors' names.
        cameras: calibrated.

    Raises:
        FileMissing: there is no table.
        CalibrationMismatch: a table is of no sensor of the calibration.
        FileDamaged: see ``read_table``.
    """
    files = points_files(folder)
    if not files:
        raise FileMissing("There is no table (.csv) of a Γ here.", where=str(folder))
    unknown = [path.stem for path in files if path.stem not in cameras.names]
    if unknown:
        raise CalibrationMismatch(
            f"The wand was seen by {', '.join(cameras.names)}, the Γ by {', '.join(unknown)} too.", where=str(folder)
        )
    clouds: list[np.ndarray] = []
    lights: dict[int, np.ndarray] = {}
    for path in files:
        table, with_depth = read_table(path)
        camera = cameras.names.index(path.stem)
        if with_depth:
            clouds += depth_clouds(cameras, camera, table[:, 0], table[:, 1:3], 1e-3 * table[:, 3])
        else:
            lights[camera] = table
    return clouds + _meetings(cameras, lights)


def depth_clouds(
    cameras: Cameras, camera: int, times: np.ndarray, px: np.ndarray, depth_m: np.ndarray
) -> list[np.ndarray]:
    """Return the points one sensor saw, (N, 3) metres a moment.

    Args:
        cameras: calibrated.
        camera: which of them.
        times: (rows,) a marker each; rows of one time are one moment.
        px: (rows, 2).
        depth_m: (rows,) metres along the axis; those not above zero are left out.
    """
    known = np.isfinite(px).all(1) & (px >= 0).all(1) & (depth_m > 0)
    times, px, depth_m = times[known], px[known], depth_m[known]
    one = cameras.subset([camera])
    flat = undistort(one, px[None])[0]
    ray = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
    points = (ray * depth_m[:, None] - one.t[0]) @ one.R[0]
    starts = np.flatnonzero(np.r_[True, np.diff(times) != 0])[1:] if len(times) else []
    return _spread([part for part in np.split(points, starts) if len(part) >= 3])


def _meetings(cameras: Cameras, lights: dict[int, np.ndarray]) -> list[np.ndarray]:
    """Return where rays of each two cameras meet at the moments both saw, (9, 3) each and fewer."""
    clouds: list[np.ndarray] = []
    for a, b in combinations(sorted(lights), 2):
        times, first, second = np.intersect1d(lights[a][:, 0], lights[b][:, 0], return_indices=True)
        if len(times):
            rows = np.stack([lights[a][first, 1:], lights[b][second, 1:]]).reshape(2, -1, 3, 2)
            clouds += _of_pair(cameras.subset([a, b]), np.where((rows < 0).any(-1, keepdims=True), np.nan, rows))
    return _spread(clouds)


def _of_pair(pair: Cameras, px: np.ndarray) -> list[np.ndarray]:
    """Return the clouds of two cameras' pixels (2, F, 3, 2): every spot of one with every spot of the other."""
    flat = undistort(pair, px)
    i, j = (grid.ravel() for grid in np.meshgrid(range(3), range(3), indexing="ij"))
    both = np.stack([flat[0][:, i], flat[1][:, j]])
    at = intersected(pair.R, pair.t, both.reshape(2, -1, 2)).reshape(*both.shape[1:3], 3)
    local = np.einsum("cij,fnj->cfni", pair.R, at) + pair.t[:, None, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.abs(local[..., :2] / local[..., 2:] - both).max(-1) * pair.K[:, 0, 0][:, None, None]
        good = (off < MEETING_PX).all(0) & (local[..., 2] > 0).all(0)
    return [points[keep] for points, keep in zip(at, good, strict=True) if keep.sum() >= 3]


def _spread(clouds: Sequence[np.ndarray]) -> list[np.ndarray]:
    if len(clouds) <= MOST_MOMENTS:
        return list(clouds)
    return [clouds[i] for i in np.linspace(0, len(clouds) - 1, MOST_MOMENTS).astype(int)]
