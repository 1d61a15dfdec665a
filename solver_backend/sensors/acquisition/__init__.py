"""Locate markers and their covariances in one infrared and depth frame. This needs only NumPy."""
