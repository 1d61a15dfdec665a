"""Calibrate cameras: boards, lenses, camera poses, calibration files, and a check against a take.

It writes calibrations that the solver reads. A solve imports nothing of it. Finding boards in pictures needs the extra
``capture``, imported where it is used. Bundle adjustment and person-only calibration need NumPy alone.
"""
