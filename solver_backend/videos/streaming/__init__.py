"""Detect people in live camera images, and record the result."""
