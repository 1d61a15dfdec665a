"""Whether a calibration fits what the cameras saw."""
