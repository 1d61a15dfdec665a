"""Solve motions from a folder of videos, and keep earlier results."""
