"""Calibrate cameras: boards, lenses, camera poses, calibration files, and a check against a take.

It writes calibrations that the solver reads; a solve imports nothing of it. Finding boards in pictures needs the extra
``capture``, imported where it is used; bundle adjustment and person-only calibration need NumPy alone.
"""
