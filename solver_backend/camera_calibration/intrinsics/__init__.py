"""Estimate focal length, principal point and distortion of a camera from images of a board."""
