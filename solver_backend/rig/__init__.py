"""From cameras on tripods to a capture: boards, intrinsics, extrinsics, calibration files and what is wrong with them.

It writes calibrations that the solver reads; a solve imports nothing of it. Pictures and videos need the extra
``capture`` (OpenCV), which is imported where it is used; bundle adjustment and person-only calibration need NumPy.
"""
