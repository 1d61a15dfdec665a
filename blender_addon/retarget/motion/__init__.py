"""Transfer motions between figures with NumPy only."""
