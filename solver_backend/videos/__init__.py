"""Turn videos into a capture: read video files, detect keypoints, synchronise cameras, run the whole pipeline.

Pictures, sound and detectors need the extra ``capture``, imported where it is used.
"""
