"""Lenses: focal length, centre and distortion of one camera from pictures of a board."""
