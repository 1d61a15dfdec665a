"""Markers read from infrared and depth pictures by the rig's acquisition, and rays brought together."""

from __future__ import annotations

import numpy as np

from solver_backend.cameras.projection import undistort
from solver_backend.sensors.acquisition.acquire import Acquisition, SensorSightings
from solver_backend.sensors.devices.device import SensorFrame
from solver_backend.types import Cameras


def sightings(cameras: Cameras, view: int, infrared: np.ndarray, depth_mm: np.ndarray | None = None) -> SensorSightings:
    """Return what the rig's acquisition finds in one frame of a camera."""
    name = cameras.names[view]
    return Acquisition(cameras, name)(SensorFrame(name, infrared, depth_mm, 0.0, 0.0))


def lift(cameras: Cameras, view: int, px: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return (N, 3) world points of pixels with depths along the axis."""
    one = cameras.subset([view])
    flat = undistort(one, px[None])[0]
    camera = np.concatenate([flat, np.ones((len(px), 1))], axis=1) * depth[:, None]
    return (camera - cameras.t[view]) @ cameras.R[view]


def triangulated(cameras: Cameras, views: list[int], px: np.ndarray) -> np.ndarray:
    """Return the (3,) point nearest to the rays of one pixel in each of some views (least squares)."""
    A, b = np.zeros((3, 3)), np.zeros(3)
    for view, xy in zip(views, px, strict=True):
        near, far = lift(cameras, view, np.stack([xy, xy]), np.array([1.0, 3.0]))
        way = (far - near) / np.linalg.norm(far - near)
        across = np.eye(3) - np.outer(way, way)
        A, b = A + across, b + across @ near
    return np.linalg.solve(A, b)
