"""Calibrate cameras with boards, people or points, and write and check calibrations. A solve imports nothing of it."""
