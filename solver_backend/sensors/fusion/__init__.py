"""Fuse the markers seen by all sensors into one cloud, track its points, and reject ghosts."""
