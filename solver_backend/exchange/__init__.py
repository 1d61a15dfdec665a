"""Code that solver and add-on share, which needs only NumPy."""
