"""Lenses, poses, boards and points by least squares, on NumPy alone."""
