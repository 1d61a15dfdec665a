"""Solve in a child process: job file, process and progress."""
