"""Calibration of a person from markers: shape, marker places, and wrong labels.

``points`` are (F, M, 3) metres, NaN where missing, and ``expected`` the same markers on the body.
"""
