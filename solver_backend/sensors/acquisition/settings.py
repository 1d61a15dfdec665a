"""What acquisition takes for known of a sensor and of the markers; every constant of it stands here."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class AcquisitionSettings:
    """Constants of acquisition, for sensors like an Azure Kinect at 1 to 4 m and markers of 14 mm."""

    marker_radius_m: float = 0.007
    """Radius of a marker."""
    full: float | None = None
    """Counts at which infrared saturates; the largest of the picture's type if None."""

    background_quantile: float = 0.99
    """Quantile of the picture that counts as its background: markers cover less than the rest."""
    contrast: float = 3.0
    """A marker is this many times brighter than the background."""
    least_threshold: float = 0.03
    """The threshold is at least this share of ``full``, so that noise in the dark is no marker."""
    most_threshold: float = 0.6
    """And at most this: retro-reflections saturate."""
    sample_step: int = 8
    """The background is estimated from every so many-th pixel of every so many-th row."""
    mask_contrast: float = 0.5
    """In an empty scene, what exceeds this share of the threshold is a lamp or another sensor."""
    mask_grow_px: int = 3
    """Lamps are masked this much larger."""

    most_bright: float = 0.04
    """Share of bright pixels from which on it is sunlight, and no markers are looked for."""
    most_blobs: int = 400
    """Number of blobs from which on the same."""
    least_pixels: int = 2
    """Pixels of the smallest blob."""
    saturated: float = 0.98
    """Share of ``full`` from which on a pixel is saturated; such pixels have no depth of their own."""

    ring_px: int = 2
    """Width of the ring around the blind patch."""
    least_ring: int = 4
    """Depths in the ring with which a marker has a depth."""
    mad_limit: float = 3.0
    """Depths farther from the ring's median than this times their spread are left out (Leys et al. 2013)."""
    mad_floor_m: float = 0.003
    """Spread that a ring has at least, so that quantised depths are no outliers."""
    two_depths_m: float = 0.010
    """A ring with a larger spread lies on two surfaces: of its depths the closest half counts, not their median."""
    most_spread_m: float = 0.020
    """A ring that spreads more even so has no depth; the marker is a ray."""
    behind_m: float = 0.030
    """Depths of the ring farther behind the rest are of another surface: three deviations of a pixel at 3 m."""
    most_behind: float = 0.1
    """With more of its ring behind it the depth is an occluder's; the marker is a ray."""
    surface_radii: float = 2.0 / 3.0
    """How far before a sphere's middle its light comes from, in radii: 2/3 is the mean over its disc."""
    range_m: tuple[float, float] = (0.3, 8.0)
    """Depths in which a marker is believed."""

    halo_px: float = 1.5
    """How much larger than its sphere a blob is, by blur and saturation, until it is measured on round blobs."""
    round: float = 1.35
    """A blob is round if its variance along its axis exceeds that of a disc of its area by less than this factor."""
    round_kept: int = 256
    """The last so many round blobs of known depth give the halo."""
    merged: float = 1.6
    """A blob whose variance along its axis exceeds a single disc's by this factor is two markers or more."""
    merged_px2: float = 0.3
    """Added to that: a few pixels make no smooth disc."""
    most_in_blob: int = 4
    """Markers that one blob is split into at most."""
    too_large: float = 3.5
    """A part whose area exceeds a marker's by this factor is none."""
    too_small: float = 0.12
    """And one whose area falls below this share."""
    least_share: float = 0.45
    """With less of its area a marker is hidden so far that the ring is its occluder's; the marker is a ray."""

    sigma_px: float = 0.08
    """Standard deviation of a centroid."""
    split_sigma_px: float = 0.5
    """Added for parts of a split blob."""
    hidden_sigma: float = 0.45
    """Added for a disc that is partly hidden: this times its radius times the share that is missing."""
    depth_constant_m: float = 0.8e-3
    """Standard deviation of a depth at no distance (Tölgyessy et al. 2021, about that of Azure Kinects)."""
    depth_quadratic: float = 0.55e-3
    """Added standard deviation at 1 m, growing with the square of the distance."""
    ring_noise: float = 1.5
    """Depths in a ring are noisier by this factor."""
    depth_floor_m: float = 0.6e-3
    """Part of a ring's error that its pixels share."""

    def depth_sigma(self, depth: np.ndarray) -> np.ndarray:
        """Return the standard deviation in metres of one pixel of a ring at depths in metres."""
        return self.ring_noise * (self.depth_constant_m + self.depth_quadratic * depth**2)


DEFAULT = AcquisitionSettings()
