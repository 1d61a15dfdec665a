"""Camera calibrations of other tools, in metres with Z up."""

from solver_backend.io.calibration.entry import Calibration, CameraEntry
from solver_backend.io.calibration.read import calibrations_in, read_calibration

__all__ = ["Calibration", "CameraEntry", "calibrations_in", "read_calibration"]
