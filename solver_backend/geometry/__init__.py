"""Compute rotations, alignments and interpolation on spheres, with NumPy and torch."""
