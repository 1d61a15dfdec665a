"""Solve the poses of a take, one file per method. ``fitters/pipeline.py`` lists the methods."""
