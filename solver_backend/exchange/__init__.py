"""Code that solver and add-on share: errors, progress, settings and files. It needs only NumPy."""
