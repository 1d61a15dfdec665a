"""From cameras on tripods to a capture: boards, lenses, places, calibration files, clocks, detections, one road.

It writes calibrations and captures that the solver reads; a solve imports nothing of it. Pictures, videos and
detectors need the extra ``capture``, imported where it is used; bundle adjustment and person-only calibration need
NumPy.
"""
