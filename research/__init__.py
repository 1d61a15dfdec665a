"""Reproduce and compare published methods; it is not part of the extension."""
