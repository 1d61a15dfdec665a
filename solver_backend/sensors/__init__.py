"""Locate retro-reflective markers with infrared and depth sensors (thesis 5.3.2 and paper, appendix K)."""
