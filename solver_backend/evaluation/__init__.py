"""Evaluate a motion against a capture's truth, next to a plain filter."""
