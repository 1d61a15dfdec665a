"""Read keypoints from detector output files."""
