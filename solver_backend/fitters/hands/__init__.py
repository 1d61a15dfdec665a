"""Solve the hands of a solved body: wrists, fingers, and the arms that follow the wrists.

Side 0 is left, side 1 is right. Triangulated points are (F, 21, 3) positions in metres, NaN where unknown. Shifts of
the wrist are (F, 3) in metres.
"""
