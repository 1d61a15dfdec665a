"""Solving in a child process: the job file, the process, and how far it has come. Nothing here needs Blender."""
