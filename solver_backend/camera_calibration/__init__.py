"""Calibrate cameras from a calibration board, a person or clicked points. A solve does not import this package."""
