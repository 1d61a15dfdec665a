"""Clouds as the published network sees them: normalised, and drawn as orthographic depth maps (thesis 4.2.3)."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from training.landmarks.cloud_stream import Clouds

SIZE = 160
"""Pixels of a map's side."""
MARGIN = 1.25
"""The map's half width is so many times the cloud's largest reach from its centre: hidden hands fall inside too."""
_RADIUS = 1
_THINNEST = 1e-3
"""Extent of a cloud at least, metres: keeps a division from zero."""


@dataclass(frozen=True)
class CanvasFrame:
    """Where normalised coordinates lie in metres: ``metres = centre + half * normalised``."""

    centre: torch.Tensor
    """(B, 1, 3)."""
    half: torch.Tensor
    """(B, 1, 1)."""

    def normalised(self, points: torch.Tensor) -> torch.Tensor:
        """Return points in -1..1."""
        return (points - self.centre) / self.half

    def metres(self, points: torch.Tensor) -> torch.Tensor:
        """Return normalised points in metres."""
        return self.centre + self.half * points


def y_up(points: torch.Tensor) -> torch.Tensor:
    """Return Z-up points in the published network's axes: gravity along y."""
    return torch.stack((points[..., 0], points[..., 2], -points[..., 1]), -1)


def frame_of(points: torch.Tensor, seen: torch.Tensor) -> CanvasFrame:
    """Return the frame of Y-up clouds: the middle of their box, and their reach with a margin."""
    low, high = _box(points, seen)
    return CanvasFrame(0.5 * (low + high), MARGIN * 0.5 * (high - low).amax(-1, keepdim=True).clamp(min=0.2))


def depth_maps(points: torch.Tensor, seen: torch.Tensor, size: int = SIZE) -> torch.Tensor:
    """Return the xy and yz views of normalised (B, N, 3) points: (B, 2, size, size), rows along y.

    The second view looks along +x, so that z runs to its right: one network reads both, and left and right could not
    be distinguished if one were a mirror image. A marker covers 3 x 3 pixels with how near it is to the viewer, 0.1 for
    the cloud's farthest to 1, the nearest one where several meet.
    """
    near = _nearness(points, seen)
    xy = _splatted(points[..., 0], points[..., 1], 0.1 + 0.9 * near[..., 2], seen, size)
    yz = _splatted(points[..., 2], points[..., 1], 1.0 - 0.9 * near[..., 0], seen, size)
    return torch.stack((xy, yz), 1)


def front_and_back(points: torch.Tensor, seen: torch.Tensor, size: int = SIZE) -> torch.Tensor:
    """Return the xy view from the front and from the back (B, 2, size, size), as Democap's network sees clouds."""
    z = 0.9 * _nearness(points, seen)[..., 2]
    front = _splatted(points[..., 0], points[..., 1], 0.1 + z, seen, size)
    back = _splatted(points[..., 0], points[..., 1], 1.0 - z, seen, size)
    return torch.stack((front, back), 1)


def _nearness(points: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
    """Return (B, N, 3) in 0..1: where points lie between the first and the last of their cloud along each axis."""
    low, high = _box(points, seen)
    return ((points - low) / (high - low).clamp(min=_THINNEST)).clamp(0.0, 1.0)


def _box(points: torch.Tensor, seen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the (B, 1, 3) least and greatest coordinates of the points that are seen."""
    low = torch.where(seen[..., None], points, torch.inf).amin(1, keepdim=True)
    return low, torch.where(seen[..., None], points, -torch.inf).amax(1, keepdim=True)


def _splatted(u: torch.Tensor, v: torch.Tensor, value: torch.Tensor, seen: torch.Tensor, size: int) -> torch.Tensor:
    """Return (B, size, size) maps: the greatest value of the points over each pixel, 0 where there is none."""
    device = u.device
    around = torch.arange(-_RADIUS, _RADIUS + 1, device=device)
    columns = ((u + 1.0) * 0.5 * (size - 1)).round().long()[..., None, None] + around
    rows = ((v + 1.0) * 0.5 * (size - 1)).round().long()[..., None, None] + around[:, None]
    columns, rows = torch.broadcast_tensors(columns, rows)
    inside = (columns >= 0) & (columns < size) & (rows >= 0) & (rows < size) & seen[..., None, None]
    index = (rows.clamp(0, size - 1) * size + columns.clamp(0, size - 1)).flatten(1)
    values = torch.where(inside, value[..., None, None], 0.0).flatten(1)
    maps = torch.zeros(u.shape[0], size * size, device=device)  # shape[0]: len() would fix it in an ONNX file
    return maps.scatter_reduce(1, index, values, "amax").unflatten(1, (size, size))


def drawn(clouds: Clouds) -> tuple[torch.Tensor, torch.Tensor, CanvasFrame, torch.Tensor]:
    """Return normalised points, who is there, their frame, and the normalised targets of clouds, Y up."""
    points = y_up(clouds.points)
    frame = frame_of(points, clouds.seen)
    return frame.normalised(points), clouds.seen, frame, frame.normalised(y_up(clouds.targets))
