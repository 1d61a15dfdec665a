"""Solve hands on a solved body: wrists, fingers, and the arms that follow.

Sides are 0 left and 1 right. Located points are (F, 21, 3) metres, NaN where unknown, shifts (F, 3) metres.
"""
