"""Calibrate cameras with boards, people or points. Write and check calibrations. Solves do not import this package."""
