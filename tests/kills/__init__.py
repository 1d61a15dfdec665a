"""Processes killed at random moments: each must resume, with no file lost, doubled or damaged."""
