"""Read keypoints from the output files of detectors."""
