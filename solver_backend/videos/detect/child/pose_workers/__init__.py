"""Detectors that run as separate processes, in any Python (3.9 or later) with NumPy and the detector installed.

Each detector module runs as a program: ``python -m pose_workers.mediapipe_pose OPTIONS``. The options are JSON text.
``serve`` describes the messages.
"""
