"""Read keypoints in the files of detectors."""
