"""Captures of other programs."""
