"""Reproduce published methods and compare with them. The extension does not contain this package."""
