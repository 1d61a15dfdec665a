"""Pictures of a textured room, each wall drawn by its homography."""

from __future__ import annotations

import numpy as np

from solver_backend.types import Cameras

SIDE, HEIGHT_M, TEXEL_M = 7.0, 3.0, 0.02
WALLS = (
    ((-SIDE / 2, SIDE / 2, 0), (1, 0, 0), (0, 0, 1), SIDE, HEIGHT_M),
    ((-SIDE / 2, -SIDE / 2, 0), (1, 0, 0), (0, 0, 1), SIDE, HEIGHT_M),
    ((-SIDE / 2, -SIDE / 2, 0), (0, 1, 0), (0, 0, 1), SIDE, HEIGHT_M),
    ((SIDE / 2, -SIDE / 2, 0), (0, 1, 0), (0, 0, 1), SIDE, HEIGHT_M),
    ((-SIDE / 2, -SIDE / 2, 0), (1, 0, 0), (0, 1, 0), SIDE, SIDE),
)
"""Corner, two directions and lengths of each wall and of the floor, metres."""


def textures(cv2, seed: int = 0) -> list[np.ndarray]:
    """Return a picture of blobs for each wall."""
    rng, found = np.random.default_rng(seed), []
    for *_, width, height in WALLS:
        size = int(width / TEXEL_M), int(height / TEXEL_M)
        rough = rng.integers(0, 255, (size[1] // 6, size[0] // 6, 3), dtype=np.uint8)
        found.append(cv2.GaussianBlur(cv2.resize(rough, size, interpolation=cv2.INTER_CUBIC), (0, 0), 1.0))
    return found


def picture(cv2, walls: list[np.ndarray], camera: Cameras, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return what a pinhole camera sees from inside the room: (H, W, 3)."""
    width, height = (int(n) for n in camera.image_size[0])
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(camera.K[0]).T @ R
    centre = -R.T @ t
    nearest, shown = np.full((height, width), np.inf), np.zeros((height, width, 3), np.uint8)
    for (corner, u, v, *_), texture in zip(WALLS, walls, strict=True):
        normal = np.cross(u, v)
        with np.errstate(divide="ignore", invalid="ignore"):
            far = ((np.array(corner) - centre) @ normal) / (rays @ normal)
        far = np.where((far > 0) & np.isfinite(far), far, 1e6)
        place = (centre + far[..., None] * rays - corner) / TEXEL_M
        at = (place @ np.array(u, float)).astype(np.float32), (place @ np.array(v, float)).astype(np.float32)
        drawn = cv2.remap(texture, *at, cv2.INTER_LINEAR)
        high, wide = texture.shape[:2]
        closer = (far < nearest) & (at[0] > 0) & (at[0] < wide - 1) & (at[1] > 0) & (at[1] < high - 1)
        shown[closer], nearest[closer] = drawn[closer], far[closer]
    return shown
