"""An infrared picture under a light at the camera: surfaces fall off with distance, retro-reflectors saturate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.synthesis.studio.scene.costume import LABELS
from solver_backend.synthesis.studio.scene.marker_spheres import Spheres

FULL = 65535
"""Where the sensor saturates."""
_ALBEDO = np.array([0.0, 0.55, 0.45, 0.4, 0.25, 0.2, 0.3, 0.9, 0.5, 0.6], np.float32)
"""Infrared reflectance by label, chosen."""
_KERNEL_PX = 2
"""Pixels to each side that a lens' blur reaches; chosen by hand."""


@dataclass(frozen=True)
class InfraredModel:
    """How bright things are, and the sensor's errors; all chosen to look like figure 5.5 of the thesis."""

    flood: float = 9000.0
    """Counts of a white surface square on at 1 m."""
    retro: float = 6.0
    """Times ``FULL`` that a retro-reflector gives at 2 m."""
    least_retro: float = 1.3
    """The same at least, as exposure goes with the room's size."""
    blur_px: float = 0.65
    """Standard deviation of the lens's blur of retro-reflections."""
    shot_noise: float = 2.0
    """Standard deviation at one count, growing with the root."""
    read_noise: float = 12.0
    """Standard deviation of counts in the dark."""


def sphere_light(spheres: Spheres, shape: tuple[int, int], model: InfraredModel) -> np.ndarray:
    """Return (h, w) float32 counts that retro-reflective spheres send back, not yet saturated."""
    height, width = shape
    light = np.zeros(height * width, np.float32)
    if not len(spheres.pixel):
        return light.reshape(shape)
    bright = FULL * np.maximum(model.retro * (2.0 / np.maximum(spheres.depth, 0.3)) ** 2, model.least_retro)
    counts = bright[spheres.owner] * spheres.cover
    steps = np.arange(-_KERNEL_PX, _KERNEL_PX + 1)
    weights = np.exp(-0.5 * (steps / model.blur_px) ** 2)
    weights /= weights.sum()
    row, column = np.divmod(spheres.pixel, width)
    for dy, wy in zip(steps.tolist(), weights.tolist(), strict=True):
        for dx, wx in zip(steps.tolist(), weights.tolist(), strict=True):
            y, x = row + dy, column + dx
            inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
            np.add.at(light, (y * width + x)[inside], (wx * wy * counts)[inside].astype(np.float32))
    return light.reshape(shape)


def infrared(
    depth: np.ndarray, cosine: np.ndarray, label: np.ndarray, retro: np.ndarray, model: InfraredModel,
    rng: np.random.Generator,
) -> np.ndarray:  # fmt: skip
    """Return the (h, w) uint16 picture: ``albedo cos / z²`` of surfaces, retro-reflections, noise, saturation.

    Args:
        depth: (h, w) metres, inf where nothing is.
        cosine: (h, w) of the angle between normal and sight line.
        label: (h, w) index into the labels.
        retro: (h, w) counts from ``sphere_light``.
        model: the sensor.
        rng: seeded source of randomness.
    """
    assert len(_ALBEDO) == len(LABELS)
    surface = np.float32(model.flood) * _ALBEDO[label] * np.maximum(cosine, np.float32(0.05)) / depth**2
    counts = np.minimum(surface + retro, np.float32(2 * FULL))
    sigma = np.float32(model.shot_noise) * np.sqrt(counts) + np.float32(model.read_noise)
    counts += sigma * rng.standard_normal(counts.shape, np.float32)
    return np.clip(counts, 0, FULL).astype(np.uint16)
