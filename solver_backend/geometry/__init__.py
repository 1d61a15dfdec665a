"""Rotations, alignment of point sets and interpolation on spheres, over NumPy arrays and torch tensors."""
