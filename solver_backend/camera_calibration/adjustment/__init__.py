"""Adjust lenses, poses, boards and points by least squares, using only NumPy."""
