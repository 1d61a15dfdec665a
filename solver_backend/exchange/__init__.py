"""The library that solver and add-on share: errors, progress, settings and files. NumPy and standard library alone."""
