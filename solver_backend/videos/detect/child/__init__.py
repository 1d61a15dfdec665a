"""Folder in which a detector process finds its package. See ``pose_workers``."""
