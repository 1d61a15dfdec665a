"""Estimate a camera's focal length, principal point and distortion from images of a board."""
