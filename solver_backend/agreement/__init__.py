"""Correct faults in a capture's files by one list of hypotheses and one likelihood.

A ``Reading`` is an immutable interpretation of all files: camera poses, image sizes and rotations, camera names, left
and right, clocks. ``hypotheses`` proposes readings, with one row per kind of fault and a cost for every change.
``explain`` scores the literal reading and all proposed readings, and keeps the best one.

The score is a log-likelihood in nats: distances from epipolar lines (``evidence``) and a plausible triangulated person
(``body_evidence``), minus the cost. Noise and outlier rate are estimated from the capture, and repeated poses count
once. A reading wins only if it beats every reading that gives another body.
"""
