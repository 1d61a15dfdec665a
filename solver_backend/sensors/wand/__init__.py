"""Calibrate sensors from a waved wand: a marker on a stick, or a bar with three lights."""
