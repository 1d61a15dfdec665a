"""What fusion takes for known; every constant of it stands here."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FusionSettings:
    """Constants of fusion."""

    clusters: str = "test"
    """'test' joins sightings that differ no more than their covariances allow, 'radius' all within ``radius_m``."""
    radius_m: float = 0.01
    """Radius of the published clusters (paper, appendix K)."""
    calibration_m: float = 0.0012
    """Standard deviation, per axis, by which a sensor's place and lens are wrong; added in tests, not in the result."""
    joined: float = 16.27
    """Largest χ² of two sightings of one marker: 0.999 with three degrees of freedom."""
    joined_ray: float = 13.82
    """The same of a point and a ray: 0.999 with two."""
    joined_rays: float = 6.63
    """The same of two rays: 0.99 with one; chance brings rays together more often than points."""
    reach_m: float = 0.05
    """Sightings farther apart are never one marker, however unsure."""
    closest_m: float = 0.028
    """No two markers are closer: of two points that are, the surer one stays. Smaller for fingers."""
    ray_range_m: tuple[float, float] = (0.3, 6.0)
    """Where two rays may meet, from either sensor."""
    least_angle: float = 0.17
    """Radians between two rays that give a point."""

    acceleration_m_s2: float = 40.0
    """Standard deviation of a marker's acceleration from frame to frame."""
    start_speed_m_s: float = 2.0
    """Standard deviation of the speed of a marker that was not there before."""
    follow: float = 16.27
    """Largest χ² of a point and the track that it goes on from."""
    lost_s: float = 0.12
    """Time after which a track that is not seen is given up."""

    hit_alone: float = 0.8
    """Added to a track's log-odds of being a marker by a frame in which one sensor sees it."""
    hit_together: float = 3.0
    """The same of two or more sensors."""
    hit_rays: float = 1.0
    """The same of two rays alone."""
    miss: float = 1.0
    """Taken from it by a frame in which none does."""
    start: float = -2.0
    """Log-odds of a point that was not there before."""
    most: float = 6.0
    """Largest log-odds that are kept."""


DEFAULT = FusionSettings()
