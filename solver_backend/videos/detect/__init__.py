"""Detect the keypoints of everyone in a video with a chosen detector."""
