"""Adjust lenses, poses, boards and points by least squares, with NumPy alone."""
