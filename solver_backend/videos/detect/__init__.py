"""Keypoints of everybody in every picture of a video, by whichever detector the user has."""
