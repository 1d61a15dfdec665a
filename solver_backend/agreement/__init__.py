"""Correct faults of a capture's files by one list of hypotheses, one likelihood and one search.

A ``Reading`` is an immutable interpretation of every file: poses, sizes and turns of pictures, camera names, sides,
clocks. ``hypotheses`` has one row per fault: a code, proposed readings, and their costs. ``explain`` scores the literal
reading and all proposed ones, and keeps the winner.

The score of a reading is a log-likelihood in nats:

* ``evidence``: distances from epipolar lines. Their noise and outlier rate are estimated from the capture itself.
* ``body_evidence``: the triangulated person. Bones are rigid and have plausible proportions, pictures are upright,
  toes, knees and faces point forward, points lie in front of the cameras and within the pictures.
* the cost of every change: the logarithm of the number of its rivals.

Repeated poses count once. A reading wins only if it beats every rival that gives another body, and the reading of a
single camera must also beat the hypothesis that this camera was moved after the calibration.
"""
