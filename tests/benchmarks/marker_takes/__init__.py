"""Measurements of the optical marker benchmark, one file per question."""
