"""Share code between solver and add-on: errors, progress, settings and files. It needs only NumPy."""
