"""Named errors of sensors and their recordings."""

from __future__ import annotations

from solver_backend.exchange.errors import MocapError


class SensorFailed(MocapError):
    """A sensor went away, or gives what cannot be used."""

    code = "sensor_failed"


class SensorUnknown(MocapError):
    """A sensor is of no kind we know, or the calibration does not name it."""

    code = "sensor_unknown"


class PicturesDiffer(MocapError):
    """A sensor's infrared, depth and calibration are of different sizes."""

    code = "pictures_differ"


class RecordingInvalid(MocapError):
    """A folder is no recording of sensors, or one that is damaged."""

    code = "recording_invalid"


class NoMarkers(MocapError):
    """No sensor saw a marker in any frame."""

    code = "no_markers"
