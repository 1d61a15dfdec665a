"""Locate markers and their covariances in an infrared and depth frame, with NumPy only."""
