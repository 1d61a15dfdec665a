"""Read motions of other programs."""
