"""Estimate focal length, centre and distortion of a camera from pictures of a board."""
