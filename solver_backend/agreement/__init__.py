"""Correct faults in a capture's files by one list of hypotheses and one likelihood.

A ``Reading`` is an immutable interpretation of all files: camera poses, image sizes and rotations, camera names, left
and right, clocks. ``hypotheses`` has one row per kind of fault: a code, proposed readings, and their costs. ``explain``
scores the literal reading and all proposed readings, and keeps the best one.

The score of a reading is a log-likelihood in nats with these parts:

* ``evidence``: distances from epipolar lines. Their noise and outlier rate are estimated from the capture.
* ``body_evidence``: the triangulated person. Bones are rigid and have plausible proportions, images are upright, toes,
  knees and faces point forward, points are in front of the cameras and inside the images.
* the cost of every change: the logarithm of the number of alternatives.

Repeated poses count once. A reading wins only if it beats every alternative that gives another body. A reading that
changes a single camera must also beat the hypothesis that this camera was moved after the calibration.
"""
