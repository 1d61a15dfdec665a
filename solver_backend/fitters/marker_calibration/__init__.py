"""Calibrate a person from markers: body shape, marker positions and wrong labels.

``points`` are (F, M, 3) positions in metres, NaN where missing. ``expected`` are the same markers on the body.
"""
