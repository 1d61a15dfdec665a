"""Estimate poses from live points."""
