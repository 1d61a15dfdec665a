"""Locate retro-reflective markers with infrared and depth sensors (thesis 5.3.2)."""
