"""What one sensor saw in one frame: markers in space with covariances, and rays where there was no depth."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class SensorSightings:
    """N markers of one sensor at one moment."""

    sensor: int
    """Index of the sensor in the calibration."""
    time: float
    """Seconds on the device's clock."""
    px: np.ndarray
    """(N, 2) pixels of the middles."""
    depth: np.ndarray
    """(N,) metres along the axis to the middles, NaN where there is none."""
    points: np.ndarray
    """(N, 3) world metres, NaN where there is no depth."""
    covariance: np.ndarray
    """(N, 3, 3) m², NaN where there is no depth."""
    origin: np.ndarray
    """(3,) the sensor's place."""
    direction: np.ndarray
    """(N, 3) unit directions of the rays in the world."""
    sigma_ray: np.ndarray
    """(N,) radians, how sure the rays are across."""
    finding: str = ""
    """Code of what is wrong with the frame, where something is."""
    number: int = 0
    """The device's count of frames."""
    host_s: float = field(default=0.0, compare=False)
    """When the frame arrived, on the host's clock."""

    def __len__(self) -> int:
        return len(self.px)


def no_sightings(
    sensor: int, time: float, origin: np.ndarray, finding: str = "", *, number: int = 0, host_s: float = 0.0
) -> SensorSightings:
    """Return a frame without markers."""
    none = np.zeros((0, 3))
    return SensorSightings(
        sensor, time, np.zeros((0, 2)), np.zeros(0), none, np.zeros((0, 3, 3)), origin, none, np.zeros(0), finding,
        number, host_s,
    )  # fmt: skip
