"""Read optical marker recordings: C3D, TRC, and tables exported by other programs."""
