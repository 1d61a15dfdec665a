"""Rotations, alignment of point sets and interpolation on spheres, for NumPy arrays and torch tensors."""
