"""Calibration boards: what is on them, a page to print, and finding them in pictures."""
