"""Generic least squares and descent on manifolds; knows no bodies and no files."""
