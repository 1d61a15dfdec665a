"""Folder that a detector process adds to its Python path, to import ``pose_workers``."""
