"""Fuse the sightings of all sensors into one cloud, follow its points, and reject ghosts."""
