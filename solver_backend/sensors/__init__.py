"""Locate retro-reflective markers with infrared depth sensors (thesis 5.3.2)."""
