"""Fit the generated body's primitives to a reference body."""
