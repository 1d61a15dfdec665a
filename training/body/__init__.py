"""Fit the primitives of the generated body to a reference body."""
