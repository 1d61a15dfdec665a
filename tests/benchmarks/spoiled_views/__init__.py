"""Captures of several views with typical faults, and their results."""
