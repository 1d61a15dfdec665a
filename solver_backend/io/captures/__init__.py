"""Read captures made by other programs."""
