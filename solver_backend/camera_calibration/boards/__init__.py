"""Describe, print and detect calibration boards."""
