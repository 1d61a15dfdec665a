"""Detectors that run as separate processes, in any Python (3.9 or later) with NumPy and the detector installed.

Each module is one detector: ``python -m pose_workers.mediapipe_pose OPTIONS.json-text`` (see ``serve``).
"""
