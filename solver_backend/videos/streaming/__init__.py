"""Detect people with live cameras, and record them."""
