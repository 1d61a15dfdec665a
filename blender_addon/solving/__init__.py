"""Solve in a child process: write the job file, run the process, and follow its progress."""
