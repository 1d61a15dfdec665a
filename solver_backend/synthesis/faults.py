"""Define simulated capture faults and correlated noise, for the demo, simulations and the studio.

A fault of size 0 has no effect. Numbers marked "measured" come from ``python -m tests.benchmarks.noise`` on the
balancing trial in Pose2Sim's example data (Pagnon et al. 2021, four cameras at 60 Hz, OpenPose BODY_25B, 100 frames).
With four views, the residual relative to a triangulated point is sqrt(5/8) of the error. Measured lengths are therefore
divided by this factor.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class DetectorFaults:
    """Faults of a 2D pose detector, in millimetres at the person's distance."""

    view_bias_mm: float = 0.0  # Error that depends on the viewing direction.
    drift_mm: float = 0.0  # Error that is correlated over ``drift_s``.
    drift_s: float = 0.19  # Time constant of the drift in seconds. Measured.
    jitter_mm: float = 0.0  # Error that is independent in each frame.
    unevenness: float = 0.43  # Log standard deviation of drift and jitter across views and keypoints. Measured.
    occluded_missing: float = 0.0  # Fraction of occluded runs of frames without a detection.
    occluded_jitter: float = 2.0  # Factor on drift and jitter in occluded runs that are detected. Chosen by hand.
    missing: float = 0.0  # Fraction of detections missed for no reason.
    burst_s: float = 0.2  # Mean duration of a run of misses in seconds. Measured.
    outliers: float = 0.0  # Fraction of detections at a wrong position.
    outlier_mm: float = 220.0  # Mean distance between an outlier and the true position. Measured median 223 mm.
    outlier_s: float = 0.047  # Mean duration of outlier runs in seconds. Measured 2.8 frames at 60 Hz.
    swaps_per_minute: float = 0.0  # Left-right swaps per minute for each limb pair and view.
    swap_frames: tuple[int, int] = (2, 30)  # Shortest and longest swap in frames.


@dataclass(frozen=True)
class CameraFaults:
    """Faults of calibrations and camera clocks."""

    calibration_mm: float = 0.0  # Standard deviation per axis of the person's apparent shift in each view.
    delay_frames: float = 0.0  # Largest camera delay. Every camera but the first draws one uniformly from 0 to this.


@dataclass(frozen=True)
class MarkerFaults:
    """Faults of recorded markers. Without faults, markers are in nominal positions and move with the bones."""

    measurement_mm: float = 0.0  # Standard deviation of the measurement per axis.
    placement_mm: float = 0.0  # Standard deviation per axis of a marker's placement on the body.
    skin_mm: float = 0.0  # Standard deviation per axis of soft tissue motion, correlated over ``skin_s``.
    skin_s: float = 0.3  # Time constant of the soft tissue motion in seconds. Chosen by hand.
    hidden: float = 0.0  # Fraction of samples lost in gaps.
    hidden_s: float = 0.25  # Mean duration of a gap in seconds. Chosen by hand.
    least_views: float = 0.0  # Number of cameras that must see a marker for it to be recorded.
    swaps_per_minute: float = 0.0  # Label swaps between two markers, per minute.
    swap_s: float = 0.4  # Duration of a swap in seconds. Chosen by hand.
    ghosts: float = 0.0  # Fraction of a marker's samples that are replaced by a ghost near the body.
    ghost_m: float = 0.15  # Standard deviation per axis of the offset from the marker to the ghost. Chosen by hand.


@dataclass(frozen=True)
class Faults:
    """All faults added to the ground truth of a capture."""

    detector: DetectorFaults = field(default_factory=DetectorFaults)
    anatomy_mm: float = 0.0  # Standard deviation per axis between a detector's and the body's joint definitions.
    cameras: CameraFaults = field(default_factory=CameraFaults)
    markers: MarkerFaults = field(default_factory=MarkerFaults)

    @property
    def of_views(self) -> bool:
        """True if the faults affect keypoints."""
        return (self.detector, self.anatomy_mm, self.cameras) != (DetectorFaults(), 0.0, CameraFaults())

    @property
    def of_markers(self) -> bool:
        """True if the faults affect markers."""
        return self.markers != MarkerFaults()


MEASURED_DETECTOR = DetectorFaults(
    9.0, 17.0, jitter_mm=5.0, occluded_missing=0.5, missing=0.005, outliers=0.01, swaps_per_minute=6.0
)
"""Measured: bias, drift and jitter (21 %, 72 % and 7 % of the variance of 15.8 mm), misses of limbs and feet, and 0.95
% of detections beyond 100 mm. Chosen by hand: the fraction of occluded misses (the recording misses the face in 0-36 %,
limbs in at most 1 %) and the swaps (none in its 1.7 s)."""
DEMO_DETECTOR = DetectorFaults(  # For the demo: 5 px at 1920 px width, correlation 0.8 at 60 Hz.
    drift_mm=15.625, drift_s=0.07469033529540918, missing=0.08, burst_s=8 / 60, outliers=0.03, outlier_mm=250.0
)
OPTICAL_MARKERS = MarkerFaults(measurement_mm=0.3, placement_mm=8.0, skin_mm=1.5, hidden=0.03)
"""Errors of optical markers, chosen for the embedded recording."""


def autoregressive(shape: tuple[int, ...], correlation: float, rng: np.random.Generator) -> np.ndarray:
    """Return noise (C, F, ...) of unit variance, ``x_t = a x_{t-1} + sqrt(1 - a²) e_t``, with white noise e."""
    noise = rng.normal(size=shape)
    for f in range(1, shape[1]):
        noise[:, f] = correlation * noise[:, f - 1] + np.sqrt(1 - correlation**2) * noise[:, f]
    return noise


def bursts(draws: np.ndarray, share: float, length: float) -> np.ndarray:
    """Convert uniform random numbers ``draws`` (C, F, ...) in 0..1 to a mask of bursts over the F frames.

    The bursts are a Markov chain. Their mean duration is ``length`` frames, and they cover the fraction ``share`` of
    the mask.
    """
    leave = 1.0 / length
    enter = leave * share / (1.0 - share)
    mask = draws < share
    for f in range(1, draws.shape[1]):
        mask[:, f] = np.where(mask[:, f - 1], draws[:, f] >= leave, draws[:, f] < enter)
    return mask
