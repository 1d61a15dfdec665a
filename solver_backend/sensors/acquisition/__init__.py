"""Locate markers with covariances in one frame of infrared and depth, with NumPy alone."""
