"""Calibration of a person from markers: shape, marker places, and wrong labels."""
