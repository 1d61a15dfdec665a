"""Transfer motions between figures. These modules need only NumPy."""
