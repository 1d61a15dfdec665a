"""Footage beside a capture: which file belongs to which camera, and how many frames it has."""
