"""Describe, print and find calibration boards."""
