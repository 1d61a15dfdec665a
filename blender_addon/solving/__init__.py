"""Solve in a child process: the job file, the process and its progress. This package does not need Blender."""
