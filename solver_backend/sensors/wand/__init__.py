"""Calibrate sensors by waving a wand: a marker on a stick, or a bar with three lights."""
