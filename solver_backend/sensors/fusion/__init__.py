"""Fuse the sightings from all sensors into one cloud, track its points, and reject ghosts."""
