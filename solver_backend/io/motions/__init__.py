"""Read motions from other programs."""
