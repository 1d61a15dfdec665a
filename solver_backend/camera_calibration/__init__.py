"""Calibrate cameras with boards, people or points. Solves do not import this package."""
