"""Motions of other programs."""
