"""Reproduce published methods, and compare them with the solver. The extension does not contain this package."""
