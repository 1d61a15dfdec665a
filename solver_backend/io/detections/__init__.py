"""Read keypoints from the files of detectors."""
