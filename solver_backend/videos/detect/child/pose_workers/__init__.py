"""Detectors as processes of their own, which may run in another Python (3.9 or later) with nothing of ours but this.

Every module is one detector: ``python -m pose_workers.mediapipe_pose OPTIONS.json-text`` reads pictures from standard
input and writes what it found to standard output (see ``serve``). Relative imports, NumPy and the detector alone.
"""
