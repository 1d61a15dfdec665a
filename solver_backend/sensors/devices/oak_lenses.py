"""The lenses that OAKs have of themselves, with which an array is recorded before it is calibrated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from solver_backend.exchange.errors import CalibrationMissing
from solver_backend.sensors.devices.oak import Oak
from solver_backend.sensors.devices.oak_module import depthai, open_oak
from solver_backend.types import Cameras


def oak_cameras(oaks: Sequence[Oak]) -> Cameras:
    """Return the left mono cameras as the factory calibrated them, rectified, all at the origin.

    Args:
        oaks: closed devices; each is connected to for a moment.

    Raises:
        BackendMissing: depthai is not installed.
        SensorFailed: a device is not there.
        CalibrationMissing: a device has no calibration of its own.
    """
    dai = depthai()
    K = np.stack([_intrinsics(dai, oak) for oak in oaks])
    count = len(oaks)
    return Cameras(
        tuple(oak.name for oak in oaks), K, np.zeros((count, 8)), np.tile(np.eye(3), (count, 1, 1)),
        np.zeros((count, 3)), np.array([oak.settings.size for oak in oaks]),
    )  # fmt: skip


def _intrinsics(dai: Any, oak: Oak) -> np.ndarray:
    device = open_oak(oak.identifier, oak.name)
    try:
        found = device.readCalibration().getCameraIntrinsics(dai.CameraBoardSocket.CAM_B, *oak.settings.size)
    except RuntimeError as error:
        raise CalibrationMissing(
            f"The device has no calibration of its own: {error}.", where=f"sensor {oak.name}",
            hint="Film a board in infrared, and give --calibration.",
        ) from error  # fmt: skip
    finally:
        device.close()
    return np.array(found, dtype=np.float64)
