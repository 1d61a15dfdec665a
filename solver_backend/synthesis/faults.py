"""Simulate faults of a capture and correlated noise, for the demo, the simulation and the studio.

A fault of size 0 has no effect. Numbers marked "measured" come from ``python -m tests.benchmarks.noise`` on the
balancing trial of Pose2Sim's example data (Pagnon et al. 2021, four cameras at 60 Hz, OpenPose BODY_25B, 100 frames).
With four views the residuals against a triangulated reference hold sqrt(5/8) of an error. Measured lengths are divided
by this factor.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class DetectorFaults:
    """Faults of a 2D pose detector. Lengths in millimetres at the person's distance, standard deviations per axis."""

    view_bias_mm: float = 0.0  # Error that depends on the viewing direction.
    drift_mm: float = 0.0  # Error that is correlated over ``drift_s``.
    drift_s: float = 0.19  # Time constant of the drift; measured.
    jitter_mm: float = 0.0  # Error that is independent in every frame.
    unevenness: float = 0.43  # Deviation of the log of drift and jitter over views and keypoints; measured.
    occluded_missing: float = 0.0  # Share of occluded runs in which the detector gives up.
    occluded_jitter: float = 2.0  # Factor on drift and jitter where it guesses instead; chosen by hand.
    missing: float = 0.0  # Share of misses without a cause.
    burst_s: float = 0.2  # Mean length of a run of misses; measured.
    outliers: float = 0.0  # Share of detections in another place.
    outlier_mm: float = 220.0  # Mean distance of these; measured median 223 mm.
    outlier_s: float = 0.047  # Mean length of their runs; measured 2.8 frames at 60 Hz.
    swaps_per_minute: float = 0.0  # Exchanges of left and right per limb pair and view.
    swap_frames: tuple[int, int] = (2, 30)  # Shortest and longest exchange.


@dataclass(frozen=True)
class CameraFaults:
    """Faults of cameras."""

    calibration_mm: float = 0.0  # Standard deviation per axis of the person's apparent shift in a view.
    delay_frames: float = 0.0  # Largest delay of a camera; each but the first draws its own, uniformly from 0.


@dataclass(frozen=True)
class MarkerFaults:
    """Differences of a recording from markers that are at their places and move with the bones."""

    measurement_mm: float = 0.0  # Standard deviation per axis of the measurement.
    placement_mm: float = 0.0  # Standard deviation per axis of a marker's place on the body.
    skin_mm: float = 0.0  # Standard deviation per axis of sliding skin, correlated over ``skin_s``.
    skin_s: float = 0.3  # Time constant of the skin; chosen by hand.
    hidden: float = 0.0  # Share of samples lost in gaps.
    hidden_s: float = 0.25  # Mean length of a gap; chosen by hand.
    least_views: float = 0.0  # Fewest cameras that must see a marker.
    swaps_per_minute: float = 0.0  # Exchanges of two markers' labels.
    swap_s: float = 0.4  # Length of an exchange; chosen by hand.
    ghosts: float = 0.0  # Share of a marker's samples that are a ghost near the body.
    ghost_m: float = 0.15  # Standard deviation per axis of a ghost's distance from the marker; chosen by hand.


@dataclass(frozen=True)
class Faults:
    """All faults added to the truth of a capture."""

    detector: DetectorFaults = field(default_factory=DetectorFaults)
    anatomy_mm: float = 0.0  # Standard deviation per axis between a detector's and the body's definition of a joint.
    cameras: CameraFaults = field(default_factory=CameraFaults)
    markers: MarkerFaults = field(default_factory=MarkerFaults)

    @property
    def of_views(self) -> bool:
        """Keypoints are affected."""
        return (self.detector, self.anatomy_mm, self.cameras) != (DetectorFaults(), 0.0, CameraFaults())

    @property
    def of_markers(self) -> bool:
        """Markers are affected."""
        return self.markers != MarkerFaults()


MEASURED_DETECTOR = DetectorFaults(
    9.0, 17.0, jitter_mm=5.0, occluded_missing=0.5, missing=0.005, outliers=0.01, swaps_per_minute=6.0
)
"""Measured: 21 % bias, 72 % drift and 7 % jitter of the variance of 15.8 mm, misses of limbs and feet, and 0.95 % of
the detections beyond 100 mm. Chosen by hand: the share of occluded misses (the recording misses the face in 0-36 %,
limbs in at most 1 %) and the exchanges (none in its 1.7 s)."""
DEMO_DETECTOR = DetectorFaults(  # For the demo: 5 px at 1920 px width, correlation 0.8 at 60 Hz.
    drift_mm=15.625, drift_s=0.07469033529540918, missing=0.08, burst_s=8 / 60, outliers=0.03, outlier_mm=250.0
)
OPTICAL_MARKERS = MarkerFaults(measurement_mm=0.3, placement_mm=8.0, skin_mm=1.5, hidden=0.03)
"""Chosen for the embedded take of markers."""


def autoregressive(shape: tuple[int, ...], correlation: float, rng: np.random.Generator) -> np.ndarray:
    """Return unit-variance noise (C, F, ...) of first order: ``x_t = a x_{t-1} + sqrt(1 - a²) e_t``."""
    noise = rng.normal(size=shape)
    for f in range(1, shape[1]):
        noise[:, f] = correlation * noise[:, f - 1] + np.sqrt(1 - correlation**2) * noise[:, f]
    return noise


def bursts(draws: np.ndarray, share: float, length: float) -> np.ndarray:
    """Return a mask with runs: a two-state Markov chain, left with ``1 / length``, entered so that ``share`` holds.

    ``draws`` (C, F, ...) are uniform in 0..1. ``length`` is in frames.
    """
    leave = 1.0 / length
    enter = leave * share / (1.0 - share)
    mask = draws < share
    for f in range(1, draws.shape[1]):
        mask[:, f] = np.where(mask[:, f - 1], draws[:, f] >= leave, draws[:, f] < enter)
    return mask
