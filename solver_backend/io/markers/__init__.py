"""Read optical marker recordings: C3D, TRC, and table exports of other programs."""
