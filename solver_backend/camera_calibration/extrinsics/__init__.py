"""Estimate camera poses from a calibration board, a person or clicked points."""
