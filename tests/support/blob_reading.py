"""Markers read from infrared and depth pictures as chapter 5.3.2 of the thesis does, and rays brought together."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from solver_backend.cameras.projection import undistort
from solver_backend.types import Cameras


def labelled(bright: np.ndarray) -> tuple[np.ndarray, int]:
    """Return connected patches, numbered from 1, and how many there are; corners connect."""
    label = np.zeros(bright.shape, np.int32)
    return label, int(ndimage.label(bright, np.ones((3, 3)), output=label))  # type: ignore[arg-type]


def blob_centres(infrared: np.ndarray, threshold: float = 20000.0) -> np.ndarray:
    """Return (N, 2) pixel centroids of bright blobs, weighted by what exceeds the threshold."""
    bright = np.maximum(infrared.astype(np.float64) - threshold, 0.0)
    label, count = labelled(bright > 0)
    if not count:
        return np.zeros((0, 2))
    return np.array(ndimage.center_of_mass(bright, label, range(1, count + 1)))[:, ::-1]


def ring_depths(infrared: np.ndarray, depth_mm: np.ndarray, threshold: float = 20000.0) -> np.ndarray:
    """Return (N,) metres: the median of the valid depths in a ring two pixels wide around each blob."""
    label, count = labelled(infrared > threshold)
    found = []
    for i, (rows, columns) in enumerate(ndimage.find_objects(label), start=1):
        area = (slice(max(rows.start - 2, 0), rows.stop + 2), slice(max(columns.start - 2, 0), columns.stop + 2))
        blob = label[area] == i
        ring = ndimage.binary_dilation(blob, np.ones((3, 3)), iterations=2) & ~blob & (depth_mm[area] > 0)
        found.append(np.median(depth_mm[area][ring]) / 1000.0 if ring.any() else np.nan)
    return np.array(found).reshape(count)


def lift(cameras: Cameras, view: int, px: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return (N, 3) world points of pixels with depths along the axis."""
    one = cameras.subset([view])
    flat = undistort(one.K, one.distortion, px[None], one.distortion_model)[0]
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
