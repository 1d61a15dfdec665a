"""Detect the keypoints of all people in videos with any detector."""
