"""Generic least squares and descent on manifolds. Knows no bodies and no files."""
