"""Camera poses by bundle adjustment."""
