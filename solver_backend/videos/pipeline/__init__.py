"""Solve motions from a folder of videos, and reuse earlier results."""
