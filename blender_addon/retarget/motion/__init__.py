"""Transfer motions between figures, with NumPy alone."""
