"""Fuse the sightings of all sensors into one cloud, track its points, and reject ghosts."""
