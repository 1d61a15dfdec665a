"""Read captures of other programs."""
