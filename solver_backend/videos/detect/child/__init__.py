"""The folder that a detector's process finds its package in; see ``pose_workers``."""
