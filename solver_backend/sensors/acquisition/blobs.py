"""Find bright blobs in an infrared image."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view


@dataclass(frozen=True)
class AcquisitionSettings:
    """Settings for sensors like the Azure Kinect at 1 to 4 m, and markers 14 mm in diameter."""

    marker_radius_m: float = 0.007  # Radius of a marker in metres.
    background_quantile: float = 0.99
    """Quantile of the image's counts that represents the background. Markers cover less than the remaining part."""
    contrast: float = 3.0  # Smallest ratio between the brightness of a marker and of the background.
    least_threshold: float = 0.03
    """Smallest threshold, as a fraction of full counts. It keeps noise in dark images from being detected."""
    most_threshold: float = 0.6  # Largest threshold, as a fraction of full counts. Markers saturate.
    sample_step: int = 8  # Distance between the image rows and columns that are sampled to estimate the background.
    mask_contrast: float = 0.5
    """Fraction of the threshold above which a pixel in an empty scene shows a lamp or another sensor."""
    mask_grow_px: int = 3  # Margin added to the lamp mask in pixels.

    most_bright: float = 0.04
    """Largest fraction of bright pixels. Scenes with more are sunlit, and no markers are detected."""
    most_blobs: int = 400  # Largest number of blobs. A scene with more is sunlit.
    least_pixels: int = 2  # Smallest number of pixels in a blob.
    saturated: float = 0.98
    """Fraction of full counts above which a pixel is saturated. Saturated pixels have no depth."""

    ring_px: int = 2  # Width of the ring around the blind patch.
    least_ring: int = 4  # Smallest number of ring depths that determines a marker's depth.
    mad_limit: float = 3.0
    """Largest distance of a depth from the ring's median, in standard deviations (Leys et al. 2013)."""
    mad_floor_m: float = 0.003  # Smallest standard deviation of a ring (m), so that quantised depths are not outliers.
    two_depths_m: float = 0.010
    """Largest standard deviation (m) of a ring on one surface. Otherwise, the closest half of its depths is used."""
    most_spread_m: float = 0.020  # Largest standard deviation of a ring with a depth. Otherwise, the marker is a ray.
    behind_m: float = 0.030
    """Depths this far (m) behind the marker belong to another surface: three standard deviations of a pixel at 3 m."""
    most_behind: float = 0.1  # Largest fraction of such depths. If more, an occluder hides the marker, which is a ray.
    surface_radii: float = 2.0 / 3.0
    """Distance from a sphere's centre to the surface that reflects, in radii. 2/3 is the mean over its disc."""
    range_m: tuple[float, float] = (0.3, 8.0)  # Possible depths of a marker in metres.

    halo_px: float = 1.5
    """Growth of a blob's radius by blur and saturation, in pixels. Used until it is measured on round blobs."""
    round: float = 1.35
    """Largest variance of a round blob along its longer axis, relative to a disc of equal area."""
    round_kept: int = 256  # Number of recent round blobs with a known depth that determine the halo.
    merged: float = 1.6  # A blob is several markers if its variance along its axis exceeds a disc's by this factor
    merged_px2: float = 0.3  # and by this amount, because a few pixels do not form a smooth disc.
    most_in_blob: int = 4  # Maximum number of markers in one blob.
    too_large: float = 3.5  # Largest area of a part relative to a marker's.
    too_small: float = 0.12  # Smallest area of a part relative to a marker's.
    least_share: float = 0.45
    """Smallest relative area of a marker with a depth. Smaller ones are hidden by an occluder, and are rays."""

    sigma_px: float = 0.08  # Standard deviation of a centroid in pixels.
    split_sigma_px: float = 0.5  # Additional standard deviation for the parts of a split blob.
    hidden_sigma: float = 0.45  # Additional deviation of a partly hidden disc, times its radius and hidden fraction.
    depth_constant_m: float = 0.8e-3
    """Standard deviation of a depth at distance zero, as measured for Azure Kinects (Tölgyessy et al. 2021)."""
    depth_quadratic: float = 0.55e-3  # Additional standard deviation at 1 m. It grows with the square of the distance.
    ring_noise: float = 1.5  # Noise factor for depths in a ring.
    depth_floor_m: float = 0.6e-3  # Error in metres that all pixels of a ring have in common.

    def depth_sigma(self, depth: np.ndarray) -> np.ndarray:
        """Return the standard deviation of a single pixel's depth in metres."""
        return self.depth_constant_m + self.depth_quadratic * depth**2


SETTINGS = AcquisitionSettings()


def connected(pixels: np.ndarray, width: int) -> tuple[np.ndarray, int]:
    """Return the patch number of each bright pixel (sorted flat indices), and the number of patches.

    Pixels are connected if they touch, even at corners.
    """
    if not len(pixels):
        return np.zeros(0, np.int64), 0
    begins = np.ones(len(pixels), dtype=bool)
    begins[1:] = (np.diff(pixels) != 1) | (pixels[1:] % width == 0)
    run = np.cumsum(begins) - 1
    at = np.flatnonzero(begins)
    start = pixels[at]
    end = pixels[np.append(at[1:] - 1, len(pixels) - 1)]
    row = start // width * width
    low, high = np.maximum(start - 1, row) + width, np.minimum(end + 1, row + width - 1) + width
    first, last = np.searchsorted(end, low), np.searchsorted(start, high, side="right")
    count = np.maximum(last - first, 0)
    above = np.repeat(np.arange(len(start)), count)
    below = np.repeat(first - np.cumsum(count) + count, count) + np.arange(int(count.sum()))
    patch, number = joined(len(start), above, below)
    return patch[run], number


def joined(count: int, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the connected component of each of ``count`` nodes with edges (a, b), and the number of components.

    Each node gets the smallest reachable number. Paths to the roots are halved (Shiloach and Vishkin 1982).
    """
    root = np.arange(count)
    while len(a):
        low = np.minimum(root[a], root[b])
        lower = root.copy()
        np.minimum.at(lower, root[a], low)
        np.minimum.at(lower, root[b], low)
        lower = lower[lower]
        if np.array_equal(lower, root):
            break
        root = lower
    names, number = np.unique(root, return_inverse=True)
    return number.reshape(-1), len(names)


@dataclass(frozen=True)
class Blobs:
    """N bright blobs in an infrared image. The blobs consist of P pixels in total."""

    pixel: np.ndarray  # (P,) flat pixel indices.
    owner: np.ndarray  # (P,) index of the blob that each pixel belongs to.
    weight: np.ndarray  # (P,) counts above the threshold.
    count: int
    width: int


@dataclass(frozen=True)
class Shapes:
    """Centres and sizes of N blobs."""

    centre: np.ndarray  # (N, 2) centre in px, weighted by the counts above the threshold.
    area: np.ndarray  # (N,) area in pixels.
    middle: np.ndarray  # (N, 2) unweighted centre in px.
    long: np.ndarray  # (N,) variance along the longer axis in px².


def find_blobs(infrared: np.ndarray, threshold: float, mask: np.ndarray | None) -> Blobs | None:
    """Return the blobs in an (h, w) infrared image outside ``mask``, or None if the scene is sunlit."""
    flat = infrared.reshape(-1)
    pixel = np.flatnonzero(flat > infrared.dtype.type(threshold))
    if mask is not None:
        pixel = pixel[~mask.reshape(-1)[pixel]]
    if len(pixel) > SETTINGS.most_bright * len(flat):
        return None
    owner, count = connected(pixel, infrared.shape[1])
    size = np.bincount(owner, minlength=count)
    kept = size >= SETTINGS.least_pixels
    if kept.sum() > SETTINGS.most_blobs:
        return None
    number = np.cumsum(kept) - 1
    of_kept = kept[owner]
    pixel, owner = pixel[of_kept], number[owner[of_kept]]
    return Blobs(pixel, owner, flat[pixel].astype(np.float64) - threshold, int(kept.sum()), infrared.shape[1])


def shapes_of(blobs: Blobs) -> Shapes:
    """Compute the centre, area and extent of each blob."""
    y, x = np.divmod(blobs.pixel, blobs.width)
    owner, count = blobs.owner, blobs.count

    def total(values: np.ndarray | None = None) -> np.ndarray:
        return np.bincount(owner, values, minlength=count)

    mass, area = np.maximum(total(blobs.weight), 1e-9), total().astype(np.float64)
    centre = np.stack([total(blobs.weight * x), total(blobs.weight * y)], axis=1) / mass[:, None]
    some = np.maximum(area, 1.0)
    middle = np.stack([total(x.astype(float)), total(y.astype(float))], axis=1) / some[:, None]
    dx, dy = x - middle[owner, 0], y - middle[owner, 1]
    # A pixel is a square, whose variance is 1/12.
    xx, yy, xy = total(dx * dx) / some + 1 / 12, total(dy * dy) / some + 1 / 12, total(dx * dy) / some
    half, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return Shapes(centre, area, middle, half + apart)


def full_counts(infrared: np.ndarray) -> float:
    """Return the counts of a saturated pixel, which are the largest value of the image's type."""
    return float(np.iinfo(infrared.dtype).max)


def threshold_of(infrared: np.ndarray) -> float:
    """Return the smallest counts of a bright pixel: ``contrast`` times the background, within limits."""
    full, step = full_counts(infrared), SETTINGS.sample_step
    sample = infrared[step // 2 :: step, step // 2 :: step].ravel()
    rank = int(SETTINGS.background_quantile * (len(sample) - 1))
    background = float(np.partition(sample, rank)[rank])
    return min(max(SETTINGS.contrast * background, SETTINGS.least_threshold * full), SETTINGS.most_threshold * full)


def learned_mask(pictures: Iterable[np.ndarray]) -> np.ndarray:
    """Return the (h, w) mask of lamps, with a margin, from images of the empty scene."""
    brightest: np.ndarray | None = None
    for picture in pictures:
        brightest = picture.copy() if brightest is None else np.maximum(brightest, picture)
    if brightest is None:
        raise ValueError("The recording of the empty scene contains no images.")
    bright = brightest > SETTINGS.mask_contrast * threshold_of(brightest)
    for axis in (0, 1):
        margin = [(SETTINGS.mask_grow_px,) * 2 if k == axis else (0, 0) for k in (0, 1)]
        bright = sliding_window_view(np.pad(bright, margin), 2 * SETTINGS.mask_grow_px + 1, axis).any(-1)
    return bright
