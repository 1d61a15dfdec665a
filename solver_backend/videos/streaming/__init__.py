"""Detect and record live cameras."""
