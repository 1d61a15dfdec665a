"""Adjust lens parameters, poses, boards and points by least squares, using only NumPy."""
