"""Calibrate cameras with boards, people or points, and write and check calibrations. Solves do not import it."""
