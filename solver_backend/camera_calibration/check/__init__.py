"""True if a calibration fits what the cameras saw."""
