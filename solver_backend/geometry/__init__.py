"""Rotations, alignment and interpolation on spheres, for NumPy and torch."""
