"""Solve the hands of a solved body: wrists and fingers. The arms then follow the wrists.

Side 0 is left, and 1 is right. Triangulated points (F, 21, 3) and wrist shifts (F, 3) are in metres, NaN where unknown.
"""
