"""Read keypoints as detectors write them: one module a program, found by what lies in the folder."""
