"""The folder that a detector's process finds its package in. See ``pose_workers``."""
