"""Estimate camera poses by bundle adjustment."""
