"""Folder where a detector's process finds its package. See ``pose_workers``."""
